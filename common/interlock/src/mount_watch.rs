//! The mount's node receives its enclosure's permit and guard too: when the roof must close it stops, and parks,
//! whichever node is dead.

use std::time::Duration;

use contract::device::telescope::{Command, Fields};
use units::MachineTime;

use crate::guard_words::Roofs;

/// Tracking stops so long after the permit was lost, where the dome does not wait for the mount.
const STOP_AFTER: Duration = Duration::from_secs(60);
/// And the mount parks so long after.
const PARK_AFTER: Duration = Duration::from_secs(300);
/// A command that did not help is given again so much later.
const RETRY: Duration = Duration::from_secs(30);
/// After so many tries, where no roof waits for it, a mount that cannot park is asked more rarely.
const TRIES: u32 = 5;
const RARELY: Duration = Duration::from_secs(300);

/// What a mount is known to be allowed, now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Calls {
    /// Its own telescope's permit is valid and safe.
    pub permitted: bool,
    /// What the roofs over it ask.
    pub roofs: Roofs,
}

impl Calls {
    /// A roof must close and waits for the park.
    pub fn must_park(self) -> bool {
        let Roofs { waits, closing, closed } = self.roofs;
        waits && (closing || !self.permitted) && !closed
    }
}

/// Watches one mount; pure.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct MountWatch {
    lost_since: MachineTime,
    last_step: Option<MachineTime>,
    tries: u32,
    /// It has stopped or parked since the permit was lost: a person who moves it later does so on purpose.
    rested: bool,
    /// It was asked to park since the permit was lost.
    asked_to_park: bool,
    answered: bool,
    called: bool,
}

impl MountWatch {
    /// A watch that begins without a permit.
    pub fn new(now: MachineTime) -> Self {
        Self {
            lost_since: now,
            last_step: None,
            tries: 0,
            rested: false,
            asked_to_park: false,
            answered: true,
            called: false,
        }
    }

    /// What the mount must do now, if anything; `answers`: whether its server does.
    pub fn look(
        &mut self,
        now: MachineTime,
        calls: Calls,
        fields: &Fields,
        can_park: bool,
        answers: bool,
    ) -> Option<Command> {
        let must_park = calls.must_park();
        // One that comes back, and one that is needed now, is asked at once.
        if (answers && !self.answered) || (must_park && !self.called) {
            self.last_step = None;
        }
        (self.answered, self.called) = (answers, must_park);
        if calls.permitted && !must_park {
            (self.lost_since, self.last_step, self.tries) = (now, None, 0);
            (self.rested, self.asked_to_park) = (false, false);
            return None;
        }
        let parked = fields.parked() == Some(true);
        let stands = fields.tracking.known() == Some(&false) && fields.slewing.known() == Some(&false);
        // A driver that does not tell whether the mount is parked: all that is ever seen is that it stands, a while after
        // it was asked.
        let was_asked = self.asked_to_park && self.last_step.is_some_and(|last| now.since(last) >= RETRY);
        let parked_unseen = was_asked && fields.at_park.is_refused();
        self.rested |= parked || (stands && (!can_park || parked_unseen));
        let command =
            if must_park { needed(parked, stands, can_park) } else { self.late(now, parked, stands, can_park) };
        let pause = if !must_park && self.tries >= TRIES { RARELY } else { RETRY };
        let is_due = self.last_step.is_none_or(|last| now.since(last) >= pause);
        let command = command.filter(|_| is_due)?;
        self.last_step = Some(now);
        self.asked_to_park |= answers && command == Command::Park;
        // A command to a mount that is away does not count as a try.
        self.tries = (self.tries + u32::from(answers)).min(TRIES);
        Some(command)
    }

    /// Nothing waits for it, so it may observe to the end of a short silence. A hand that moves it later is left alone.
    fn late(&self, now: MachineTime, parked: bool, stands: bool, can_park: bool) -> Option<Command> {
        let lost = now.since(self.lost_since);
        if self.rested || parked {
            return None;
        }
        if can_park && lost >= PARK_AFTER {
            return Some(Command::Park);
        }
        (!stands && lost >= STOP_AFTER).then_some(Command::Track { on: false })
    }
}

