//! The guard before a status that lies, a roof that waits, and a lease that nobody granted.

use contract::observatory::Verdict;

use super::tests::{Sees as _, at, boot, closes, guard, guard_with, permit, safe, telescope};
use super::*;
use crate::shutter_evidence::Contradiction;

/// A guard whose dome was opened by its own request, and whose status has been open ever since.
fn opened(reported: Shutter) -> Guard {
    let mut guard = guard();
    guard.sees(at(0.0), Some(Shutter::Closed), true);
    let number = guard.beat(at(0.0));
    guard.observe(&telescope("alpha"), &safe(0, number)).unwrap();
    guard.open_commanded(at(1.0)).unwrap();
    guard.open_sent(at(1.0));
    guard.sees(at(2.0), Some(reported), true);
    guard
}

fn unsafe_at(guard: &mut Guard, seconds: f64) {
    let number = guard.beat(at(seconds));
    guard.observe(&telescope("alpha"), &permit(900 + seconds as u64, number, Verdict::Unsafe)).unwrap();
}

#[test]
fn a_status_that_sticks_at_closed_suppresses_no_close_request_and_is_reported() {
    let mut guard = opened(Shutter::Closed);
    unsafe_at(&mut guard, 3.0);
    let mut all = Vec::new();
    for second in 3..=120 {
        unsafe_at(&mut guard, f64::from(second));
        all.extend(
            guard.sees(at(f64::from(second)), Some(Shutter::Closed), true).into_iter().map(|step| (second, step)),
        );
    }
    assert_eq!(all[0], (3, GuardStep::Close));
    assert!(!all.iter().any(|(_, step)| *step == GuardStep::AbortThenClose), "it may be closing all the same");
    let raised = (8, GuardStep::Raise(Alarm::Contradicts(Contradiction::StuckAtClosed)));
    assert!(all.contains(&raised), "{all:?}");
    assert!(all.iter().any(|(_, step)| *step == GuardStep::Raise(Alarm::NotClosed)));
    // After the time that the shutter needs nothing more can be asked; the contradiction stays.
    assert!(!guard.is_closing() && guard.is_closed(at(120.0)), "{all:?}");
    assert!(!all.contains(&(120, GuardStep::Clear(Alarm::Contradicts(Contradiction::StuckAtClosed)))));
    assert_eq!(guard.published(0, at(120.0), 0).verified_closed, Some(true));
}

#[test]
fn a_shutter_that_opens_again_while_it_must_close_is_asked_at_once() {
    use Shutter::{Closing, Open, Opening};
    // By the half second from the first request on: what is seen.
    for (seen, asked_at) in [
        // A request to open that the server carried out late.
        (vec![Open, Open, Opening, Opening, Opening, Opening], 5.0),
        // Another client, while it closes.
        (vec![Closing, Closing, Closing, Closing, Opening, Opening], 5.5),
        (vec![Closing, Closing, Closing, Closing, Open, Open], 5.5),
    ] {
        let mut guard = opened(Open);
        let mut requests = Vec::new();
        for (step, shutter) in [Open].into_iter().chain(seen.clone()).enumerate() {
            let now = 3.0 + 0.5 * step as f64;
            unsafe_at(&mut guard, now);
            if closes(&guard.sees(at(now), Some(shutter), true)) {
                requests.push(now);
            }
        }
        assert_eq!(requests, [3.0, asked_at], "{seen:?}");
    }
}

#[test]
fn a_status_that_sticks_at_anything_else_is_asked_to_close_for_ever() {
    for stuck in [Shutter::Open, Shutter::Opening, Shutter::Closing, Shutter::Error] {
        let mut guard = opened(Shutter::Open);
        guard.sees(at(2.5), Some(stuck), true);
        let mut requests = Vec::new();
        for second in 3..=600 {
            unsafe_at(&mut guard, f64::from(second));
            if closes(&guard.sees(at(f64::from(second)), Some(stuck), true)) {
                requests.push(second);
            }
        }
        assert_eq!(requests[0], 3, "{stuck:?}");
        assert!(requests.len() >= 6 && guard.is_closing() && !guard.is_closed(at(600.0)), "{stuck:?}: {requests:?}");
    }
}

