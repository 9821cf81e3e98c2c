//! Scenarios of a guard's loop, and every order of the first events.

use contract::Address;
use contract::device::dome::CloseWithMount;
use contract::observatory::Verdict;

use super::*;
use crate::explore::explore;
use crate::guard::tests::{at, boot, guard, guard_with, permit, safe, telescope};
use crate::request::{Answer, Request};

fn loop_without_mounts() -> GuardLoop {
    GuardLoop::new(None, Watchdog::new(None))
}

/// Without what is reported and published each second.
fn acts(effects: Vec<GuardEffect>) -> Vec<GuardEffect> {
    let is_report = |effect: &GuardEffect| matches!(effect, GuardEffect::Report(_) | GuardEffect::Publish(_));
    effects.into_iter().filter(|effect| !is_report(effect)).collect()
}

fn of_alpha(sample: Stamped<Permit>) -> GuardEvent {
    GuardEvent::Permit { telescope: telescope("alpha"), sample }
}

#[test]
fn a_silent_dome_is_looked_at_with_each_number_and_asked_once_at_a_time() {
    let (mut guard, mut state) = (guard(), loop_without_mounts());
    state.read((Shutter::Closed, at(0.0)));
    assert_eq!(acts(state.step(&mut guard, GuardEvent::Beat, at(2.0))), []);
    assert_eq!(acts(state.step(&mut guard, GuardEvent::Tick, at(2.9))), []);
    let look = |second| GuardEffect::Look { asked: at(second) };
    assert_eq!(acts(state.step(&mut guard, GuardEvent::Beat, at(3.0))), [look(3.0)]);
    assert_eq!(acts(state.step(&mut guard, GuardEvent::Beat, at(4.0))), [], "it is under way");
    assert_eq!(acts(state.step(&mut guard, GuardEvent::Looked(None), at(4.5))), []);
    assert_eq!(acts(state.step(&mut guard, GuardEvent::Beat, at(5.0))), [look(5.0)]);
    // The loop reads again, and the older reading of the guard's own changes nothing.
    state.read((Shutter::Open, at(5.5)));
    state.step(&mut guard, GuardEvent::Looked(Some((Shutter::Closed, at(5.0)))), at(6.0));
    assert_eq!(state.seen, Some((Shutter::Open, at(5.5))));
}

#[test]
fn one_request_is_under_way_at_a_time_and_the_next_one_follows_it() {
    let (mut guard, mut state) = (guard(), loop_without_mounts());
    let mut step = |event, second| {
        state.read((Shutter::Open, at(second)));
        let effects = acts(state.step(&mut guard, event, at(second)));
        effects.into_iter().filter(|effect| matches!(effect, GuardEffect::Send(_))).collect::<Vec<_>>()
    };
    assert_eq!(step(GuardEvent::Tick, 9.9), []);
    assert_eq!(step(GuardEvent::Tick, 10.0), [GuardEffect::Send(Request::Close)], "nobody has permitted it");
    assert_eq!(step(GuardEvent::Tick, 20.0), [], "the first is still under way");
    assert_eq!(step(GuardEvent::Answered(Answer::Unknown), 25.0), [GuardEffect::Send(Request::Close)]);
    assert_eq!(step(GuardEvent::Lost, 30.0), [GuardEffect::Send(Request::AbortThenClose)]);
}

#[test]
fn a_dome_is_opened_only_after_the_guards_own_request_to_close_was_answered() {
    let (mut guard, mut state) = (guard(), loop_without_mounts());
    // A device node that starts while the sky is safe: closed by its status, not proven yet, and asked to close.
    state.read((Shutter::Closed, at(10.0)));
    assert!(acts(state.step(&mut guard, GuardEvent::Beat, at(10.0))).contains(&GuardEffect::Send(Request::Close)));
    state.step(&mut guard, of_alpha(safe(0, 0)), at(10.1));
    let (reason, detail) = guard.open_commanded(at(10.1)).unwrap_err();
    assert_eq!(reason, contract::Reason::Busy, "{detail}");
    state.step(&mut guard, GuardEvent::Answered(Answer::Accepted), at(10.2));
    assert_eq!(guard.open_commanded(at(10.2)), Ok(()));
}

