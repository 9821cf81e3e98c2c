//! Switches and gauges.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};

use alpaca::{Abilities, Alpaca, AlpacaError, value};
use contract::device::switch::{self, Capabilities, Command, Fields, SwitchDescription};
use contract::{CommandId, NoData, Reason};
use interlock::Need;

use super::{Driver, Executed, on_grid, within};
use crate::readings::Readings;

/// More switches than this are a server's mistake.
const MOST: i64 = 256;

/// Drives a set of switches.
#[derive(Default)]
pub struct Switch {
    count: AtomicU32,
    /// First value and step of each, as far as they are known.
    grids: Mutex<Vec<(f64, Option<f64>)>>,
}

impl Switch {
    fn properties(&self) -> impl Iterator<Item = String> {
        (0..self.count.load(Ordering::Relaxed)).map(|number| format!("GetSwitchValue{number}"))
    }
}

impl Driver for Switch {
    type Kind = switch::Switch;

    fn polled(&self) -> Vec<String> {
        self.properties().collect()
    }

    async fn capabilities(&self, abilities: &mut Abilities) -> Result<Capabilities, AlpacaError> {
        let count = abilities.read("MaxSwitch", value::whole).await?.unwrap_or(0).clamp(0, MOST);
        // A switch without these has two values; those that could not be read are no limits.
        let bound = |answer: Result<f64, NoData>, of_two: f64, unread: f64| match answer {
            Ok(bound) => bound,
            Err(reason) if reason == NoData::not_implemented() => of_two,
            Err(_) => unread,
        };
        let mut switches = Vec::new();
        for number in 0..count {
            let id = Some(number);
            switches.push(SwitchDescription {
                name: abilities.read_of("GetSwitchName", id, value::text).await?.unwrap_or_default(),
                // Where that could not be read, the device decides.
                can_write: match abilities.read_of("CanWrite", id, value::flag).await? {
                    Ok(can_write) => can_write,
                    Err(reason) => reason != NoData::not_implemented(),
                },
                minimum: bound(abilities.read_of("MinSwitchValue", id, value::number).await?, 0.0, f64::MIN),
                maximum: bound(abilities.read_of("MaxSwitchValue", id, value::number).await?, 1.0, f64::MAX),
                step: abilities.read_of("SwitchStep", id, value::number).await?.ok().filter(|step| *step > 0.0),
            });
        }
        *self.grids.lock().unwrap_or_else(PoisonError::into_inner) =
            switches.iter().map(|switch| (switch.minimum, switch.step)).collect();
        self.count.store(u32::try_from(count).unwrap_or(0), Ordering::Relaxed);
        Ok(Capabilities { switches })
    }

    fn fields(&self, readings: &Readings) -> Fields {
        Fields { values: self.properties().map(|property| readings.number(&property)).collect() }
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
        let grid = self.grids.lock().unwrap_or_else(PoisonError::into_inner).get(*number as usize).copied();
        let (origin, step) = grid.unwrap_or((0.0, None));
        // From a first value that is not known there is no grid.
        let value = on_grid(*value, origin, step.filter(|_| origin > f64::MIN));
        // The switch may round as well, so its answer is the proof, not its value.
        alpaca.put("setswitchvalue", &[("Id", &number.to_string()), ("Value", &value.to_string())]).await?;
        Ok(Executed::Done)
    }
}
