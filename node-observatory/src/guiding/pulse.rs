//! Gives guide pulses to a mount, when it may be pushed at all.

use std::time::Duration;

use bus::Received;
use contract::DeviceState;
use contract::device::telescope::{Command, Direction, Fields};
use imaging::guide::Pulses;
use schedule::Row;

use crate::action_error::ActionError;
use crate::authority::Authority;
use crate::command_timeout::command_timeout;
use crate::devices::telescope::Mount;

/// The part of a pulse that the mount executed: when it began, sky s, and how long it was, ms.
pub type Taken = Option<(f64, i32)>;

/// The outcome of a decision's pulses; None for an axis that was not to be pulsed.
#[derive(Debug, Default)]
pub struct Given {
    /// Right ascension.
    pub east: Taken,
    /// Declination.
    pub north: Taken,
    /// Why one was not given.
    pub refused: Option<Refused>,
}

/// A pulse that was not given.
#[derive(Debug)]
pub struct Refused {
    /// Why, in words.
    pub why: String,
    /// It is the mount's doing. Otherwise this node kept it back, because the row ends or the sky is not safe, and
    /// nobody is to be called for that.
    pub by_mount: bool,
}

impl From<String> for Refused {
    fn from(why: String) -> Self {
        Self { why, by_mount: true }
    }
}

impl From<&str> for Refused {
    fn from(why: &str) -> Self {
        why.to_owned().into()
    }
}

impl Given {
    /// So many frames in a row were followed by pulses that the mount did not take, after this one.
    pub fn refusals(&self, before: u32) -> u32 {
        match &self.refused {
            None => 0,
            Some(refused) => before + u32::from(refused.by_mount),
        }
    }
}

/// A slew that keeps a pulse from its mount shows itself within this, machine time.
const SLEW_SEEN: Duration = Duration::from_secs(3);
/// It is over within this, machine time.
const SLEW_OVER: Duration = Duration::from_secs(300);
/// A pulse is over within this beyond its length, sky time.
const OVER_WITHIN: Duration = Duration::from_secs(10);

/// The objection to pulses now, if there is one. Only a state that is known to be good is good.
pub fn objection(authority: &Authority, row: &Row, mount: &Mount) -> Option<Refused> {
    if let Some(objection) = authority.objection(Some(row)) {
        return Some(Refused { why: objection.to_string(), by_mount: false });
    }
    if authority.node.bus.clock().utc() >= row.end {
        return Some(Refused { why: "the row's window has ended".to_owned(), by_mount: false });
    }
    let why = match mount.instrument.fresh() {
        None => "the mount does not report on which side of the pier it is",
        Some(state) if state.fields.slewing.known() != Some(&false) => "the mount slews",
        Some(state) if state.fields.tracking.known() != Some(&true) => "the mount does not track",
        Some(state) if state.fields.at_park.known() == Some(&true) => "the mount is parked",
        Some(_) => return None,
    };
    Some(why.into())
}

/// Gives both pulses, one after the other: ASCOM lets a mount refuse a second one while the first runs.
pub async fn give(authority: &Authority, row: &Row, mount: &Mount, pulses: Pulses) -> Given {
    let mut given = Given::default();
    if pulses.east_ms != 0 {
        let direction = if pulses.east_ms > 0 { Direction::East } else { Direction::West };
        given.east = Some(push(authority, row, mount, direction, pulses.east_ms, &mut given.refused).await);
    }
    if pulses.north_ms != 0 {
        let direction = if pulses.north_ms > 0 { Direction::North } else { Direction::South };
        given.north = Some(push(authority, row, mount, direction, pulses.north_ms, &mut given.refused).await);
    }
    given
}

/// Gives one pulse and waits for its end. A pulse of which nobody knows whether the mount took it counts as given: the
/// next frame shows what is true.
async fn push(
    authority: &Authority,
    row: &Row,
    mount: &Mount,
    direction: Direction,
    signed_ms: i32,
    refused: &mut Option<Refused>,
) -> (f64, i32) {
    let clock = authority.node.bus.clock();
    if let Some(why) = objection(authority, row, mount) {
        refused.get_or_insert(why);
        return (clock.utc().seconds(), 0);
    }
    let begun_s = clock.utc().seconds();
    match pulse(mount, direction, signed_ms.unsigned_abs()).await {
        Ok(()) => (begun_s, signed_ms),
        Err(error) => {
            let is_taken = !matches!(error, ActionError::Refused { .. } | ActionError::Unanswered { .. });
            refused.get_or_insert(error.to_string().into());
            (begun_s, if is_taken { signed_ms } else { 0 })
        }
    }
}

/// Gives a pulse of so many ms and waits until it is over.
pub async fn pulse(mount: &Mount, direction: Direction, duration_ms: u32) -> Result<(), ActionError> {
    let mount = &mount.instrument;
    // No turn is waited for: a pulse that comes late pushes a field that is elsewhere by then.
    let id = mount.ask(Command::PulseGuide { direction, duration_ms }).await?;
    let most = command_timeout(mount.clock(), Duration::from_millis(u64::from(duration_ms)) + OVER_WITHIN);
    let slews = |wanted| {
        move |received: &Received<DeviceState<Fields>>| {
            (received.sample.body.fields.slewing.known() == Some(&wanted)).then_some(())
        }
    };
    match mount.done(&id, "pulse_guide", most).await {
        // Somebody moves the mount meanwhile, which then takes no pulses: the next frame shows where it is.
        Err(failed @ ActionError::Failed { .. }) => match mount.until(SLEW_SEEN, "slewing", slews(true)).await {
            Ok(()) => mount.until(SLEW_OVER, "at rest", slews(false)).await,
            Err(_) => Err(failed),
        },
        done => done.map(|_| ()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_pulses_that_the_mount_did_not_take_are_counted() {
        let given = |by_mount: Option<bool>| {
            let refused = by_mount.map(|by_mount| Refused { why: "why".to_owned(), by_mount });
            Given { refused, ..Given::default() }
        };
        let after = |frames: &[Option<bool>]| frames.iter().fold(0, |before, frame| given(*frame).refusals(before));
        assert_eq!(after(&[Some(true), Some(true), Some(true)]), 3);
        assert_eq!(after(&[Some(false), Some(false), Some(false)]), 0, "the row's window has ended");
        assert_eq!(after(&[Some(true), Some(false), Some(true)]), 2);
        assert_eq!(after(&[Some(true), None, Some(true)]), 1);
    }
}
