use contract::observatory::Verdict;
use proptest::prelude::*;
use units::Utc;

use super::*;

const VALID: u64 = 10;

pub(crate) fn boot(name: &str) -> BootId {
    serde_json::from_value(serde_json::json!(name)).unwrap()
}

pub(crate) fn at(seconds: f64) -> MachineTime {
    MachineTime::from_boot(Duration::from_secs_f64(1000.0 + seconds))
}

pub(crate) fn telescope(name: &str) -> Chunk {
    name.parse().unwrap()
}

pub(crate) fn guard_with(policy: CloseWithMount, telescopes: &[&str]) -> Guard {
    let settings = Settings {
        boot_id: boot("guard"),
        telescopes: telescopes.iter().map(|name| telescope(name)).collect(),
        permit_valid: Duration::from_secs(VALID),
        policy,
        parked_within: Duration::from_secs(120),
        travel: Duration::from_secs(90),
    };
    let granted = telescopes.iter().map(|name| (telescope(name), 1)).collect();
    Guard::new(settings, granted, at(0.0))
}

/// A dome whose status is read as the guard looks, and which takes each request.
pub(crate) trait Sees {
    fn sees(&mut self, now: MachineTime, shutter: Option<Shutter>, parked: bool) -> Vec<GuardStep>;
}

impl Sees for Guard {
    fn sees(&mut self, now: MachineTime, shutter: Option<Shutter>, parked: bool) -> Vec<GuardStep> {
        let steps = self.look(now, shutter.map(|shutter| (shutter, now)), parked);
        if closes(&steps) {
            self.close_answered(true, now);
        }
        steps
    }
}

pub(crate) fn guard() -> Guard {
    guard_with(CloseWithMount::Alongside, &["alpha"])
}

pub(crate) fn permit(seq: u64, number: u64, verdict: Verdict) -> Stamped<Permit> {
    Stamped {
        boot_id: boot("observatory-1"),
        seq,
        at_utc: Utc::EPOCH,
        sent_s: None,
        held_s: None,
        body: Permit {
            verdict,
            commander: "observatory/alpha/main".to_owned(),
            token: 1,
            guard_number: number,
            guard_boot_id: boot("guard"),
        },
    }
}

pub(crate) fn safe(seq: u64, number: u64) -> Stamped<Permit> {
    permit(seq, number, Verdict::Safe)
}

/// A guard whose dome was opened under a valid safe permit at second 1.
fn open_guard() -> Guard {
    let mut guard = guard();
    guard.sees(at(0.0), Some(Shutter::Closed), true);
    let number = guard.beat(at(0.0));
    guard.observe(&telescope("alpha"), &safe(0, number)).unwrap();
    guard.open_commanded(at(1.0)).unwrap();
    assert_eq!(guard.sees(at(2.0), Some(Shutter::Open), true), []);
    guard
}

pub(crate) fn closes(steps: &[GuardStep]) -> bool {
    steps.iter().any(|step| matches!(step, GuardStep::Close | GuardStep::AbortThenClose))
}

#[test]
fn a_permit_is_as_old_as_the_number_in_it_and_not_as_its_arrival() {
    let mut guard = guard();
    let number = guard.beat(at(0.0));
    guard.observe(&telescope("alpha"), &safe(0, number)).unwrap();
    assert!(guard.may_be_open(at(9.9)));
    assert!(!guard.may_be_open(at(10.0)));
}

#[test]
fn permits_that_waited_in_a_socket_stay_invalid() {
    let mut guard = open_guard();
    let numbers: Vec<u64> = (1..=9).map(|second| guard.beat(at(f64::from(second)))).collect();
    // The observatory was frozen at second 9; its permits arrive all at once at second 30.
    assert!(closes(&guard.sees(at(12.0), Some(Shutter::Open), true)));
    for (seq, number) in numbers.into_iter().enumerate() {
        let _ = guard.observe(&telescope("alpha"), &safe(1 + seq as u64, number));
    }
    assert!(!guard.may_be_open(at(30.0)));
    assert!(guard.open_commanded(at(30.0)).is_err());
}

