//! Switches and gauges.

use std::sync::{Mutex, PoisonError};

use alpaca::{Abilities, Alpaca, AlpacaError, value};
use contract::device::switch::{self, Capabilities, Command, Fields, SwitchDescription};
use contract::{CommandId, Datum, NoData, Reason};
use interlock::Need;

use super::{Driver, Executed, on_grid, within};
use crate::readings::Readings;

/// More switches than this are a server's mistake.
const MOST: i64 = 256;

/// Drives a set of switches.
#[derive(Default)]
pub struct Switch {
    scales: Mutex<Vec<Scale>>,
}

/// The values that a switch takes, as far as its server has given them.
#[derive(Clone, Copy, Default)]
struct Scale {
    /// Its smallest value.
    low: Option<f64>,
    /// Its largest value.
    high: Option<f64>,
    step: Option<f64>,
}

impl Switch {
    fn scales(&self) -> Vec<Scale> {
        self.scales.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn property(number: usize) -> String {
    format!("GetSwitchValue{number}")
}

/// A value outside of the switch's own range is the code of something broken, and no value.
fn believed(value: Datum<f64>, scale: Scale) -> Datum<f64> {
    match (value, scale.low.zip(scale.high).filter(|(low, high)| low < high)) {
        // Servers round their numbers.
        (Datum::Known(value), Some((low, high)))
            if !(low - 1e-6 * (high - low)..=high + 1e-6 * (high - low)).contains(&value) =>
        {
            let detail = format!("{value} is not possible; the switch's own range is {low} to {high}");
            Datum::missing(NoData::new("wrong type", detail))
        }
        (value, _) => value,
    }
}

impl Driver for Switch {
    type Kind = switch::Switch;

    fn polled(&self) -> Vec<String> {
        (0..self.scales().len()).map(property).collect()
    }

    async fn capabilities(&self, abilities: &mut Abilities) -> Result<Capabilities, AlpacaError> {
        let count = abilities.read("MaxSwitch", value::whole).await?.unwrap_or(0).clamp(0, MOST);
        // A switch without these has two values; those that could not be read are no limits.
        let bound = |answer: &Result<f64, NoData>, of_two: f64, unread: f64| match answer {
            Ok(bound) => *bound,
            Err(reason) if *reason == NoData::not_implemented() => of_two,
            Err(_) => unread,
        };
        let (mut switches, mut scales) = (Vec::new(), Vec::new());
        for number in 0..count {
            let id = Some(number);
            let low = abilities.read_of("MinSwitchValue", id, value::number).await?;
            let high = abilities.read_of("MaxSwitchValue", id, value::number).await?;
            let step = abilities.read_of("SwitchStep", id, value::number).await?.ok().filter(|step| *step > 0.0);
            switches.push(SwitchDescription {
                name: abilities.read_of("GetSwitchName", id, value::text).await?.unwrap_or_default(),
                // Where that could not be read, the device decides.
                can_write: match abilities.read_of("CanWrite", id, value::flag).await? {
                    Ok(can_write) => can_write,
                    Err(reason) => reason != NoData::not_implemented(),
                },
                minimum: bound(&low, 0.0, f64::MIN),
                maximum: bound(&high, 1.0, f64::MAX),
                step,
            });
            scales.push(Scale { low: low.ok(), high: high.ok(), step });
        }
        *self.scales.lock().unwrap_or_else(PoisonError::into_inner) = scales;
        Ok(Capabilities { switches })
    }

    fn fields(&self, readings: &Readings) -> Fields {
        let scales = self.scales().into_iter().enumerate();
        Fields { values: scales.map(|(number, scale)| believed(readings.number(&property(number)), scale)).collect() }
    }

    fn need(&self, _: &Command) -> Need {
        Need::Token
    }

    fn refuse(&self, _: &CommandId, command: &Command, can: &Capabilities, _: &Fields) -> Option<(Reason, String)> {
        let Command::Set { number, value } = command;
        match can.switches.get(*number as usize) {
            None => Some((Reason::Malformed, format!("switch {number}: there are {}", can.switches.len()))),
            Some(switch) if !switch.can_write => {
                Some((Reason::NotImplemented, format!("switch {number} ({}) is a gauge", switch.name)))
            }
            Some(switch) => within("value", *value, switch.minimum, switch.maximum),
        }
    }

    async fn execute(
        &self,
        alpaca: &Alpaca,
        _: &CommandId,
        command: &Command,
        _: &Fields,
    ) -> Result<Executed, AlpacaError> {
        let Command::Set { number, value } = command;
        let scale = self.scales().get(*number as usize).copied().unwrap_or_default();
        // From a first value that is not known there is no grid.
        let value = on_grid(*value, scale.low.unwrap_or(0.0), scale.step.filter(|_| scale.low.is_some()));
        // The switch may round as well, so its answer is the proof, not its value.
        alpaca.put("setswitchvalue", &[("Id", &number.to_string()), ("Value", &value.to_string())]).await?;
        Ok(Executed::Done)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_outside_of_the_switchs_own_range_is_no_value() {
        let read = |value, range: Option<(f64, f64)>| {
            let scale = Scale { low: range.map(|range| range.0), high: range.map(|range| range.1), step: None };
            believed(Datum::Known(value), scale).known().copied()
        };
        assert_eq!((read(12.6, Some((0.0, 15.0))), read(15.0, Some((0.0, 15.0)))), (Some(12.6), Some(15.0)));
        assert_eq!((read(-1.0, Some((0.0, 15.0))), read(65535.0, Some((0.0, 15.0)))), (None, None));
        assert_eq!(read(f64::NAN, Some((0.0, 15.0))), None);
        assert_eq!(read(12.6, None), Some(12.6), "a server that gives no range");
    }
}
