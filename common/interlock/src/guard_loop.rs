//! The loop around the guard of one dome: which requests are under way, which reading of the shutter is the newest, and
//! what is due. The device node's `guard_task` performs the effects.

use std::time::Duration;

use contract::device::dome::Shutter;
use contract::observatory::Permit;
use contract::{BootId, Chunk, Device, Stamped};
use units::MachineTime;

use crate::guard::{Alarm, FRESH, Guard, GuardStep};
use crate::mounts_under::MountsUnder;
use crate::parked::ParkReading;
use crate::permit_ledger::{Dropped, Taken};
use crate::report::{DomeReport, nanos};
use crate::request::{Answer, Request};
use crate::watchdog::Watchdog;

/// The guard asks the shutter itself when the dome's own loop is silent for so long.
const SILENT: Duration = Duration::from_millis(2500);
/// An impostor that published nothing for so long is gone.
const GONE: Duration = Duration::from_secs(10);

/// The shutter, and when it was asked for.
pub type ShutterReading = (Shutter, MachineTime);

/// What has happened.
#[derive(Debug, Clone, PartialEq)]
pub enum GuardEvent {
    /// Nothing but that time has passed.
    Tick,
    /// The next number is due.
    Beat,
    /// A permit was received.
    Permit {
        /// Its telescope.
        telescope: Chunk,
        /// The permit.
        sample: Stamped<Permit>,
    },
    /// The state of a mount was received.
    Mount {
        /// The mount.
        device: Device,
        /// The incarnation that published it.
        boot_id: BootId,
        /// What was read of its park.
        reading: ParkReading,
        /// When its flags were read.
        read: MachineTime,
    },
    /// The shutter's reading that this loop had asked for has come, or none.
    Looked(Option<ShutterReading>),
    /// The request to close has come to this.
    Answered(Answer),
    /// A request has ended without any result: none is under way.
    Lost,
}

/// What must be done.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum GuardEffect {
    /// An alarm becomes active.
    Raise(Alarm),
    /// An alarm is no longer active.
    Clear(Alarm),
    /// Send this request to the dome; its result is a [`GuardEvent::Answered`].
    Send(Request),
    /// Read the shutter; the result is a [`GuardEvent::Looked`].
    Look {
        /// The time that counts as that of the question.
        asked: MachineTime,
    },
    /// Feed the dome's own watchdog.
    Feed,
    /// Somebody may publish permits in the commander's name.
    Suspect {
        /// The reason.
        why: &'static str,
        /// The telescope of the permit.
        telescope: Chunk,
        /// The commander that it names.
        commander: String,
    },
    /// Nobody does any more.
    Trust,
    /// A permit of this telescope was dropped.
    Drop(Chunk, Dropped),
    /// It is newly proven that the shutter is closed, or no longer: published at once, with the next number.
    IsClosed(bool),
    /// Report this to the guard process.
    Report(DomeReport),
    /// Publish the state of the guard with this number.
    Publish(u64),
}

/// What the loop of one guard remembers.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct GuardLoop {
    /// The mounts under the dome, where the shutter waits for their park.
    mounts: Option<MountsUnder>,
    watchdog: Watchdog,
    seen: Option<ShutterReading>,
    is_looking: bool,
    is_sending: bool,
    /// A request that is due, while another one is under way.
    waiting: Option<Request>,
    impostor: Option<MachineTime>,
    was_closed: bool,
}

impl GuardLoop {
    /// Nothing was read or received yet. `mounts`: where the shutter waits for their park.
    pub fn new(mounts: Option<MountsUnder>, watchdog: Watchdog) -> Self {
        Self {
            mounts,
            watchdog,
            seen: None,
            is_looking: false,
            is_sending: false,
            waiting: None,
            impostor: None,
            was_closed: false,
        }
    }

    /// The dome's own loop has read the shutter.
    pub fn read(&mut self, reading: ShutterReading) {
        if self.seen.is_none_or(|(_, asked)| reading.1 > asked) {
            self.seen = Some(reading);
        }
    }