#[test]
fn without_a_permit_an_open_dome_closes_when_the_last_one_runs_out() {
    let mut guard = open_guard();
    assert_eq!(guard.sees(at(9.9), Some(Shutter::Open), true), []);
    assert_eq!(guard.sees(at(10.0), Some(Shutter::Open), true), [GuardStep::Close]);
    assert_eq!(guard.published(0, at(10.0), 0).action, GuardAction::Closing);
}

#[test]
fn an_unsafe_permit_closes_at_once() {
    let mut guard = open_guard();
    let number = guard.beat(at(3.0));
    guard.observe(&telescope("alpha"), &permit(1, number, Verdict::Unsafe)).unwrap();
    assert_eq!(guard.sees(at(3.0), Some(Shutter::Open), true), [GuardStep::Close]);
}

#[test]
fn closing_is_tried_for_ever_and_never_believed_without_the_shutter() {
    let mut guard = open_guard();
    let mut tries = Vec::new();
    for tenth in 100..=1500 {
        let second = f64::from(tenth) / 10.0;
        let steps = guard.sees(at(second), Some(Shutter::Open), true);
        tries.extend(steps.into_iter().map(|step| (second, step)));
    }
    let commands: Vec<_> = tries.iter().filter(|(_, step)| closes(std::slice::from_ref(step))).collect();
    assert_eq!(commands.len(), 15);
    assert_eq!(*commands[0], (10.0, GuardStep::Close));
    assert_eq!(*commands[1], (20.0, GuardStep::Close));
    assert_eq!(*commands[2], (30.0, GuardStep::AbortThenClose));
    assert!(tries.contains(&(30.0, GuardStep::Raise(Alarm::NotClosed))));
    // A shutter of which nothing is known is not closed either.
    assert!(closes(&guard.sees(at(160.0), None, true)));
    let steps = guard.sees(at(161.0), Some(Shutter::Closed), true);
    assert!(steps.contains(&GuardStep::Clear(Alarm::NotClosed)) && !guard.is_closing());
}

#[test]
fn a_shutter_on_its_way_is_not_disturbed_until_it_is_stuck() {
    let mut guard = open_guard();
    assert_eq!(guard.sees(at(10.0), Some(Shutter::Open), true), [GuardStep::Close]);
    for second in 11..100 {
        let steps = guard.sees(at(f64::from(second)), Some(Shutter::Closing), true);
        assert!(!closes(&steps), "second {second}: {steps:?}");
    }
    let steps: Vec<GuardStep> =
        (100..125).flat_map(|s| guard.sees(at(f64::from(s)), Some(Shutter::Closing), true)).collect();
    assert!(closes(&steps), "{steps:?}");
    assert!(steps.contains(&GuardStep::Raise(Alarm::NotClosed)));
}

#[test]
fn after_the_guard_closed_by_itself_only_the_commander_opens_again() {
    let mut guard = open_guard();
    guard.sees(at(10.0), Some(Shutter::Open), true);
    let steps = guard.sees(at(40.0), Some(Shutter::Closed), true);
    assert_eq!(steps, [GuardStep::Raise(Alarm::Hold)]);
    assert!(guard.published(0, at(40.0), 0).hold);
    assert!(guard.resume(at(40.0)).is_err(), "resume needs a valid safe permit");
    let number = guard.beat(at(41.0));
    guard.observe(&telescope("alpha"), &safe(1, number)).unwrap();
    assert_eq!(guard.open_commanded(at(41.0)).unwrap_err().0, Reason::NoPermit);
    guard.resume(at(41.0)).unwrap();
    assert_eq!(guard.sees(at(41.0), Some(Shutter::Closed), true), [GuardStep::Clear(Alarm::Hold)]);
    guard.open_commanded(at(41.0)).unwrap();
}

#[test]
fn a_closing_that_the_commander_wanted_too_is_no_hold() {
    let mut guard = open_guard();
    let number = guard.beat(at(3.0));
    guard.observe(&telescope("alpha"), &permit(1, number, Verdict::Unsafe)).unwrap();
    guard.sees(at(3.0), Some(Shutter::Open), true);
    guard.close_commanded(at(4.0));
    guard.sees(at(4.0), Some(Shutter::Closing), true);
    assert_eq!(guard.sees(at(40.0), Some(Shutter::Closed), true), []);
    assert!(!guard.published(0, at(40.0), 0).hold);
}

