//! The filter wheel: filters by name.

use std::time::Duration;

use contract::device::filter_wheel::{self, Command};

use super::instrument::Instrument;
use crate::action_error::ActionError;

/// A filter wheel.
pub struct FilterWheel {
    /// The device.
    pub instrument: Instrument<filter_wheel::FilterWheel>,
}

/// The slowest wheel needs less for a full turn, sky time.
const TURN: Duration = Duration::from_secs(120);

impl FilterWheel {
    /// Brings a filter into the beam; returns its focus offset, steps.
    pub async fn turn_to(&self, filter: &str) -> Result<i64, ActionError> {
        let can = self.instrument.capabilities().await?;
        let index = can.names.iter().position(|name| name == filter).ok_or_else(|| {
            let (device, names) = (&self.instrument.device, can.names.join(", "));
            ActionError::Impossible(format!("{device} has no filter {filter:?}; it has {names}"))
        })?;
        let position = u32::try_from(index).unwrap_or(u32::MAX);
        let now = self.instrument.fresh().and_then(|state| state.fields.position.known().copied());
        if now != Some(position) {
            self.instrument.execute(Command::Turn { position }, TURN).await?;
        }
        Ok(can.focus_offsets.get(index).copied().unwrap_or(0))
    }

    /// Focus offset of a filter by the wheel, steps; `None` for a filter that it does not have, or while it is silent.
    pub fn offset_of(&self, filter: &str) -> Option<i64> {
        let can = self.instrument.can()?;
        let index = can.names.iter().position(|name| name == filter)?;
        Some(can.focus_offsets.get(index).copied().unwrap_or(0))
    }

    /// Name of the filter in the beam, where it is known.
    pub fn filter(&self) -> Option<String> {
        self.instrument.fresh().and_then(|state| state.fields.filter.known().cloned())
    }
}
