//! The filter wheel.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use alpaca::{Abilities, Alpaca, AlpacaError, value};
use contract::device::filter_wheel::{self, Capabilities, Command, Fields};
use contract::{CommandId, Datum, NoData, Reason};
use interlock::Need;

use super::{Driver, Executed, Progress};
use crate::readings::Readings;

/// Why there is no position while it turns.
fn turns() -> NoData {
    NoData::new("missing", "the wheel turns")
}

/// Drives a filter wheel.
#[derive(Default)]
pub struct FilterWheel {
    names: Mutex<Vec<String>>,
}

impl Driver for FilterWheel {
    type Kind = filter_wheel::FilterWheel;

    fn polled(&self) -> Vec<String> {
        vec!["Position".to_owned()]
    }

    fn moving(&self) -> &'static [&'static str] {
        &["Position"]
    }

    async fn capabilities(&self, abilities: &mut Abilities) -> Result<Capabilities, AlpacaError> {
        let names = abilities.read("Names", |names| value::list(names, value::text)).await?.unwrap_or_default();
        let offsets = abilities.read("FocusOffsets", |offsets| value::list(offsets, value::whole)).await?;
        *self.names.lock().unwrap_or_else(PoisonError::into_inner) = names.clone();
        Ok(Capabilities { names, focus_offsets: offsets.unwrap_or_default() })
    }

    fn fields(&self, readings: &Readings) -> Fields {
        let position = match readings.whole("Position") {
            Datum::Known(number) => match u32::try_from(number) {
                Ok(position) => Datum::Known(position),
                // ASCOM: -1 while it turns.
                Err(_) => Datum::missing(turns()),
            },
            Datum::Missing { no_data } => Datum::missing(no_data),
        };
        let names = self.names.lock().unwrap_or_else(PoisonError::into_inner);
        let filter = match &position {
            Datum::Known(position) => names
                .get(*position as usize)
                .cloned()
                .ok_or_else(|| NoData::new("missing", format!("position {position} has no name")))
                .into(),
            Datum::Missing { no_data } => Datum::missing(no_data.clone()),
        };
        Fields { position, filter }
    }

    fn is_busy(&self, fields: &Fields) -> bool {
        fields.position.known().is_none()
    }

    fn contradiction(&self, command: Option<&Command>, fields: &Fields) -> Option<String> {
        let turns = fields.position.as_result().is_err_and(|reason| *reason == turns());
        (command.is_none() && turns).then(|| "Position is -1 (it turns), and no turn was commanded".to_owned())
    }

    fn need(&self, _: &Command) -> Need {
        Need::Token
    }

    fn refuse(&self, _: &CommandId, command: &Command, can: &Capabilities, _: &Fields) -> Option<(Reason, String)> {
        let Command::Turn { position } = command;
        let count = can.names.len();
        let fits = count == 0 || (*position as usize) < count;
        (!fits).then(|| (Reason::Malformed, format!("position {position}: the wheel has {count}, counted from 0")))
    }

    async fn execute(
        &self,
        alpaca: &Alpaca,
        _: &CommandId,
        command: &Command,
        _: &Fields,
    ) -> Result<Executed, AlpacaError> {
        let Command::Turn { position } = command;
        alpaca.put("position", &[("Position", &position.to_string())]).await?;
        Ok(Executed::Watch)
    }

    fn limit(&self, _: &Command) -> Duration {
        Duration::from_secs(120)
    }

    fn progress(&self, command: &Command, fields: &Fields) -> Progress {
        let Command::Turn { position } = command;
        match fields.position.known() {
            Some(now) if now == position => Progress::Done,
            Some(now) => Progress::Stranded {
                off: f64::from(*now) - f64::from(*position),
                why: format!("it rests at position {now}, not at {position}"),
            },
            None => Progress::Running,
        }
    }
}