#[test]
fn a_commanded_closing_of_a_shared_roof_waits_for_all_mounts_under_it() {
    for (policy, waits) in
        [(CloseWithMount::Alongside, false), (CloseWithMount::ParkedWithinS, true), (CloseWithMount::ParkedOnly, true)]
    {
        let mut roof = guard_with(policy, &["alpha", "beta"]);
        roof.sees(at(0.0), Some(Shutter::Closed), true);
        let number = roof.beat(at(0.0));
        for name in ["alpha", "beta"] {
            roof.observe(&telescope(name), &safe(0, number)).unwrap();
        }
        roof.open_commanded(at(1.0)).unwrap();
        assert_eq!(roof.sees(at(2.0), Some(Shutter::Open), false), []);
        assert_eq!(roof.closes_by_itself(), waits);
        roof.close_commanded(at(3.0));
        if !waits {
            roof.close_sent(at(3.0));
            roof.close_answered(true, at(3.0));
        }
        // The commander's own mount may be parked: the other one is not.
        assert_eq!((roof.is_closing(), roof.sees(at(3.0), Some(Shutter::Open), false)), (waits, vec![]));
        // With `CloseWithMount::Alongside` the command itself has moved the shutter.
        let closes = if waits { vec![GuardStep::Close] } else { vec![] };
        assert_eq!(roof.sees(at(8.0), Some(Shutter::Open), true), closes, "{policy:?}");
        roof.sees(at(9.0), Some(Shutter::Closing), true);
        roof.sees(at(20.0), Some(Shutter::Closed), true);
        assert!(!roof.is_closing() && !roof.published(0, at(20.0), 0).hold, "it was wanted: {policy:?}");
        assert_eq!(guard_with(policy, &["alpha"]).closes_by_itself(), waits, "also over one telescope");
    }
    let mut late = guard_with(CloseWithMount::ParkedWithinS, &["alpha", "beta"]);
    late.sees(at(0.0), Some(Shutter::Open), false);
    late.close_commanded(at(1.0));
    assert_eq!(late.sees(at(120.0), Some(Shutter::Open), false), []);
    assert!(closes(&late.sees(at(121.0), Some(Shutter::Open), false)), "and then all the same");
}

#[test]
fn a_replayed_permit_is_dropped_and_counted() {
    let mut guard = open_guard();
    let number = guard.beat(at(3.0));
    guard.observe(&telescope("alpha"), &permit(5, number, Verdict::Unsafe)).unwrap();
    assert_eq!(guard.observe(&telescope("alpha"), &safe(5, number)), Err(Dropped::Replayed));
    assert_eq!(guard.observe(&telescope("alpha"), &safe(4, number)), Err(Dropped::Replayed));
    // Another incarnation of the sender does not help an older number.
    let mut other = safe(0, 0);
    other.boot_id = boot("observatory-2");
    assert_eq!(guard.observe(&telescope("alpha"), &other), Err(Dropped::Replayed));
    assert!(!guard.may_be_open(at(3.0)));
    assert_eq!(guard.published(0, at(3.0), 2).dropped, 5);
}

#[test]
fn a_permit_of_an_older_lease_has_no_effect_on_a_newer_one() {
    let mut guard = guard();
    let number = guard.beat(at(0.0));
    let mut newer = safe(0, number);
    newer.body.token = 7;
    assert_eq!(guard.observe(&telescope("alpha"), &newer), Err(Dropped::NeverGranted));
    guard.grant("alpha", 7, None);
    guard.observe(&telescope("alpha"), &newer).unwrap();
    let mut older = permit(99, number, Verdict::Unsafe);
    older.body.token = 6;
    assert_eq!(guard.observe(&telescope("alpha"), &older), Err(Dropped::OldToken));
    assert!(guard.may_be_open(at(1.0)));
    assert_eq!(guard.published(0, at(1.0), 0).token, 7);
}

#[test]
fn a_permit_for_another_incarnation_of_the_guard_or_another_dome_is_none() {
    let mut guard = guard();
    let number = guard.beat(at(0.0));
    let mut foreign = safe(0, number);
    foreign.body.guard_boot_id = boot("the guard before the restart");
    assert_eq!(guard.observe(&telescope("alpha"), &foreign), Err(Dropped::OtherBoot));
    assert_eq!(guard.observe(&telescope("alpha"), &safe(0, number + 1)), Err(Dropped::UnknownNumber));
    assert_eq!(guard.observe(&telescope("beta"), &safe(0, number)), Err(Dropped::Stranger));
    assert!(!guard.may_be_open(at(1.0)));
}

