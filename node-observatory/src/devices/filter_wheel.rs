//! The filter wheel: filters by name.

use std::time::Duration;

use contract::device::filter_wheel::{self, Command};

use super::instrument::Instrument;
use crate::action_error::ActionError;

/// A filter wheel.
pub struct FilterWheel {
    /// The device.
    pub instrument: Instrument<filter_wheel::FilterWheel>,
    /// The names of its filters as configured, for a wheel that does not report them.
    pub filters: Vec<String>,
}

/// The slowest wheel needs less for a full turn, sky time.
const TURN: Duration = Duration::from_secs(120);

impl FilterWheel {
    /// Brings a filter into the beam; returns its focus offset, steps.
    pub async fn turn_to(&self, filter: &str) -> Result<i64, ActionError> {
        let can = self.instrument.capabilities_with(&["Names", "FocusOffsets"]).await?;
        let index = match place(&can.names, &self.filters, filter) {
            Ok(index) => index,
            Err(_) if self.instrument.is_unread("Names") && self.filters.is_empty() => {
                let (device, verb) = (self.instrument.device.to_string(), "turn".to_owned());
                let reason = "the names of its filters could not be read yet; give them as \"filters\" in its block";
                return Err(ActionError::Failed { device, verb, reason: reason.to_owned() });
            }
            Err(names) => {
                let device = &self.instrument.device;
                return Err(ActionError::Impossible(format!("{device} has no filter {filter:?}; it has {names}")));
            }
        };
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
        let index = place(&can.names, &self.filters, filter).ok()?;
        Some(can.focus_offsets.get(index).copied().unwrap_or(0))
    }

    /// Name of the filter in the beam, where it is known.
    pub fn filter(&self) -> Option<String> {
        let fields = self.instrument.fresh()?.fields;
        let configured = || self.filters.get(*fields.position.known()? as usize).cloned();
        fields.filter.known().cloned().or_else(configured)
    }
}

/// The position of a filter by the names that the wheel reports, or by the configured ones where it reports none; an
/// error with all names.
fn place(reported: &[String], configured: &[String], filter: &str) -> Result<usize, String> {
    let names = if reported.is_empty() { configured } else { reported };
    names.iter().position(|name| name == filter).ok_or_else(|| names.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wheel_that_reports_no_names_has_the_configured_ones() {
        let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        assert_eq!(place(&names(&["R", "G"]), &names(&["G", "R"]), "G"), Ok(1));
        assert_eq!(place(&[], &names(&["G", "R"]), "G"), Ok(0));
        assert_eq!(place(&names(&["R", "G"]), &names(&["V"]), "V"), Err("R, G".to_owned()));
        assert_eq!(place(&[], &[], "V"), Err(String::new()));
    }
}
