//! The steps by which a mount is stopped that tracks beyond a limit; pure.
//!
//! ```text
//!  tracking off --5 s--> abort, tracking off --5 s--> park --30 s, or the time of a slew--> not stopped
//! ```
//! "Not stopped" is published: the observatory node then closes and ends exposures. The orders go on for ever. Whether a
//! step has helped is judged by [`super::LimitWatch`] from readings that were asked for after it. While the mount says that
//! it slews, the next step waits: it may slow down after an abort, or somebody may slew it away.

use std::time::Duration;

use bus::MachineTime;
use contract::device::telescope::{BeyondLimit, Command};

use crate::mount_sight::Ordered;

/// An order that did not help is followed by the next one so much later.
const RETRY: Duration = Duration::from_secs(5);
/// A mount that says that it does not track has so long to show it by its coordinates.
const SHOWN: Duration = Duration::from_secs(15);
/// A mount that was ordered to stop, and says that it slews, has so long to come to rest.
const SLEWS: Duration = Duration::from_secs(300);
/// A mount that was ordered to park and does not slew has so long to be parked or to move.
const PARK_BEGINS: Duration = Duration::from_secs(30);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    Off,
    Abort,
    Park,
    NotStopped,
}

/// What a mount says of itself after an order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Says {
    /// It goes to a target.
    Slews,
    /// It does not track.
    StandsStill,
    /// It tracks, or nothing that was asked for since.
    Nothing,
}

/// A mount that is being stopped.
#[derive(Debug)]
pub struct Stopping {
    why: String,
    step: Step,
    /// When the newest order was given.
    given: Option<MachineTime>,
    /// When it was first ordered to park.
    parks_since: Option<MachineTime>,
    /// The newest order was to park.
    parked_last: bool,
    /// It has slewed since it was first ordered to stop.
    has_slewed: bool,
}

impl Stopping {
    /// Begins, for this reason.
    pub fn begin(why: String) -> Self {
        Self { why, step: Step::Off, given: None, parks_since: None, parked_last: false, has_slewed: false }
    }

    /// Somebody has ordered it to go since the newest order to stop. Once it was ordered to park, a slew may be that.
    pub fn is_sent_away(&self, ordered: Option<(Ordered, MachineTime)>) -> bool {
        let goes = matches!(ordered, Some((Ordered::Go, at)) if self.given.is_none_or(|given| at > given));
        goes && self.parks_since.is_none()
    }

    /// It has slewed since it was first ordered to stop, and may be elsewhere.
    pub fn has_slewed(&self) -> bool {
        self.has_slewed
    }

    /// What is due now, by what the mount has said since the newest order; `park`: how long a park may take, where it can.
    pub fn look(&mut self, now: MachineTime, says: Says, park: Option<Duration>) -> Vec<Command> {
        self.has_slewed |= says == Says::Slews;
        let Some(given) = self.given else { return self.order(Step::Off, now, park) };
        let waits = match self.step {
            Step::Off | Step::Abort if says == Says::Slews => SLEWS,
            Step::Off | Step::Abort if says == Says::StandsStill => SHOWN,
            Step::Off | Step::Abort => RETRY,
            Step::Park | Step::NotStopped if says == Says::Slews && self.parked_last => park.unwrap_or(PARK_BEGINS),
            Step::Park | Step::NotStopped if park.is_some() => PARK_BEGINS,
            Step::Park | Step::NotStopped => RETRY,
        };
        if now.since(given) < waits {
            return Vec::new();
        }
        let next = match self.step {
            Step::Off => Step::Abort,
            Step::Abort if park.is_some() => Step::Park,
            Step::Abort | Step::Park | Step::NotStopped => Step::NotStopped,
        };
        self.order(next, now, park)
    }

    fn order(&mut self, step: Step, now: MachineTime, park: Option<Duration>) -> Vec<Command> {
        (self.step, self.given) = (step, Some(now));
        let off = Command::Track { on: false };
        // In the end it is stopped and parked in turn, since nobody knows which of them may help.
        let parks = step == Step::Park || (step == Step::NotStopped && park.is_some() && !self.parked_last);
        self.parked_last = parks;
        if parks {
            self.parks_since.get_or_insert(now);
            return vec![Command::Park];
        }
        if step == Step::Off { vec![off] } else { vec![Command::Abort, off] }
    }

    /// What is published.
    pub fn published(&self) -> BeyondLimit {
        BeyondLimit { why: self.why.clone(), not_stopped: self.step == Step::NotStopped }
    }

    /// The cause for the alert, which says what is done.
    pub fn cause(&self) -> String {
        let done = match self.step {
            Step::Off => "its tracking is switched off",
            Step::Abort => "it goes on tracking: all its movement is aborted",
            Step::Park => "neither stopped it: it is sent to its park position",
            Step::NotStopped => "no order stops it: everything is closed, and nothing is exposed; stop it by hand",
        };
        format!("{}; {done}", self.why)
    }
}