/// A roof waits: asked for ever, until it is parked.
fn needed(parked: bool, stands: bool, can_park: bool) -> Option<Command> {
    match (parked, can_park) {
        (true, _) => None,
        (false, true) => Some(Command::Park),
        (false, false) => (!stands).then_some(Command::Track { on: false }),
    }
}

#[cfg(test)]
mod tests {
    use contract::Datum;

    use super::*;

    const ALONGSIDE: Roofs = Roofs { waits: false, closing: false, closed: true };
    const WAITING: Roofs = Roofs { waits: true, closing: false, closed: false };

    fn at(second: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(second))
    }

    fn calls(permitted: bool, roofs: Roofs) -> Calls {
        Calls { permitted, roofs }
    }

    fn mount(tracking: bool, at_park: bool) -> Fields {
        Fields {
            tracking: Datum::Known(tracking),
            slewing: Datum::Known(false),
            at_park: Datum::Known(at_park),
            ..Fields::default()
        }
    }

    /// The seconds of a time at which it is asked to park, or to stop.
    fn asked(
        watch: &mut MountWatch,
        seconds: std::ops::Range<u64>,
        calls: Calls,
        fields: &Fields,
        answers: bool,
    ) -> Vec<(u64, Command)> {
        let look = |second| watch.look(at(second), calls, fields, true, answers).map(|command| (second, command));
        seconds.filter_map(look).collect()
    }

    #[test]
    fn a_mount_under_a_dome_that_does_not_wait_stops_after_a_minute_and_parks_after_five() {
        let (mut watch, lost) = (MountWatch::new(at(0)), calls(false, ALONGSIDE));
        let stop = Command::Track { on: false };
        assert_eq!(asked(&mut watch, 0..80, lost, &mount(true, false), true), [(60, stop)]);
        assert_eq!(asked(&mut watch, 80..301, lost, &mount(false, false), true), [(300, Command::Park)]);
        assert_eq!(asked(&mut watch, 301..400, lost, &mount(false, true), true), []);
        assert_eq!(
            asked(&mut watch, 400..900, lost, &mount(true, false), true),
            [],
            "a hand that unparks it is left alone"
        );
    }

    #[test]
    fn a_mount_that_a_roof_waits_for_parks_at_once_and_is_asked_for_ever() {
        let mut watch = MountWatch::new(at(0));
        assert_eq!(asked(&mut watch, 0..10, calls(true, WAITING), &mount(true, false), true), []);
        let all = asked(&mut watch, 10..7210, calls(false, WAITING), &mount(true, false), true);
        assert_eq!(all.len(), 240, "each 30 s, two hours long");
        assert_eq!(all[0], (10, Command::Park));
        assert_eq!(asked(&mut watch, 7210..7300, calls(false, WAITING), &mount(false, true), true), []);
        let closed = Roofs { closed: true, ..WAITING };
        assert_eq!(
            asked(&mut watch, 7300..9000, calls(false, closed), &mount(false, false), true),
            [],
            "people may work on it"
        );
    }

    #[test]
    fn a_mount_that_was_away_is_asked_as_soon_as_it_answers() {
        for roofs in [WAITING, ALONGSIDE] {
            let mut watch = MountWatch::new(at(0));
            asked(&mut watch, 0..1207, calls(false, roofs), &Fields::default(), false);
            let all = asked(&mut watch, 1207..1300, calls(false, roofs), &mount(true, false), true);
            assert_eq!(all.first(), Some(&(1207, Command::Park)), "{roofs:?}");
        }
    }

    #[test]
    fn a_shared_roof_that_closes_for_another_telescope_parks_the_mount_whose_own_sky_is_safe() {
        let mut watch = MountWatch::new(at(0));
        let closing = Roofs { closing: true, ..WAITING };
        assert_eq!(asked(&mut watch, 0..5, calls(true, WAITING), &mount(true, false), true), []);
        assert_eq!(asked(&mut watch, 5..20, calls(true, closing), &mount(true, false), true), [(5, Command::Park)]);
        assert!(
            calls(true, closing).must_park() && !calls(true, WAITING).must_park() && calls(false, WAITING).must_park()
        );
    }

    #[test]
    fn a_mount_that_cannot_park_is_stopped_for_ever_where_a_roof_waits() {
        let (mut watch, lost) = (MountWatch::new(at(0)), calls(false, WAITING));
        let tracking = mount(true, false);
        let all: Vec<u64> = (0..601).filter(|s| watch.look(at(*s), lost, &tracking, false, true).is_some()).collect();
        assert_eq!(all, (0..601).step_by(30).collect::<Vec<_>>());
        assert_eq!(watch.look(at(700), lost, &mount(false, false), false, true), None, "it stands");
    }

    #[test]
    fn a_mount_that_does_not_tell_whether_it_is_parked_is_asked_once_and_again_where_a_roof_waits() {
        let unseen = Fields { at_park: Datum::missing(contract::NoData::not_implemented()), ..mount(false, false) };
        let mut watch = MountWatch::new(at(0));
        assert_eq!(asked(&mut watch, 0..2000, calls(false, ALONGSIDE), &unseen, true), [(300, Command::Park)]);
        assert_eq!(asked(&mut watch, 2000..2060, calls(false, WAITING), &unseen, true).len(), 2);
    }

    #[test]
    fn a_mount_that_does_not_park_is_asked_more_rarely_where_nothing_waits_for_it() {
        let mut watch = MountWatch::new(at(0));
        let all = asked(&mut watch, 100..2000, calls(false, ALONGSIDE), &mount(false, false), true);
        let times: Vec<u64> = all.iter().map(|(second, _)| *second).collect();
        assert_eq!(times, [300, 330, 360, 390, 420, 720, 1020, 1320, 1620, 1920]);
    }

    #[test]
    fn a_renewed_permit_starts_the_time_anew() {
        let mut watch = MountWatch::new(at(0));
        assert_eq!(asked(&mut watch, 59..60, calls(true, ALONGSIDE), &mount(true, false), true), []);
        let all = asked(&mut watch, 60..120, calls(false, ALONGSIDE), &mount(true, false), true);
        assert_eq!(all, [(119, Command::Track { on: false })]);
    }

    /// A mount, what is known of its permit and roofs, and what it was asked.
    #[derive(Debug, Clone, PartialEq, Eq, Hash)]
    struct World {
        watch: MountWatch,
        now_s: u64,
        permitted: bool,
        closing: bool,
        answers: bool,
        parked: bool,
        needed_since_s: Option<u64>,
        asked_s: Option<u64>,
    }

    impl World {
        fn looks(&self, after_s: u64, way: &[&str]) -> Self {
            let mut after = Self { now_s: self.now_s + after_s, ..self.clone() };
            let calls = calls(after.permitted, Roofs { waits: true, closing: after.closing, closed: false });
            if !calls.must_park() {
                (after.needed_since_s, after.asked_s) = (None, None);
            } else {
                after.needed_since_s.get_or_insert(after.now_s);
            }
            let fields = mount(!after.parked, after.parked);
            let command = after.watch.look(at(1000 + after.now_s), calls, &fields, true, after.answers);
            assert!(command.is_none() || !after.parked, "{way:?}: a parked mount is asked to move");
            assert!(
                command != Some(Command::Park) || calls.must_park() || !after.permitted,
                "{way:?}: parked for nothing"
            );
            if command.is_some() {
                after.asked_s = Some(after.now_s);
            }
            if calls.must_park() && !after.parked {
                let asked_s = after.asked_s.expect("asked at once");
                assert!(after.now_s - asked_s <= RETRY.as_secs(), "{way:?}: a roof waits, and nobody asks the mount");
            }
            after
        }
    }

    #[test]
    fn in_every_order_of_permits_roofs_and_silences_a_mount_that_a_roof_waits_for_is_asked_each_30_s() {
        let start = World {
            watch: MountWatch::new(at(1000)),
            now_s: 0,
            permitted: true,
            closing: false,
            answers: true,
            parked: false,
            needed_since_s: None,
            asked_s: None,
        };
        let states = crate::explore::explore(start, 7, |world, way| {
            vec![
                ("1 s", world.looks(1, way)),
                ("30 s", world.looks(30, way)),
                ("the permit changes", World { permitted: !world.permitted, ..world.clone() }.looks(1, way)),
                ("a roof begins or ends to close", World { closing: !world.closing, ..world.clone() }.looks(1, way)),
                ("its server goes or comes", World { answers: !world.answers, ..world.clone() }.looks(1, way)),
                ("it is parked or unparked", World { parked: !world.parked, ..world.clone() }.looks(1, way)),
            ]
        });
        assert!(states > 1000, "{states} states");
    }
}