    /// Something has happened, and the guard looks at the dome.
    pub fn step(&mut self, guard: &mut Guard, event: GuardEvent, now: MachineTime) -> Vec<GuardEffect> {
        let mut effects = Vec::new();
        let is_beat = matches!(event, GuardEvent::Beat);
        self.take(guard, event, now, &mut effects);
        let fresh = self.seen.filter(|(_, asked)| now.since(*asked) <= FRESH);
        let parked = self.mounts.as_ref().is_none_or(|mounts| mounts.all_parked(now));
        for action in guard.look(now, fresh, parked) {
            match action {
                GuardStep::Raise(alarm) => effects.push(GuardEffect::Raise(alarm)),
                GuardStep::Clear(alarm) => effects.push(GuardEffect::Clear(alarm)),
                GuardStep::Close => self.waiting = Some(Request::Close),
                GuardStep::AbortThenClose => self.waiting = Some(Request::AbortThenClose),
            }
        }
        if !self.is_sending
            && let Some(request) = self.waiting.take()
        {
            self.is_sending = true;
            effects.push(GuardEffect::Send(request));
        }
        guard.set_sends(self.is_sending);
        if is_beat && !self.is_looking && self.seen.is_none_or(|(_, asked)| now.since(asked) > SILENT) {
            self.is_looking = true;
            effects.push(GuardEffect::Look { asked: now });
        }
        // Only a beat of this loop with a valid permit feeds it: a thread of its own would feed it also when this loop
        // hangs.
        let is_alive = is_beat && guard.may_be_open(now) && !guard.is_closing();
        if self.watchdog.is_due(is_alive, now) {
            effects.push(GuardEffect::Feed);
        }
        if self.impostor.is_some_and(|at| now.since(at) > GONE) {
            self.impostor = None;
            effects.push(GuardEffect::Trust);
        }
        let is_closed = guard.is_closed(now);
        if std::mem::replace(&mut self.was_closed, is_closed) != is_closed {
            effects.push(GuardEffect::IsClosed(is_closed));
        }
        if is_beat {
            effects.push(GuardEffect::Report(DomeReport {
                at_ns: nanos(now),
                may_be_open_ms: u64::try_from(guard.may_be_open_for(now).as_millis()).unwrap_or(0),
                sees: fresh.is_some(),
                is_closed,
                waits_for_mounts: guard.needs_help_with_mounts(now, parked),
            }));
            effects.push(GuardEffect::Publish(guard.beat(now)));
        }
        effects
    }

    fn take(&mut self, guard: &mut Guard, event: GuardEvent, now: MachineTime, effects: &mut Vec<GuardEffect>) {
        match event {
            GuardEvent::Tick | GuardEvent::Beat => {}
            GuardEvent::Permit { telescope, sample } => {
                let taken = guard.observe(&telescope, &sample);
                if let Some(why) = suspicion(taken) {
                    self.impostor = Some(now);
                    let (telescope, commander) = (telescope.clone(), sample.body.commander);
                    effects.push(GuardEffect::Suspect { why, telescope, commander });
                }
                effects.extend(taken.err().map(|why| GuardEffect::Drop(telescope, why)));
            }
            GuardEvent::Mount { device, boot_id, reading, read } => {
                if let Some(mounts) = &mut self.mounts {
                    mounts.observe(device, boot_id, reading, read);
                }
            }
            GuardEvent::Looked(read) => {
                self.is_looking = false;
                self.seen = [self.seen, read].into_iter().flatten().max_by_key(|(_, asked)| *asked);
            }
            GuardEvent::Answered(answer) => {
                self.is_sending = false;
                answer.apply(guard, now);
            }
            GuardEvent::Lost => (self.is_looking, self.is_sending) = (false, false),
        }
    }
}

/// What makes a permit that of an impostor, if anything does.
fn suspicion(taken: Result<Taken, Dropped>) -> Option<&'static str> {
    match taken {
        Ok(Taken::Contested) => Some("permits of one lease and one name contradict each other's numbers"),
        Err(Dropped::NeverGranted) => Some("a permit carries a token that was never granted"),
        Err(Dropped::OtherIncarnation) => Some("a permit carries a lease that was granted to another process"),
        Ok(Taken::Next)
        | Err(
            Dropped::Stranger | Dropped::OtherBoot | Dropped::UnknownNumber | Dropped::Replayed | Dropped::OldToken,
        ) => None,
    }
}

#[cfg(test)]
#[path = "guard_loop_tests.rs"]
mod tests;
