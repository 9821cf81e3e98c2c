//! The rotator that turns the camera.

use serde_json::json;

use crate::answer::{Answer, DONE, Refusal, within};
use crate::request::Request;
use crate::travel::Travel;

/// Properties that are read without parameters, in ASCOM's case.
pub const PROPERTIES: &[&str] =
    &["CanReverse", "IsMoving", "MechanicalPosition", "Position", "Reverse", "StepSize", "TargetPosition"];

/// The properties in `DeviceState`.
pub const STATE: &[&str] = &["IsMoving", "MechanicalPosition", "Position"];

const DEG_PER_S: f64 = 6.0;

/// A rotator; its mechanical position is the angle by which the camera is turned.
#[derive(Debug)]
pub struct Rotator {
    travel: Travel,
    /// Reported position less mechanical position, deg.
    offset_deg: f64,
    reversed: bool,
}

impl Default for Rotator {
    fn default() -> Self {
        Self { travel: Travel::resting(0.0, DEG_PER_S), offset_deg: 0.0, reversed: false }
    }
}

impl Rotator {
    /// How far the camera is turned, deg.
    pub fn mechanical_deg(&self) -> f64 {
        self.travel.at().rem_euclid(360.0)
    }

    /// Lets sky time pass.
    pub fn advance(&mut self, dt: f64) {
        self.travel.advance(dt);
    }

    fn position(&self, mechanical: f64) -> f64 {
        let turned = if self.reversed { -mechanical } else { mechanical };
        (turned + self.offset_deg).rem_euclid(360.0)
    }

    fn send_position(&mut self, position: f64) {
        let turned = position - self.offset_deg;
        self.travel.send_round(if self.reversed { -turned } else { turned });
    }

    /// Answers a GET.
    pub fn get(&self, request: &Request) -> Answer {
        Ok(match request.member.as_str() {
            "canreverse" => json!(true),
            "ismoving" => json!(self.travel.is_moving()),
            "mechanicalposition" => json!(self.mechanical_deg()),
            "position" => json!(self.position(self.travel.at())),
            "reverse" => json!(self.reversed),
            "stepsize" => json!(0.01),
            "targetposition" => json!(self.position(self.travel.target())),
            _ => return Err(Refusal::UnknownMember),
        })
    }

    /// Executes a PUT.
    pub fn put(&mut self, request: &Request) -> Answer {
        let absolute = || within("Position", request.number("Position")?, 0.0, 360.0 - 1e-9);
        match request.member.as_str() {
            "halt" => self.travel.stop(),
            "move" => {
                let by = within("Position", request.number("Position")?, -360.0, 360.0)?;
                self.send_position(self.position(self.travel.at()) + by);
            }
            "moveabsolute" => self.send_position(absolute()?),
            "movemechanical" => self.travel.send_round(absolute()?),
            "reverse" => self.reversed = request.truth("Reverse")?,
            "sync" => {
                let here = absolute()?;
                self.offset_deg += here - self.position(self.travel.at());
            }
            _ => return Err(Refusal::UnknownMember),
        }
        DONE
    }
}
