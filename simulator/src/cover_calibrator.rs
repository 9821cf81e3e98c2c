//! Telescope cover and flat panel.

use serde_json::json;

use crate::answer::{Answer, DONE, Refusal, within};
use crate::request::Request;
use crate::travel::Travel;

/// Properties that are read without parameters, in ASCOM's case.
pub const PROPERTIES: &[&str] =
    &["Brightness", "CalibratorChanging", "CalibratorState", "CoverMoving", "CoverState", "MaxBrightness"];

/// The properties in `DeviceState`.
pub const STATE: &[&str] = &["Brightness", "CalibratorChanging", "CalibratorState", "CoverMoving", "CoverState"];

const MAX_BRIGHTNESS: f64 = 255.0;
/// Sky seconds from end to end.
const COVER_S: f64 = 8.0;
/// Brightness steps per sky second while the lamp warms up.
const WARM_UP: f64 = 128.0;
/// Electrons per second and pixel at full brightness, without a filter.
const FULL_E_PER_S: f64 = 30_000.0;

/// A cover with a lamp in it.
#[derive(Debug)]
pub struct CoverCalibrator {
    /// 0 closed, 1 open.
    cover: Travel,
    lamp: Travel,
}

impl Default for CoverCalibrator {
    /// Open and dark: a site that does not use its cover still sees the sky.
    fn default() -> Self {
        Self { cover: Travel::resting(1.0, 1.0 / COVER_S), lamp: Travel::resting(0.0, WARM_UP) }
    }
}

impl CoverCalibrator {
    /// Fraction of the aperture that is free.
    pub fn open(&self) -> f64 {
        self.cover.at()
    }

    /// The light that the lamp sends into the telescope, electrons per second and pixel; only a closed cover shines
    /// inwards.
    pub fn panel_e_per_s(&self) -> f64 {
        if self.cover.at() > 0.0 { 0.0 } else { FULL_E_PER_S * self.lamp.at() / MAX_BRIGHTNESS }
    }

    /// Lets sky time pass.
    pub fn advance(&mut self, dt: f64) {
        self.cover.advance(dt);
        self.lamp.advance(dt);
    }

    /// Answers a GET.
    pub fn get(&self, request: &Request) -> Answer {
        Ok(match request.member.as_str() {
            "brightness" => json!(self.lamp.target() as i32),
            "maxbrightness" => json!(MAX_BRIGHTNESS as i32),
            "calibratorchanging" => json!(self.lamp.is_moving()),
            // ASCOM: 1 off, 2 not ready, 3 ready.
            "calibratorstate" => json!(match (self.lamp.is_moving(), self.lamp.at() > 0.0) {
                (true, _) => 2,
                (false, true) => 3,
                (false, false) => 1,
            }),
            "covermoving" => json!(self.cover.is_moving()),
            // ASCOM: 1 closed, 2 moving, 3 open, 4 unknown (halted between).
            "coverstate" => json!(match (self.cover.is_moving(), self.cover.at()) {
                (true, _) => 2,
                (false, at) if at <= 0.0 => 1,
                (false, at) if at >= 1.0 => 3,
                _ => 4,
            }),
            _ => return Err(Refusal::UnknownMember),
        })
    }

    /// Executes a PUT.
    pub fn put(&mut self, request: &Request) -> Answer {
        match request.member.as_str() {
            "calibratoroff" => self.lamp.send(0.0),
            "calibratoron" => {
                let brightness = f64::from(request.integer("Brightness")?);
                self.lamp.send(within("Brightness", brightness, 0.0, MAX_BRIGHTNESS)?);
            }
            "opencover" => self.cover.send(1.0),
            "closecover" => self.cover.send(0.0),
            "haltcover" => self.cover.stop(),
            _ => return Err(Refusal::UnknownMember),
        }
        DONE
    }
}