#[test]
fn an_opening_that_begins_after_the_command_to_close_was_commanded_and_one_after_the_proof_was_not() {
    for shutter in [Shutter::Opening, Shutter::Open] {
        let mut guard = opened(Shutter::Closed);
        guard.close_commanded(at(3.0));
        guard.close_sent(at(3.0));
        guard.close_answered(true, at(3.0));
        assert_eq!(guard.sees(at(3.5), Some(Shutter::Closed), true), [], "its opening has not begun");
        for (second, seen) in [(4.0, shutter), (5.0, Shutter::Closing), (6.0, Shutter::Closed)] {
            assert_eq!(guard.sees(at(second), Some(seen), true), [], "{shutter:?}, second {second}");
        }
        assert!(guard.is_closed(at(6.0)));
        let steps = guard.sees(at(7.0), Some(shutter), true);
        assert_eq!(steps, [GuardStep::Close, GuardStep::Raise(Alarm::Uncommanded)], "nobody commanded this one");
    }
}

#[test]
fn an_opening_that_begins_after_the_commander_took_over_from_the_guards_closing_was_commanded() {
    let mut guard = opened(Shutter::Closed);
    unsafe_at(&mut guard, 3.0);
    assert!(closes(&guard.sees(at(3.0), Some(Shutter::Closed), true)));
    let number = guard.beat(at(4.0));
    guard.observe(&telescope("alpha"), &safe(904, number)).unwrap();
    guard.resume(at(4.0)).unwrap();
    // Its opening has not begun when the commander resumes, begins all the same, and the request of before closes it.
    for (second, seen) in
        [(4.5, Shutter::Closed), (5.0, Shutter::Opening), (6.0, Shutter::Closing), (7.0, Shutter::Closed)]
    {
        assert_eq!(guard.sees(at(second), Some(seen), true), [], "second {second}");
    }
    let steps = guard.sees(at(8.0), Some(Shutter::Opening), true);
    assert_eq!(steps, [GuardStep::Close, GuardStep::Raise(Alarm::Uncommanded)], "nobody commanded this one");
}

#[test]
fn an_opening_long_after_a_command_to_close_that_the_dome_refused_was_not_commanded() {
    let safe_at = |guard: &mut Guard, second: u32| {
        let number = guard.beat(at(f64::from(second)));
        guard.observe(&telescope("alpha"), &safe(900 + u64::from(second), number)).unwrap();
    };
    for resumes in [false, true] {
        let mut guard = opened(Shutter::Closed);
        if resumes {
            unsafe_at(&mut guard, 3.0);
            assert!(closes(&guard.look(at(3.0), Some((Shutter::Closed, at(3.0))), true)));
        } else {
            guard.close_commanded(at(3.0));
            guard.close_sent(at(3.0));
        }
        guard.close_answered(false, at(3.0));
        for second in 4..=94 {
            safe_at(&mut guard, second);
            if resumes && second == 4 {
                guard.resume(at(4.0)).unwrap();
            }
            // The shutter's time is 90 s: until then it may be the opening of before.
            if second == 60 {
                assert!(!closes(&guard.clone().sees(at(60.0), Some(Shutter::Opening), true)), "{resumes}");
            }
            assert!(!closes(&guard.sees(at(f64::from(second)), Some(Shutter::Closed), true)), "{resumes}, {second}");
        }
        safe_at(&mut guard, 95);
        let steps = guard.sees(at(95.0), Some(Shutter::Opening), true);
        assert!(closes(&steps) && steps.contains(&GuardStep::Raise(Alarm::Uncommanded)), "{resumes}: {steps:?}");
    }
}

#[test]
fn a_closing_of_the_guard_long_after_a_command_that_moved_nothing_is_a_hold() {
    for (waits_s, holds) in [(10_u32, false), (100, true)] {
        let mut guard = opened(Shutter::Open);
        guard.close_commanded(at(3.0));
        for second in 3..=waits_s {
            let number = guard.beat(at(f64::from(second)));
            guard.observe(&telescope("alpha"), &safe(900 + u64::from(second), number)).unwrap();
            assert!(!closes(&guard.sees(at(f64::from(second)), Some(Shutter::Open), true)), "{second}");
        }
        let lost = f64::from(waits_s) + 1.0;
        unsafe_at(&mut guard, lost);
        assert!(closes(&guard.sees(at(lost), Some(Shutter::Open), true)));
        guard.sees(at(lost + 1.0), Some(Shutter::Closing), true);
        guard.sees(at(lost + 20.0), Some(Shutter::Closed), true);
        assert_eq!(guard.published(0, at(lost + 20.0), 0).hold, holds, "{waits_s}");
    }
}

