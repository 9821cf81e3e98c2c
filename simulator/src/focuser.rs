//! The focuser: absolute, with a thermometer; focus moves with temperature and filter.

use serde_json::json;

use crate::answer::{Answer, DONE, Refusal};
use crate::gear::Gear;
use crate::options::FocusOptions;
use crate::request::Request;
use crate::scene::Scene;
use crate::travel::Travel;
use crate::weather::Quantity;

/// Properties that are read without parameters, in ASCOM's case.
pub const PROPERTIES: &[&str] = &[
    "Absolute",
    "IsMoving",
    "MaxIncrement",
    "MaxStep",
    "Position",
    "StepSize",
    "TempComp",
    "TempCompAvailable",
    "Temperature",
];

/// The properties in `DeviceState`.
pub const STATE: &[&str] = &["IsMoving", "Position", "Temperature"];

/// A focuser.
#[derive(Debug)]
pub struct Focuser {
    options: FocusOptions,
    travel: Travel,
    gear: Gear,
}

impl Focuser {
    /// At the best position of 10 C, come there from below.
    pub fn new(options: &FocusOptions) -> Self {
        Self {
            options: *options,
            travel: Travel::resting(options.best_step.round(), options.steps_per_s),
            gear: Gear::driving_forward(options.backlash_steps),
        }
    }

    /// Steps beyond the best focus of this temperature and filter.
    pub fn defocus_steps(&self, temperature_c: f64, filter_offset: f64) -> f64 {
        let best = self.options.best_step + self.options.steps_per_k * (temperature_c - 10.0) + filter_offset;
        // Half the play, so that the reported position is true after a move outward.
        self.travel.at() - self.gear.lag() + self.gear.play() / 2.0 - best
    }

    /// Gives its gear another play, steps; None: as at the start.
    pub fn set_backlash(&mut self, steps: Option<f64>) {
        self.gear.set_play(steps.unwrap_or(self.options.backlash_steps));
    }

    /// Play of its gear, steps.
    pub fn backlash_steps(&self) -> f64 {
        self.gear.play()
    }

    /// Lets sky time pass.
    pub fn advance(&mut self, dt: f64) {
        let before = self.travel.at();
        self.travel.advance(dt);
        self.gear.turn(self.travel.at() - before);
    }

    /// Answers a GET.
    pub fn get(&self, request: &Request, scene: &Scene) -> Answer {
        Ok(match request.member.as_str() {
            "absolute" => json!(true),
            "ismoving" => json!(self.travel.is_moving()),
            "maxincrement" | "maxstep" => json!(self.options.max_step),
            "position" => json!(self.travel.at().round() as i32),
            "stepsize" => json!(self.options.step_um),
            "tempcomp" | "tempcompavailable" => json!(false),
            "temperature" => json!(scene.weather.of(Quantity::Temperature)),
            _ => return Err(Refusal::UnknownMember),
        })
    }

    /// Executes a PUT.
    pub fn put(&mut self, request: &Request) -> Answer {
        match request.member.as_str() {
            "halt" => self.travel.stop(),
            // Beyond its ends it goes to its end, as ASCOM asks of an absolute focuser.
            "move" => self.travel.send(f64::from(request.integer("Position")?.clamp(0, self.options.max_step))),
            "tempcomp" => {
                request.truth("TempComp")?;
                return Err(Refusal::not_implemented("TempComp"));
            }
            _ => return Err(Refusal::UnknownMember),
        }
        DONE
    }
}
