//! Switches and gauges.

use std::sync::atomic::{AtomicU32, Ordering};

use alpaca::{Alpaca, AlpacaError, optional, value};
use contract::device::switch::{self, Capabilities, Command, Fields, SwitchDescription};
use contract::{CommandId, Reason};
use interlock::Need;

use super::{Driver, Executed, within};
use crate::readings::Readings;

/// More switches than this are a server's mistake.
const MOST: i64 = 256;

/// Drives a set of switches.
#[derive(Default)]
pub struct Switch {
    count: AtomicU32,
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

    async fn capabilities(&self, alpaca: &Alpaca) -> Result<Capabilities, AlpacaError> {
        let count = optional(alpaca, "maxswitch", value::whole).await?.unwrap_or(0).clamp(0, MOST);
        let mut switches = Vec::new();
        for number in 0..count {
            let id = number.to_string();
            let id = [("Id", id.as_str())];
            switches.push(SwitchDescription {
                name: about(alpaca, "getswitchname", &id, value::text).await?.unwrap_or_default(),
                can_write: about(alpaca, "canwrite", &id, value::flag).await?.unwrap_or(false),
                minimum: about(alpaca, "minswitchvalue", &id, value::number).await?.unwrap_or(0.0),
                maximum: about(alpaca, "maxswitchvalue", &id, value::number).await?.unwrap_or(1.0),
            });
        }
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