#[test]
fn what_was_read_before_the_request_proves_nothing() {
    let mut guard = opened(Shutter::Open);
    unsafe_at(&mut guard, 3.0);
    // The reading was under way while the request left.
    let steps = guard.look(at(3.2), Some((Shutter::Closed, at(2.9))), true);
    assert!(closes(&steps), "{steps:?}");
    assert!(guard.is_closing() && !guard.is_closed(at(3.2)));
}

#[test]
fn a_server_that_restarts_and_reports_closed_by_default_is_asked_all_the_same() {
    let mut guard = opened(Shutter::Open);
    // 4 s without a reading, and then it is closed although nobody asked.
    let steps = guard.sees(at(7.0), Some(Shutter::Closed), true);
    assert_eq!(steps, [GuardStep::Raise(Alarm::Contradicts(Contradiction::ClosedUnseen))]);
    unsafe_at(&mut guard, 8.0);
    assert!(closes(&guard.sees(at(8.0), Some(Shutter::Closed), true)));
    assert!(!guard.is_closed(at(8.0)));
}

#[test]
fn a_dome_that_was_seen_to_close_by_itself_is_asked_once_more_and_believed() {
    let mut guard = opened(Shutter::Open);
    guard.sees(at(3.0), Some(Shutter::Closing), true);
    assert_eq!(guard.sees(at(4.0), Some(Shutter::Closed), true), []);
    unsafe_at(&mut guard, 5.0);
    assert!(closes(&guard.sees(at(5.0), Some(Shutter::Closed), true)));
    guard.sees(at(6.0), Some(Shutter::Closed), true);
    assert!(guard.is_closed(at(6.0)) && !guard.is_closing());
}

#[test]
fn a_shutter_that_reports_closed_much_sooner_than_it_moves_is_not_believed_at_once() {
    let mut guard = guard();
    let safe_at = |guard: &mut Guard, second: u32| {
        let number = guard.beat(at(f64::from(second)));
        guard.observe(&telescope("alpha"), &safe(second.into(), number)).unwrap();
    };
    for second in 0..40 {
        safe_at(&mut guard, second);
        let reported = match second {
            0 => Shutter::Closed,
            1..=29 => Shutter::Opening,
            _ => Shutter::Open,
        };
        guard.sees(at(f64::from(second)), Some(reported), true);
        if second == 0 {
            guard.open_commanded(at(0.5)).unwrap();
            guard.open_sent(at(0.5));
        }
    }
    // It took 29.5 s to open; asked to close at second 41, its status is closed one second later.
    unsafe_at(&mut guard, 41.0);
    assert!(closes(&guard.sees(at(41.0), Some(Shutter::Open), true)));
    let mut believed = None;
    for second in 42..100 {
        unsafe_at(&mut guard, f64::from(second));
        let steps = guard.sees(at(f64::from(second)), Some(Shutter::Closed), true);
        let is_raised = steps.contains(&GuardStep::Raise(Alarm::Contradicts(Contradiction::TooFast)));
        assert_eq!(is_raised, second == 42, "second {second}: {steps:?}");
        if guard.is_closed(at(f64::from(second))) {
            believed.get_or_insert(second);
        }
    }
    assert_eq!(believed, Some(71));
}

#[test]
fn a_dome_that_was_commanded_to_open_and_refused_is_as_closed_as_before() {
    let mut guard = guard();
    assert!(closes(&guard.sees(at(11.0), Some(Shutter::Closed), true)), "nothing is known of the time before");
    guard.sees(at(12.0), Some(Shutter::Closed), true);
    assert!(guard.is_closed(at(12.0)));
    guard.open_sent(at(12.5));
    assert!(!guard.is_closed(at(12.5)));
    guard.open_refused();
    guard.sees(at(13.0), Some(Shutter::Closed), true);
    assert!(guard.is_closed(at(13.0)));
}