#[test]
fn a_dome_found_open_at_the_start_has_one_permit_time_to_be_permitted() {
    let mut abandoned = guard();
    assert_eq!(abandoned.sees(at(9.9), Some(Shutter::Open), true), []);
    assert_eq!(abandoned.sees(at(10.0), Some(Shutter::Open), true), [GuardStep::Close]);
    let mut resumed = guard();
    assert_eq!(resumed.sees(at(1.0), Some(Shutter::Open), true), []);
    let number = resumed.beat(at(5.0));
    resumed.observe(&telescope("alpha"), &safe(0, number)).unwrap();
    assert_eq!(resumed.sees(at(11.0), Some(Shutter::Open), true), []);
}

#[test]
fn a_dome_that_was_never_seen_open_is_not_held() {
    let mut guard = guard();
    assert_eq!(guard.sees(at(11.0), None, true), [GuardStep::Close]);
    assert_eq!(guard.sees(at(12.0), Some(Shutter::Closed), true), []);
    assert!(!guard.published(0, at(12.0), 0).hold);
}

#[test]
fn an_opening_that_nobody_commanded_is_closed_although_it_is_safe() {
    let mut guard = guard();
    let number = guard.beat(at(0.0));
    guard.observe(&telescope("alpha"), &safe(0, number)).unwrap();
    assert_eq!(guard.sees(at(1.0), Some(Shutter::Closed), true), []);
    let steps = guard.sees(at(2.0), Some(Shutter::Opening), true);
    assert_eq!(steps, [GuardStep::Close, GuardStep::Raise(Alarm::Uncommanded)]);
    guard.sees(at(3.0), Some(Shutter::Closing), true);
    guard.sees(at(9.0), Some(Shutter::Closed), true);
    assert!(guard.open_commanded(at(9.5)).is_err(), "held until the commander resumes");
    guard.resume(at(9.5)).unwrap();
    assert!(guard.sees(at(9.6), Some(Shutter::Closed), true).contains(&GuardStep::Clear(Alarm::Uncommanded)));
}

#[test]
fn a_dome_over_two_telescopes_opens_for_both_or_not_at_all() {
    let mut guard = guard_with(CloseWithMount::Alongside, &["alpha", "beta"]);
    guard.sees(at(0.0), Some(Shutter::Closed), true);
    let number = guard.beat(at(0.0));
    guard.observe(&telescope("alpha"), &safe(0, number)).unwrap();
    assert!(guard.open_commanded(at(0.5)).is_err());
    let mut beta = safe(0, number);
    beta.body.token = 40;
    guard.grant("beta", 40, None);
    guard.observe(&telescope("beta"), &beta).unwrap();
    guard.open_commanded(at(0.5)).unwrap();
    let number = guard.beat(at(1.0));
    guard.observe(&telescope("alpha"), &permit(1, number, Verdict::Unsafe)).unwrap();
    assert_eq!(guard.sees(at(1.0), Some(Shutter::Open), true), [GuardStep::Close]);
    // Tokens are kept per telescope.
    assert_eq!(guard.observe(&telescope("alpha"), &safe(2, number)), Ok(Taken::Next));
}

#[test]
fn a_roof_waits_for_the_park_as_its_policy_demands() {
    let run = |policy, until: u32| {
        let mut guard = guard_with(policy, &["alpha"]);
        (10..=until)
            .flat_map(|second| guard.sees(at(f64::from(second)), Some(Shutter::Open), false))
            .collect::<Vec<_>>()
    };
    assert!(!closes(&run(CloseWithMount::ParkedWithinS, 129)));
    assert!(closes(&run(CloseWithMount::ParkedWithinS, 130)));
    let only = run(CloseWithMount::ParkedOnly, 1000);
    assert_eq!(only, [GuardStep::Raise(Alarm::MountNotParked)]);
    let mut parked = guard_with(CloseWithMount::ParkedOnly, &["alpha"]);
    parked.sees(at(10.0), Some(Shutter::Open), false);
    assert_eq!(parked.sees(at(11.0), Some(Shutter::Open), true), [GuardStep::Close]);
}

