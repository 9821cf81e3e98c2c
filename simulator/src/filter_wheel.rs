//! The filter wheel: names, focus offsets, and a turn that takes time.

use serde_json::{Value, json};

use crate::answer::{Answer, DONE, Refusal};
use crate::options::Filter;
use crate::request::Request;
use crate::travel::Travel;

/// Properties that are read without parameters, in ASCOM's case.
pub const PROPERTIES: &[&str] = &["FocusOffsets", "Names", "Position"];

/// The properties in `DeviceState`.
pub const STATE: &[&str] = &["Position"];

/// Filters per sky second.
const SPEED: f64 = 1.0;

/// A filter wheel.
#[derive(Debug)]
pub struct FilterWheel {
    filters: Vec<Filter>,
    travel: Travel,
}

impl FilterWheel {
    /// At the first filter; a wheel without filters gets a clear one.
    pub fn new(filters: &[Filter]) -> Self {
        let filters = if filters.is_empty() { vec![Filter::new("Clear", 0, 1.0)] } else { filters.to_vec() };
        Self { filters, travel: Travel::resting(0.0, SPEED) }
    }

    /// The filter in the light path, and what it lets through: nothing while the wheel turns.
    pub fn filter(&self) -> (&Filter, f64) {
        let filter = &self.filters[(self.travel.at().round() as usize).min(self.filters.len() - 1)];
        (filter, if self.travel.is_moving() { 0.0 } else { filter.transmission })
    }

    /// Lets sky time pass.
    pub fn advance(&mut self, dt: f64) {
        self.travel.advance(dt);
    }

    /// Answers a GET.
    pub fn get(&self, request: &Request) -> Answer {
        Ok(match request.member.as_str() {
            "focusoffsets" => self.filters.iter().map(|filter| Value::from(filter.focus_offset)).collect(),
            "names" => self.filters.iter().map(|filter| Value::from(filter.name.as_str())).collect(),
            "position" => json!(if self.travel.is_moving() { -1 } else { self.travel.at() as i32 }),
            _ => return Err(Refusal::UnknownMember),
        })
    }

    /// Executes a PUT.
    pub fn put(&mut self, request: &Request) -> Answer {
        match request.member.as_str() {
            "position" => {
                let position = request.integer("Position")?;
                if !usize::try_from(position).is_ok_and(|position| position < self.filters.len()) {
                    return Err(Refusal::invalid_value(format!("there is no filter {position}")));
                }
                self.travel.send(f64::from(position));
            }
            _ => return Err(Refusal::UnknownMember),
        }
        DONE
    }
}