#[test]
fn a_request_that_the_dome_refuses_proves_nothing() {
    let mut guard = guard();
    assert!(closes(&guard.look(at(11.0), Some((Shutter::Closed, at(11.0))), true)));
    guard.close_answered(false, at(11.1));
    guard.look(at(12.0), Some((Shutter::Closed, at(12.0))), true);
    assert!(!guard.is_closed(at(12.0)) && guard.is_closing());
}

#[test]
fn a_status_that_flips_must_report_closed_for_a_while_and_is_reported() {
    let mut guard = guard();
    guard.sees(at(11.0), Some(Shutter::Closed), true);
    guard.sees(at(12.0), Some(Shutter::Closed), true);
    let mut all = Vec::new();
    for second in 13..23 {
        let reported = if second % 2 == 1 { Shutter::Open } else { Shutter::Closed };
        all.extend(guard.sees(at(f64::from(second)), Some(reported), true));
    }
    assert!(all.contains(&GuardStep::Raise(Alarm::Contradicts(Contradiction::Flips))), "{all:?}");
    assert!(!guard.is_closed(at(22.0)), "its status was closed for 1 s");
    (23..29).for_each(|second| drop(guard.sees(at(f64::from(second)), Some(Shutter::Closed), true)));
    assert!(guard.is_closed(at(28.0)));
}

#[test]
fn a_percentage_is_never_proof_of_closed() {
    let mut guard = opened(Shutter::Open);
    guard.odd_status(60);
    guard.odd_status(30);
    unsafe_at(&mut guard, 3.0);
    guard.sees(at(3.0), Some(Shutter::Closing), true);
    for second in 4..200 {
        unsafe_at(&mut guard, f64::from(second));
        guard.sees(at(f64::from(second)), Some(Shutter::Closed), true);
    }
    assert!(!guard.is_closed(at(199.0)), "1 % is not closed");
    let number = guard.beat(at(200.0));
    guard.observe(&telescope("alpha"), &safe(5000, number)).unwrap();
    assert!(guard.open_commanded(at(200.0)).is_err());
}

#[test]
fn a_roof_that_only_lacks_its_proof_raises_no_alarm_because_of_a_mount() {
    let mut guard = guard_with(CloseWithMount::ParkedOnly, &["alpha"]);
    for second in 0..400 {
        assert_eq!(guard.sees(at(f64::from(second)), Some(Shutter::Closed), false), [], "second {second}");
    }
    assert!(closes(&guard.sees(at(400.0), Some(Shutter::Closed), true)));
    guard.sees(at(401.0), Some(Shutter::Closed), true);
    assert!(guard.is_closed(at(401.0)));
}

#[test]
fn a_bare_close_of_a_roof_that_waits_moves_it_only_over_parked_mounts() {
    for (policy, after_s) in [(CloseWithMount::ParkedOnly, None), (CloseWithMount::ParkedWithinS, Some(123))] {
        let mut guard = guard_with(policy, &["alpha"]);
        let mut first = None;
        for second in 0..300_u32 {
            let number = guard.beat(at(f64::from(second)));
            guard.observe(&telescope("alpha"), &safe(second.into(), number)).unwrap();
            if second == 1 {
                guard.open_commanded(at(1.0)).unwrap();
                guard.open_sent(at(1.0));
            }
            if second == 3 {
                guard.close_commanded(at(3.0));
            }
            let reported = if second < 2 { Shutter::Closed } else { Shutter::Open };
            if closes(&guard.sees(at(f64::from(second)), Some(reported), false)) {
                first.get_or_insert(second);
            }
        }
        assert_eq!(first, after_s, "{policy:?}");
        assert!(closes(&guard.sees(at(300.5), Some(Shutter::Open), true)) || after_s.is_some());
    }
}

