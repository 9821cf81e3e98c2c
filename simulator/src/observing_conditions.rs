//! The weather station: ASCOM's view of the weather.

use serde_json::json;

use crate::answer::{Answer, DONE, Refusal, within};
use crate::request::Request;
use crate::weather::{Conditions, Quantity};

/// Properties that are read without parameters, in ASCOM's case.
pub const PROPERTIES: &[&str] = &{
    let mut names = ["AveragePeriod"; Quantity::ALL.len() + 1];
    let mut index = 0;
    while index < Quantity::ALL.len() {
        names[index + 1] = Quantity::ALL[index].ascom();
        index += 1;
    }
    names
};

/// The properties in `DeviceState`: all that are measured.
pub const STATE: &[&str] = PROPERTIES.split_at(1).1;

/// A weather station.
#[derive(Debug, Default)]
pub struct ObservingConditions {
    average_h: f64,
}

impl ObservingConditions {
    /// Answers a GET.
    pub fn get(&self, request: &Request, weather: &Conditions) -> Answer {
        if let Some(quantity) = Quantity::named(&request.member) {
            return Ok(json!(weather.of(quantity)));
        }
        Ok(match request.member.as_str() {
            "averageperiod" => json!(self.average_h),
            "sensordescription" => json!(format!("simulated {} sensor", sensor(request)?.ascom())),
            "timesincelastupdate" => {
                // Without a name ASCOM means the latest of all sensors.
                if !request.text("SensorName")?.is_empty() {
                    sensor(request)?;
                }
                json!(0.0)
            }
            _ => return Err(Refusal::UnknownMember),
        })
    }

    /// Executes a PUT.
    pub fn put(&mut self, request: &Request) -> Answer {
        match request.member.as_str() {
            "averageperiod" => self.average_h = within("AveragePeriod", request.number("AveragePeriod")?, 0.0, 24.0)?,
            "refresh" => {}
            _ => return Err(Refusal::UnknownMember),
        }
        DONE
    }
}

fn sensor(request: &Request) -> Result<Quantity, Refusal> {
    let name = request.text("SensorName")?;
    Quantity::named(name).ok_or_else(|| Refusal::invalid_value(format!("there is no sensor {name:?}")))
}
