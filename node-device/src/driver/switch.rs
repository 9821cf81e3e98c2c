//! Switches and gauges.

use std::sync::{Mutex, PoisonError};

use alpaca::{Abilities, Alpaca, AlpacaError, value};
use config::Limit;
use contract::device::switch::{self, Capabilities, Command, Fields, SwitchDescription, number_of};
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
    /// The safety limits on its values.
    limits: Vec<Limit>,
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
    /// Switches with these limits.
    pub fn new(limits: &[Limit]) -> Self {
        Self { limits: limits.to_vec(), ..Self::default() }
    }

    fn scales(&self) -> Vec<Scale> {
        self.scales.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn property(number: usize) -> String {
    format!("GetSwitchValue{number}")
}

/// A value outside of the switch's range is the code of something broken, and no value. The range is what its limits give
/// as `possible`, else what its server gives. Without a range no value decides.
fn believed(value: Datum<f64>, scale: Scale, limits: &[&Limit]) -> Datum<f64> {
    let Some(number) = value.known().copied() else { return value };
    let given: Vec<_> = limits.iter().filter_map(|limit| limit.possible).map(|[low, high]| (low, high)).collect();
    let own = scale.low.zip(scale.high).filter(|(low, high)| low < high);
    let ranges: Vec<(f64, f64)> = if given.is_empty() { own.into_iter().collect() } else { given };
    if ranges.is_empty() && !limits.is_empty() {
        let detail = "the server gives no range for this switch, so that no value of it is believed; write possible = \
                      [smallest value, largest value] in its limit";
        return Datum::missing(NoData::new("missing", detail));
    }
    match ranges.iter().find(|range| !is_within(number, **range)) {
        Some((low, high)) => {
            let detail = format!("{number} is not possible; expected {low} to {high}");
            Datum::missing(NoData::new("wrong type", detail))
        }
        None => value,
    }
}

/// NaN is not within.
fn is_within(value: f64, (low, high): (f64, f64)) -> bool {
    // Servers round their numbers.
    let room = 1e-6 * (high - low);
    (low - room..=high + room).contains(&value)
}

impl Driver for Switch {
    type Kind = switch::Switch;

    fn polled(&self) -> Vec<String> {
        (0..self.scales().len()).map(property).collect()
    }

    async fn capabilities(&self, abilities: &mut Abilities) -> Result<Capabilities, AlpacaError> {
        let count = abilities.read("MaxSwitch", value::whole_in(0..=i64::from(i16::MAX))).await?.unwrap_or(0).min(MOST);
        // A switch without these has two values; those that could not be read are no limits.
        let bound = |answer: &Result<f64, NoData>, of_two: f64, unread: f64| match answer {
            Ok(bound) => *bound,
            Err(reason) if *reason == NoData::not_implemented() => of_two,
            Err(_) => unread,
        };
        let (mut switches, mut scales) = (Vec::new(), Vec::new());
        for number in 0..count {
            let id = Some(number);
            let mut low = abilities.read_of("MinSwitchValue", id, value::number).await?;
            let mut high = abilities.read_of("MaxSwitchValue", id, value::number).await?;
            if let (Ok(least), Ok(most)) = (&low, &high)
                && least > most
            {
                let detail = format!("MinSwitchValue is {least:?}, and MaxSwitchValue only {most:?}");
                let why = NoData::new("wrong type", detail);
                for property in ["MinSwitchValue", "MaxSwitchValue"] {
                    abilities.doubt(&format!("{property}({number})"), &why);
                }
                (low, high) = (Err(why.clone()), Err(why));
            }
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
        let value = |(number, scale): (usize, Scale)| {
            let of_it = |limit: &&Limit| number_of(&limit.parameter) == Some(number);
            let limits: Vec<&Limit> = self.limits.iter().filter(of_it).collect();
            believed(readings.number(&property(number)), scale, &limits)
        };
        Fields { values: self.scales().into_iter().enumerate().map(value).collect() }
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
    use serde_json::json;
    use units::Utc;

    use super::*;

    /// What is published of a switch whose server gives this range and value.
    fn read(limits: &str, range: Option<(f64, f64)>, value: f64) -> Datum<f64> {
        let text = format!(
            "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0\nlongitude_deg = 0\nelevation_m = 0\n\
             [[switch]]\nname = \"ups\"\nserver = \"h:1\"\nlimit = [{limits}]\n"
        );
        let config = config::parse(&text, std::path::Path::new("/")).unwrap();
        let switch = Switch::new(&config.switch[0].limit);
        let scale = Scale { low: range.map(|range| range.0), high: range.map(|range| range.1), step: None };
        *switch.scales.lock().unwrap() = vec![scale];
        let mut readings = Readings::default();
        readings.keep("GetSwitchValue0", Ok(json!(value)), Utc::EPOCH);
        switch.fields(&readings).values.remove(0)
    }

    #[test]
    fn no_value_of_a_switch_with_a_limit_is_believed_without_a_range() {
        let why =
            |limits: &str, range, value| read(limits, range, value).as_result().copied().map_err(ToString::to_string);
        let limit = "{ parameter = \"GetSwitchValue0\", lower = 50 }";
        let no_range = why(limit, None, 65535.0).unwrap_err();
        assert!(no_range.contains("no range") && no_range.contains("write possible = ["), "{no_range}");
        assert!(why(limit, None, 80.0).is_err() && why(limit, Some((0.0, 0.0)), 80.0).is_err());
        assert_eq!(why(limit, Some((0.0, 100.0)), 80.0), Ok(80.0));
        let ranged = "{ parameter = \"GetSwitchValue0\", lower = 50, possible = [0, 100] }";
        let outside: Result<f64, String> = Err("wrong type: 65535 is not possible; expected 0 to 100".to_owned());
        assert_eq!((why(ranged, None, 80.0), why(ranged, None, 65535.0)), (Ok(80.0), outside.clone()));
        assert_eq!(why(ranged, Some((0.0, 65535.0)), 65535.0), outside, "the file knows more than the server");
        assert_eq!(why(ranged, Some((0.0, 1.0)), 80.0), Ok(80.0), "the file knows more than the server");
        let tiers = format!("{ranged}, {limit}");
        assert_eq!(why(&tiers, None, 65535.0), outside, "a range of one limit is that of the switch");
        let of_another = "{ parameter = \"GetSwitchValue1\", lower = 50 }";
        assert_eq!(why(of_another, None, 65535.0), Ok(65535.0), "nothing decides by it");
    }

    #[test]
    fn a_value_outside_of_the_switchs_own_range_is_no_value() {
        let read = |value, range| read("", Some(range), value).known().copied();
        assert_eq!((read(12.6, (0.0, 15.0)), read(15.0, (0.0, 15.0))), (Some(12.6), Some(15.0)));
        assert_eq!((read(-1.0, (0.0, 15.0)), read(65535.0, (0.0, 15.0))), (None, None));
        assert!(!is_within(f64::NAN, (0.0, 15.0)));
    }
}