#[test]
fn a_token_that_nobody_granted_changes_nothing_for_the_real_commander() {
    let mut guard = guard();
    for (seq, token) in [(1, 2), (2, 1000), (3, u64::MAX)] {
        let number = guard.beat(at(seq as f64));
        let mut invented = permit(9_000_000, number, Verdict::Unsafe);
        invented.body.token = token;
        assert_eq!(guard.observe(&telescope("alpha"), &invented), Err(Dropped::NeverGranted));
        guard.observe(&telescope("alpha"), &safe(seq, number)).unwrap();
        assert!(guard.may_be_open(at(seq as f64)));
    }
    assert_eq!(guard.published(0, at(4.0), 0).token, 1);
}

#[test]
fn of_two_that_speak_with_one_lease_in_one_name_the_safer_word_counts() {
    let mut guard = guard();
    let number = guard.beat(at(0.0));
    guard.observe(&telescope("alpha"), &safe(1, number)).unwrap();
    // Another process counts far ahead; one such sample ends nothing.
    let number = guard.beat(at(1.0));
    guard.observe(&telescope("alpha"), &safe(u64::MAX, number)).unwrap();
    let number = guard.beat(at(2.0));
    assert_eq!(guard.observe(&telescope("alpha"), &safe(2, number)), Ok(Taken::Contested));
    assert!(guard.may_be_open(at(2.0)), "both publish safe");
    // Now the commander publishes unsafe, and the other one still publishes safe.
    let number = guard.beat(at(3.0));
    guard.observe(&telescope("alpha"), &safe(u64::MAX, number)).unwrap();
    let number = guard.beat(at(4.0));
    assert_eq!(guard.observe(&telescope("alpha"), &permit(3, number, Verdict::Unsafe)), Ok(Taken::Contested));
    let number = guard.beat(at(5.0));
    guard.observe(&telescope("alpha"), &safe(u64::MAX, number)).unwrap();
    assert!(!guard.may_be_open(at(5.0)) && guard.open_commanded(at(5.0)).is_err());
    assert!(closes(&guard.sees(at(5.0), Some(Shutter::Open), true)));
    assert!(!guard.may_be_open(at(13.9)));
}

#[test]
fn a_lease_that_was_granted_to_one_incarnation_belongs_to_no_other() {
    let mut guard = guard();
    guard.grant("alpha", 2, Some(&boot("observatory-1")));
    let number = guard.beat(at(0.0));
    let mut real = safe(0, number);
    real.body.token = 2;
    let mut other = real.clone();
    other.boot_id = boot("zzz");
    assert_eq!(guard.observe(&telescope("alpha"), &other), Err(Dropped::OtherIncarnation));
    assert_eq!(guard.observe(&telescope("alpha"), &real), Ok(Taken::Next));
}

#[test]
fn after_a_restart_of_the_guard_no_stranger_takes_the_lease_by_speaking_first() {
    let mut guard = guard();
    let number = guard.beat(at(0.0));
    let mut stranger = safe(7, number);
    stranger.boot_id = boot("a stranger");
    guard.observe(&telescope("alpha"), &stranger).unwrap();
    let number = guard.beat(at(1.0));
    assert_eq!(guard.observe(&telescope("alpha"), &safe(3, number)), Ok(Taken::Contested));
    assert!(guard.may_be_open(at(9.0)), "the commander's permit keeps it open");
    let number = guard.beat(at(2.0));
    guard.observe(&telescope("alpha"), &permit(4, number, Verdict::Unsafe)).unwrap();
    let number = guard.beat(at(3.0));
    stranger.body.guard_number = number;
    assert_eq!(guard.observe(&telescope("alpha"), &stranger), Ok(Taken::Contested));
    assert!(!guard.may_be_open(at(3.0)), "and its unsafe permit counts alongside the stranger's");
}

#[test]
fn a_dome_that_must_close_reports_it_until_it_is_proven_closed() {
    let mut guard = opened(Shutter::Open);
    assert!(!guard.needs_closing(at(2.5)));
    unsafe_at(&mut guard, 3.0);
    assert!(guard.needs_closing(at(3.0)), "before the guard has looked");
    guard.sees(at(3.0), Some(Shutter::Open), true);
    guard.sees(at(4.0), Some(Shutter::Closing), true);
    assert!(guard.needs_closing(at(4.0)));
    guard.sees(at(5.0), Some(Shutter::Closed), true);
    assert!(!guard.needs_closing(at(5.0)));
}