#[test]
fn a_conclusion_is_logged_once_and_reported_with_the_next_number() {
    let (mut guard, mut state) = (guard(), loop_without_mounts());
    state.read((Shutter::Open, at(10.0)));
    state.step(&mut guard, GuardEvent::Tick, at(10.0));
    state.step(&mut guard, GuardEvent::Answered(Answer::Accepted), at(11.0));
    state.read((Shutter::Closed, at(12.0)));
    let effects = state.step(&mut guard, GuardEvent::Tick, at(12.1));
    assert!(effects.contains(&GuardEffect::IsClosed(true)), "{effects:?}");
    let effects = state.step(&mut guard, GuardEvent::Beat, at(12.2));
    let [GuardEffect::Report(report), GuardEffect::Publish(0)] = effects.as_slice() else {
        panic!("expected a report and the first number: {effects:?}");
    };
    assert!(report.is_closed && report.sees && report.may_be_open_ms == 0 && !report.waits_for_mounts);
    let effects = acts(state.step(&mut guard, GuardEvent::Tick, at(18.0)));
    let asked_again = [GuardEffect::Send(Request::Close), GuardEffect::IsClosed(false)];
    assert_eq!(effects, asked_again, "an old reading proves nothing");
}

#[test]
fn the_watchdog_is_fed_by_a_number_under_a_living_permit_alone() {
    let (mut guard, mut state) = (guard(), GuardLoop::new(None, Watchdog::new(Some(4.0))));
    let mut fed = |event, second| {
        state.read((Shutter::Open, at(second)));
        state.step(&mut guard, event, at(second)).contains(&GuardEffect::Feed)
    };
    assert!(!fed(GuardEvent::Beat, 0.0), "nobody permits");
    assert!(!fed(of_alpha(safe(0, 0)), 0.5), "no number");
    assert!(fed(GuardEvent::Beat, 1.0) && fed(GuardEvent::Beat, 2.0));
    assert!(!fed(GuardEvent::Beat, 2.5), "fed lately");
    assert!(!fed(of_alpha(permit(1, 2, Verdict::Unsafe)), 3.0) && !fed(GuardEvent::Beat, 4.0));
}

#[test]
fn an_impostor_is_reported_until_it_was_silent_for_ten_seconds() {
    let (mut guard, mut state) = (guard(), loop_without_mounts());
    state.step(&mut guard, GuardEvent::Beat, at(0.0));
    let mut invented = safe(0, 0);
    invented.body.token = 5;
    let effects = state.step(&mut guard, of_alpha(invented), at(1.0));
    let telescope = telescope("alpha");
    let (why, commander) = ("a permit carries a token that was never granted", "observatory/alpha/main".to_owned());
    let suspect = GuardEffect::Suspect { why, telescope: telescope.clone(), commander };
    assert_eq!(effects, [suspect, GuardEffect::Drop(telescope, Dropped::NeverGranted)]);
    assert!(!state.step(&mut guard, GuardEvent::Tick, at(11.0)).contains(&GuardEffect::Trust));
    assert!(state.step(&mut guard, GuardEvent::Tick, at(11.1)).contains(&GuardEffect::Trust));
}

#[test]
fn a_shutter_that_waits_is_closed_when_its_mount_is_known_to_be_parked() {
    let mut guard = guard_with(CloseWithMount::ParkedOnly, &["alpha"]);
    let mount = Address::new("site", "alpha").unwrap().device(contract::Kind::Telescope, &"m".parse().unwrap());
    let under = MountsUnder::new(vec![telescope("alpha")], Some(vec![mount.clone()]));
    let mut state = GuardLoop::new(Some(under), Watchdog::new(None));
    let parked = |says_parked, second| GuardEvent::Mount {
        device: mount.clone(),
        boot_id: boot("mount"),
        reading: ParkReading { says_parked: Some(says_parked), place: None, has_none: true },
        read: at(second),
    };
    state.read((Shutter::Open, at(11.0)));
    assert_eq!(acts(state.step(&mut guard, GuardEvent::Tick, at(11.0))), []);
    assert_eq!(acts(state.step(&mut guard, parked(false, 11.5), at(11.5))), []);
    let effects = state.step(&mut guard, GuardEvent::Beat, at(22.0));
    assert!(matches!(&effects[..], [.., GuardEffect::Report(report), _] if report.waits_for_mounts), "{effects:?}");
    state.read((Shutter::Open, at(22.5)));
    assert_eq!(acts(state.step(&mut guard, parked(true, 22.5), at(22.5))), [GuardEffect::Send(Request::Close)]);
}

/// A dome with its guard, its permits and its commander.
#[derive(Clone, PartialEq, Eq, Hash)]
struct World {
    guard: Guard,
    state: GuardLoop,
    now_s: u64,
    shutter: Shutter,
    request: Option<Request>,
    /// When each number was published.
    sent_s: Vec<u64>,
    permits: u64,
    /// The number of the newest permit that counts, and until when the dome may be open.
    newest: u64,
    open_until_s: u64,
}

