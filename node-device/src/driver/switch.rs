//! Switches and gauges.

use std::sync::{Mutex, PoisonError};

use alpaca::{Alpaca, AlpacaError, optional, value};
use contract::device::switch::{self, Capabilities, Command, Fields, SwitchDescription};
use contract::{CommandId, Datum, NoData, Reason};
use interlock::Need;

use super::{Driver, Executed, within};
use crate::readings::Readings;

/// More switches than this are a server's mistake.
const MOST: i64 = 256;

/// Drives a set of switches.
#[derive(Default)]
pub struct Switch {
    /// For each switch its own smallest and largest value, where its server has given both.
    ranges: Mutex<Vec<Option<(f64, f64)>>>,
}

impl Switch {
    fn ranges(&self) -> Vec<Option<(f64, f64)>> {
        self.ranges.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn property(number: usize) -> String {
    format!("GetSwitchValue{number}")
}

/// A value outside of the switch's own range is the code of something broken, and no value.
fn believed(value: Datum<f64>, range: Option<(f64, f64)>) -> Datum<f64> {
    match (value, range) {
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
        (0..self.ranges().len()).map(property).collect()
    }

    async fn capabilities(&self, alpaca: &Alpaca) -> Result<Capabilities, AlpacaError> {
        let count = optional(alpaca, "maxswitch", value::whole).await?.unwrap_or(0).clamp(0, MOST);
        let (mut switches, mut ranges) = (Vec::new(), Vec::new());
        for number in 0..count {
            let id = number.to_string();
            let id = [("Id", id.as_str())];
            let minimum = about(alpaca, "minswitchvalue", &id, value::number).await?;
            let maximum = about(alpaca, "maxswitchvalue", &id, value::number).await?;
            ranges.push(minimum.zip(maximum).filter(|(low, high)| low < high));
            switches.push(SwitchDescription {
                name: about(alpaca, "getswitchname", &id, value::text).await?.unwrap_or_default(),
                can_write: about(alpaca, "canwrite", &id, value::flag).await?.unwrap_or(false),
                minimum: minimum.unwrap_or(0.0),
                maximum: maximum.unwrap_or(1.0),
            });
        }
        *self.ranges.lock().unwrap_or_else(PoisonError::into_inner) = ranges;
        Ok(Capabilities { switches })
    }

    fn fields(&self, readings: &Readings) -> Fields {
        let ranges = self.ranges().into_iter().enumerate();
        Fields { values: ranges.map(|(number, range)| believed(readings.number(&property(number)), range)).collect() }
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
        // The switch rounds to its own step, so its answer is the proof, not its value.
        alpaca.put("setswitchvalue", &[("Id", &number.to_string()), ("Value", &value.to_string())]).await?;
        Ok(Executed::Done)
    }
}

async fn about<T>(
    alpaca: &Alpaca,
    member: &str,
    id: &[(&str, &str)],
    read: impl Fn(&serde_json::Value) -> Result<T, contract::NoData>,
) -> Result<Option<T>, AlpacaError> {
    match alpaca.get_with(member, id).await {
        Ok(answer) => Ok(read(&answer).ok()),
        Err(error) if error.is_transport() => Err(error),
        Err(_) => Ok(None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_outside_of_the_switchs_own_range_is_no_value() {
        let read = |value, range| believed(Datum::Known(value), range).known().copied();
        assert_eq!((read(12.6, Some((0.0, 15.0))), read(15.0, Some((0.0, 15.0)))), (Some(12.6), Some(15.0)));
        assert_eq!((read(-1.0, Some((0.0, 15.0))), read(65535.0, Some((0.0, 15.0)))), (None, None));
        assert_eq!(read(f64::NAN, Some((0.0, 15.0))), None);
        assert_eq!(read(12.6, None), Some(12.6), "a server that gives no range");
    }
}
