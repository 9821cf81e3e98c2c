//! The site's safety monitor: safe or unsafe, from the weather and from tests.

use serde_json::json;

use crate::answer::{Answer, Refusal};
use crate::request::Request;
use crate::weather::{Conditions, Quantity};

/// Properties that are read without parameters, in ASCOM's case.
pub const PROPERTIES: &[&str] = &["IsSafe"];

/// The properties in `DeviceState`.
pub const STATE: &[&str] = &["IsSafe"];

/// Unsafe above these, in the unit of each quantity.
const LIMITS: [(Quantity, f64); 4] =
    [(Quantity::RainRate, 0.0), (Quantity::WindSpeed, 15.0), (Quantity::Humidity, 90.0), (Quantity::CloudCover, 80.0)];

/// A safety monitor.
#[derive(Debug, Default)]
pub struct SafetyMonitor {
    /// Reports unsafe whatever the weather.
    pub ordered_unsafe: bool,
}

impl SafetyMonitor {
    /// Whether the dome may be open.
    pub fn is_safe(&self, weather: &Conditions) -> bool {
        !self.ordered_unsafe && LIMITS.iter().all(|(quantity, limit)| weather.of(*quantity) <= *limit)
    }

    /// Answers a GET.
    pub fn get(&self, request: &Request, weather: &Conditions) -> Answer {
        match request.member.as_str() {
            "issafe" => Ok(json!(self.is_safe(weather))),
            _ => Err(Refusal::UnknownMember),
        }
    }
}