impl World {
    fn new(shutter: Shutter) -> Self {
        Self {
            guard: guard(),
            state: loop_without_mounts(),
            now_s: 0,
            shutter,
            request: None,
            sent_s: Vec::new(),
            permits: 0,
            newest: 0,
            open_until_s: 10,
        }
        .step(GuardEvent::Beat, &[])
    }

    fn now(&self) -> MachineTime {
        at(self.now_s as f64)
    }

    fn step(mut self, event: GuardEvent, way: &[&str]) -> Self {
        let was_closing = self.guard.is_closing();
        let was_sending = self.request.is_some();
        for effect in self.state.step(&mut self.guard, event, at(self.now_s as f64)) {
            match effect {
                GuardEffect::Send(request) => {
                    assert_eq!(self.request.replace(request), None, "{way:?}: a request is under way already");
                }
                GuardEffect::Publish(number) => {
                    assert_eq!(number, self.sent_s.len() as u64, "{way:?}");
                    self.sent_s.push(self.now_s);
                }
                _ => {}
            }
        }
        let (closing, closed) = (self.guard.is_closing(), self.guard.is_closed(self.now()));
        let may_be_open = self.now_s < self.open_until_s;
        assert!(may_be_open || closing || closed, "{way:?}: open without a permit, and not closing");
        assert!(was_closing || !closing || was_sending || self.request.is_some(), "{way:?}: closes without a request");
        assert!(!closed || self.shutter == Shutter::Closed, "{way:?}: believes that an open dome is closed");
        self
    }

    fn permit(&self, number: u64, verdict: Verdict, way: &[&str]) -> Self {
        let mut after = self.clone();
        let sample = permit(after.permits, number, verdict);
        after.permits += 1;
        if number >= after.newest {
            let valid_s = if verdict == Verdict::Safe { 10 } else { 0 };
            (after.newest, after.open_until_s) = (number, after.sent_s[number as usize] + valid_s);
        }
        after.step(of_alpha(sample), way)
    }

    fn passes(&self, seconds: u64, way: &[&str]) -> Self {
        Self { now_s: self.now_s + seconds, ..self.clone() }.step(GuardEvent::Beat, way)
    }

    fn reads(&self, way: &[&str]) -> Self {
        let mut after = self.clone();
        after.state.read((after.shutter, after.now()));
        after.step(GuardEvent::Tick, way)
    }

    fn opens(&self) -> Self {
        let mut after = self.clone();
        if after.guard.open_commanded(self.now()).is_ok() {
            assert_eq!(self.request, None, "opened while a request to close is on its way: it may arrive after that");
            after.guard.open_sent(self.now());
            after.shutter = Shutter::Open;
        }
        after
    }

    /// The request arrives, or not, and this is its result.
    fn answers(&self, arrives: bool, event: GuardEvent, way: &[&str]) -> Option<Self> {
        self.request?;
        let shutter = if arrives { Shutter::Closed } else { self.shutter };
        Some(Self { shutter, request: None, ..self.clone() }.step(event, way))
    }
}

#[test]
fn in_every_order_of_events_a_dome_without_a_valid_permit_is_closing_or_proven_closed() {
    for shutter in [Shutter::Closed, Shutter::Open] {
        let states = explore(World::new(shutter), 7, |world, way| {
            let newest = world.sent_s.len() as u64 - 1;
            let steps = [
                ("4 s", Some(world.passes(4, way))),
                ("a reading", Some(world.reads(way))),
                ("a safe permit", Some(world.permit(newest, Verdict::Safe, way))),
                ("an unsafe permit", Some(world.permit(newest, Verdict::Unsafe, way))),
                ("the first permit again", Some(world.permit(0, Verdict::Safe, way))),
                ("it is opened", Some(world.opens())),
                ("closing is answered", world.answers(true, GuardEvent::Answered(Answer::Accepted), way)),
                ("it closes and does not answer", world.answers(true, GuardEvent::Answered(Answer::Unknown), way)),
                ("closing is refused", world.answers(false, GuardEvent::Answered(Answer::Refused), way)),
                ("the request is lost", world.answers(false, GuardEvent::Lost, way)),
            ];
            steps.into_iter().filter_map(|(step, after)| Some((step, after?))).collect()
        });
        assert!(states > 1000, "{states} states");
    }
}
