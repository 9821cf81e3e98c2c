//! The focuser: absolute, with a thermometer; focus moves with temperature and filter.

use serde_json::json;

use crate::answer::{Answer, DONE, Refusal};
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

/// What `DeviceState` tells.
pub const STATE: &[&str] = &["IsMoving", "Position", "Temperature"];

/// A focuser.
#[derive(Debug)]
pub struct Focuser {
    options: FocusOptions,
    travel: Travel,
}

impl Focuser {
    /// At the best position of 10 C.
    pub fn new(options: &FocusOptions) -> Self {
        Self { options: *options, travel: Travel::resting(options.best_step.round(), options.steps_per_s) }
    }

    /// Steps beyond the best focus of this temperature and filter.
    pub fn defocus_steps(&self, temperature_c: f64, filter_offset: f64) -> f64 {
        let best = self.options.best_step + self.options.steps_per_k * (temperature_c - 10.0) + filter_offset;
        self.travel.at() - best
    }

    /// Lets sky time pass.
    pub fn advance(&mut self, dt: f64) {
        self.travel.advance(dt);
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

    /// Obeys a PUT.
    pub fn put(&mut self, request: &Request) -> Answer {
        match request.member.as_str() {
            "halt" => self.travel.stop(),
            // beyond its ends it goes to its end, as ASCOM asks of an absolute focuser
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