#[test]
fn a_roof_whose_mounts_nobody_parks_asks_for_help_after_10_s_and_at_an_end_at_once() {
    for (policy, helps) in [(CloseWithMount::Alongside, false), (CloseWithMount::ParkedOnly, true)] {
        let mut roof = guard_with(policy, &["alpha"]);
        roof.sees(at(10.0), Some(Shutter::Open), false);
        assert!(!roof.needs_help_with_mounts(at(19.0), false), "the observatory may be parking");
        assert_eq!(roof.needs_help_with_mounts(at(20.0), false), helps, "{policy:?}");
        assert!(!roof.needs_help_with_mounts(at(20.0), true), "the mounts are parked");
        let mut ending = guard_with(policy, &["alpha"]);
        ending.end();
        ending.sees(at(1.0), Some(Shutter::Open), false);
        assert_eq!(ending.needs_help_with_mounts(at(1.0), false), helps, "{policy:?}");
    }
    let mut closed = guard_with(CloseWithMount::ParkedOnly, &["alpha"]);
    closed.sees(at(10.0), Some(Shutter::Closed), false);
    closed.sees(at(30.0), Some(Shutter::Closed), false);
    assert!(!closed.needs_help_with_mounts(at(30.0), false), "no mount moves under a roof that nobody has opened");
}

proptest! {
    /// Whatever arrives, however often and in whatever order: a permit that carries no number younger than its validity
    /// keeps nothing open.
    #[test]
    fn no_sequence_of_permits_older_than_their_validity_keeps_a_dome_open(
        permits in prop::collection::vec((0_u64..40, 0_u64..6, 0_u64..4, any::<bool>(), 0_u64..3), 0..60),
    ) {
        let mut guard = open_guard();
        let numbers: Vec<u64> = (1..=20).map(|second| guard.beat(at(second as f64))).collect();
        let last_sent = at(20.0);
        let mut now = last_sent.plus(Duration::from_secs(VALID));
        for (seq, index, process, is_safe, token) in permits {
            let verdict = if is_safe { Verdict::Safe } else { Verdict::Unsafe };
            let mut payload = permit(seq, numbers[(index as usize * 4) % numbers.len()], verdict);
            payload.boot_id = boot(&format!("observatory-{process}"));
            payload.body.token = token;
            let _ = guard.observe(&telescope("alpha"), &payload);
            prop_assert!(!guard.may_be_open(now));
            prop_assert!(guard.open_commanded(now).is_err());
            now = now.plus(Duration::from_millis(300));
            guard.sees(now, Some(Shutter::Open), true);
            prop_assert!(guard.is_closing());
        }
    }

    /// The guard never reports that it may be open without a safe permit whose number it sent within the validity.
    #[test]
    fn what_may_be_open_rests_on_a_young_safe_permit(
        steps in prop::collection::vec((0_u64..4000, 0_usize..30, any::<bool>()), 1..80),
    ) {
        let mut guard = guard();
        let mut sent: Vec<(u64, f64)> = Vec::new();
        let (mut clock, mut accepted): (f64, Option<(f64, bool)>) = (0.0, None);
        for (seq, (pause_ms, back, is_safe)) in steps.into_iter().enumerate() {
            clock += pause_ms as f64 / 1000.0;
            sent.push((guard.beat(at(clock)), clock));
            let (number, at_s) = sent[sent.len().saturating_sub(1 + back)];
            let verdict = if is_safe { Verdict::Safe } else { Verdict::Unsafe };
            if guard.observe(&telescope("alpha"), &permit(seq as u64, number, verdict)).is_ok() {
                accepted = Some((at_s, is_safe));
            }
            let young_and_safe = accepted.is_some_and(|(at_s, safe)| safe && clock - at_s < VALID as f64 - 1e-6);
            if guard.may_be_open(at(clock)) {
                prop_assert!(accepted.is_some_and(|(at_s, safe)| safe && clock - at_s < VALID as f64 + 1e-6));
            } else {
                prop_assert!(!young_and_safe);
            }
        }
    }
}
