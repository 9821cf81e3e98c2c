//! The mount hears its enclosure's permit too: without one it stops, and parks, whoever is dead.

use std::time::Duration;

use bus::MachineTime;
use contract::device::telescope::{Command, Fields};

/// Tracking stops so long after the permit was lost, where the dome does not wait for the mount.
const STOP_AFTER: Duration = Duration::from_secs(60);
/// And the mount parks so long after.
const PARK_AFTER: Duration = Duration::from_secs(300);
/// A command that did not help is given again so much later.
const RETRY: Duration = Duration::from_secs(30);
/// And so often: a mount that cannot park is the alert's business, not an endless loop's.
const MOST_TRIES: u32 = 5;

/// Watches one mount; pure.
#[derive(Debug)]
pub struct MountWatch {
    /// The dome waits for the park, so there is no time to lose.
    dome_waits: bool,
    lost_since: MachineTime,
    last_deed: Option<MachineTime>,
    tries: u32,
}

impl MountWatch {
    /// A watch that begins without a permit.
    pub fn new(dome_waits: bool, now: MachineTime) -> Self {
        Self { dome_waits, lost_since: now, last_deed: None, tries: 0 }
    }

    /// What the mount must do now, if anything.
    pub fn look(&mut self, now: MachineTime, permitted: bool, fields: &Fields, can_park: bool) -> Option<Command> {
        if permitted {
            (self.lost_since, self.last_deed, self.tries) = (now, None, 0);
            return None;
        }
        let lost = now.since(self.lost_since);
        let parked = fields.at_park.known() == Some(&true);
        let stands = fields.tracking.known() == Some(&false) && fields.slewing.known() == Some(&false);
        // a park is tried once the permit is long gone; a hand that unparks a mount later is left alone
        let park_due = can_park && !parked && (self.dome_waits || lost >= PARK_AFTER) && self.tries < MOST_TRIES;
        let stop_due = !parked && !stands && lost >= STOP_AFTER && lost < PARK_AFTER + STOP_AFTER;
        let rested = self.last_deed.is_none_or(|last| now.since(last) >= RETRY);
        if !rested || !(park_due || stop_due) {
            return None;
        }
        self.last_deed = Some(now);
        if park_due {
            self.tries += 1;
            Some(Command::Park)
        } else {
            Some(Command::Track { on: false })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use contract::Datum;

    fn at(second: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(second))
    }

    fn mount(tracking: bool, at_park: bool) -> Fields {
        Fields {
            tracking: Datum::Known(tracking),
            slewing: Datum::Known(false),
            at_park: Datum::Known(at_park),
            ..Fields::default()
        }
    }

    #[test]
    fn a_mount_under_a_dome_that_does_not_wait_stops_after_a_minute_and_parks_after_five() {
        let mut watch = MountWatch::new(false, at(0));
        assert_eq!(watch.look(at(59), false, &mount(true, false), true), None);
        assert_eq!(watch.look(at(60), false, &mount(true, false), true), Some(Command::Track { on: false }));
        assert_eq!(watch.look(at(61), false, &mount(true, false), true), None);
        assert_eq!(watch.look(at(100), false, &mount(false, false), true), None);
        assert_eq!(watch.look(at(300), false, &mount(false, false), true), Some(Command::Park));
        assert_eq!(watch.look(at(400), false, &mount(false, true), true), None);
    }

    #[test]
    fn a_mount_that_a_roof_waits_for_parks_at_once() {
        let mut watch = MountWatch::new(true, at(0));
        assert_eq!(watch.look(at(10), true, &mount(true, false), true), None);
        assert_eq!(watch.look(at(11), false, &mount(true, false), true), Some(Command::Park));
        assert_eq!(watch.look(at(20), false, &mount(true, false), true), None);
        assert_eq!(watch.look(at(41), false, &mount(true, false), true), Some(Command::Park));
    }

    #[test]
    fn a_renewed_permit_starts_the_time_anew() {
        let mut watch = MountWatch::new(false, at(0));
        assert_eq!(watch.look(at(59), true, &mount(true, false), true), None);
        assert_eq!(watch.look(at(118), false, &mount(true, false), true), None);
        assert_eq!(watch.look(at(119), false, &mount(true, false), true), Some(Command::Track { on: false }));
    }
}
