//! For any schedule, any verdicts and any change of the schedule: one row per camera, one per mount, and none that
//! needs a safe sky unless the newest verdict is safe and fresh, suspends nothing and allows its direction.

use std::time::Duration;

use contract::observatory::{Sector, Unsafe, Verdict};
use proptest::prelude::*;
use proptest::test_runner::Config;
use safety::current_verdict::CurrentVerdict;
use safety::objection::{sky_stands_against, stands_against};
use sky::{EarthOrientation, Observer, Place};
use units::Angle;
use units::MachineTime;

use super::*;
use crate::parse::parse;

const OBJECT: &str = r#"{"object": "x", "exptime": 1, "ra": 1, "dec": 1, "execute_parallel": PARALLEL}"#;
const STARING: &str =
    r#"{"object": "x", "exptime": 1, "disable_telescope_movement": true, "execute_parallel": PARALLEL}"#;
const CALIBRATION: &str = r#"{"exptime": [0], "n": [1], "execute_parallel": PARALLEL}"#;

/// Every action of the table, and those of them that have more than one sort of needs.
fn sorts() -> Vec<(&'static str, &'static str)> {
    let mut sorts: Vec<_> = crate::action::ACTIONS.iter().map(|entry| (entry.name, entry.example)).collect();
    sorts.extend([("object", OBJECT), ("object", STARING), ("calibration", CALIBRATION)]);
    sorts
}

/// A row as it is drawn: sort, camera, parallel, first and last hour of the window.
type Drawn = (usize, bool, bool, u32, u32);

/// The events of the night, one after another.
#[derive(Debug, Clone)]
enum Event {
    Later {
        minutes: u32,
    },
    /// Another verdict: unsafe, suspended, or away from a sector around this azimuth.
    Judged {
        is_safe: bool,
        is_suspended: bool,
        avoid_deg: Option<f64>,
    },
    /// No verdict comes for so long, ms of machine time.
    Silent {
        ms: u64,
    },
    Robotic {
        is_on: bool,
    },
    Lease {
        is_held: bool,
    },
    /// The n-th of the rows at work ends.
    Ends {
        nth: usize,
        status: RowStatus,
    },
    /// Another schedule: these of the drawn rows.
    Schedule {
        of: Vec<bool>,
    },
}

fn event() -> impl Strategy<Value = Event> {
    use RowStatus::{Failed, Finished, Interrupted};
    prop_oneof![
        3 => (1..200_u32).prop_map(|minutes| Event::Later { minutes }),
        4 => (prop::bool::weighted(0.8), prop::bool::weighted(0.2), prop::option::weighted(0.3, 0.0..360.0_f64))
            .prop_map(|(is_safe, is_suspended, avoid_deg)| Event::Judged { is_safe, is_suspended, avoid_deg }),
        2 => (0..7000_u64).prop_map(|ms| Event::Silent { ms }),
        1 => any::<bool>().prop_map(|is_on| Event::Robotic { is_on }),
        1 => prop::bool::weighted(0.8).prop_map(|is_held| Event::Lease { is_held }),
        3 => (0..4_usize, prop::sample::select(vec![Finished, Failed, Interrupted]))
            .prop_map(|(nth, status)| Event::Ends { nth, status }),
        1 => prop::collection::vec(any::<bool>(), 8).prop_map(|of| Event::Schedule { of }),
    ]
}

fn schedule(drawn: &[Drawn], of: &[bool]) -> Arc<Vec<Row>> {
    let sorts = sorts();
    let text: String = drawn
        .iter()
        .zip(of)
        .filter(|(_, wanted)| **wanted)
        .map(|((sort, second, parallel, from, length), _)| {
            let (action, value) = sorts[sort % sorts.len()];
            let value = value.replace("PARALLEL", &parallel.to_string());
            let (camera, until) = (if *second { "b" } else { "a" }, from + length);
            format!(
                r#"{{"device_name": "{camera}", "action_type": "{action}", "action_value": {value},
                "start_time": "2026-11-21 {from:02}:00:00", "end_time": "2026-11-21 {until:02}:00:00"}}"#
            )
        })
        .collect();
    if text.is_empty() {
        return Arc::default();
    }
    Arc::new(parse(&text, &["a".parse().unwrap(), "b".parse().unwrap()]).unwrap())
}

/// The night as the observatory node works through it: rows that may not run end at once, then rows are started until
/// none may.
struct Night {
    sequence: Sequence,
    now: Utc,
    machine: MachineTime,
    verdict: CurrentVerdict,
    is_robotic: bool,
    commands: bool,
    started: usize,
}

/// How far to both sides of its middle a sector that is avoided reaches, degrees.
const AVOIDED_DEG: f64 = 50.0;

/// The sky over Paranal.
fn over_paranal(at: Utc) -> Observer {
    let place = Place::new(Angle::from_degrees(-24.6), Angle::from_degrees(-70.4), 2500.0).unwrap();
    Observer::new(&place, &EarthOrientation::default(), at).unwrap()
}

/// A safe verdict of this instant.
fn safe(now: MachineTime) -> CurrentVerdict {
    let mut verdict = CurrentVerdict::none(now, Utc::EPOCH);
    verdict.state.verdict = Verdict::Safe;
    verdict
}

impl Night {
    fn may(&self, row: &Row) -> bool {
        let azimuth_deg = || row.action.azimuth_deg(&over_paranal(self.now));
        let sky = || sky_stands_against(&self.verdict, self.machine, azimuth_deg);
        stands_against(self.is_robotic, self.commands, row.action.needs().safe, sky).is_none()
    }

    fn settle(&mut self) {
        let against: Vec<RowId> =
            self.sequence.at_work.values().filter(|row| !self.may(row)).map(|row| row.id.clone()).collect();
        for id in against {
            self.sequence.end(&id, RowStatus::Interrupted);
        }
        for index in self.sequence.passed(self.now) {
            self.sequence.set(index, RowStatus::Skipped);
        }
        while let Some(index) = self.sequence.next(self.now, |_, row| self.may(row)) {
            let row = self.sequence.begin(index).unwrap();
            assert!(row.start <= self.now && self.now <= row.end, "outside its window: {row:?}");
            self.started += 1;
        }
    }

    fn follow(&mut self, event: &Event, drawn: &[Drawn]) {
        match event {
            Event::Later { minutes } => self.now = self.now.plus_seconds(f64::from(*minutes) * 60.0),
            Event::Judged { is_safe, is_suspended, avoid_deg } => {
                self.machine = self.machine.plus(Duration::from_secs(1));
                self.verdict = safe(self.machine);
                let state = &mut self.verdict.state;
                state.verdict = if *is_safe { Verdict::Safe } else { Verdict::Unsafe };
                let cloud = Unsafe { input: "sky".to_owned(), why: "cloudy".to_owned(), clears_in_s: None };
                state.suspended = is_suspended.then_some(cloud).into_iter().collect();
                let sector = |azimuth_deg| Sector { azimuth_deg, half_width_deg: AVOIDED_DEG, why: "wind".to_owned() };
                state.avoid = avoid_deg.map(sector).into_iter().collect();
            }
            Event::Silent { ms } => self.machine = self.machine.plus(Duration::from_millis(*ms)),
            Event::Robotic { is_on } => self.is_robotic = *is_on,
            Event::Lease { is_held } => self.commands = *is_held,
            Event::Ends { nth, status } => {
                let id = self.sequence.at_work.keys().nth(*nth).cloned();
                if let Some(id) = id {
                    self.sequence.end(&id, *status);
                }
            }
            Event::Schedule { of } => {
                let known: BTreeMap<RowId, RowStatus> =
                    self.sequence.rows.iter().map(|row| row.id.clone()).zip(self.sequence.statuses.clone()).collect();
                let leaving = self.sequence.take(schedule(drawn, of), |id| known.get(id).copied());
                assert!(leaving.iter().all(|id| self.sequence.place_of(id).is_none()));
            }
        }
    }

    fn check(&self) {
        let at_work: Vec<&Row> = self.sequence.at_work.values().collect();
        let mounts = at_work.iter().filter(|row| row.action.needs().mount).count();
        assert!(mounts <= 1, "{mounts} rows hold the mount: {at_work:?}");
        for camera in ["a", "b"] {
            let with_it = at_work.iter().filter(|row| row.camera.as_str() == camera).count();
            assert!(with_it <= 1, "{with_it} rows hold camera {camera}: {at_work:?}");
        }
        let alone = at_work.iter().filter(|row| !row.action.needs().parallel).count();
        assert!(alone <= 1, "{alone} rows at work that none may run alongside: {at_work:?}");
        let state = &self.verdict.state;
        let age = self.machine.since(self.verdict.judged);
        let is_open = state.verdict == Verdict::Safe && state.suspended.is_empty() && age <= Duration::from_secs(5);
        for row in &at_work {
            assert!(self.is_robotic && self.commands, "nobody may move anything: {row:?}");
            let needs = row.action.needs();
            assert!(is_open || !needs.safe, "under {state:?} of {age:?} ago: {row:?}");
            if let (true, [sector]) = (needs.safe, state.avoid.as_slice()) {
                let at_deg = row.action.azimuth_deg(&over_paranal(self.now));
                let apart = at_deg.map(|at_deg| (at_deg - sector.azimuth_deg).to_radians().cos().acos().to_degrees());
                assert!(apart.is_none_or(|apart| apart > AVOIDED_DEG - 1e-6), "{apart:?} deg from {sector:?}: {row:?}");
            }
        }
        let shown = self.sequence.statuses.iter().filter(|status| **status == RowStatus::Running).count();
        assert!(shown <= at_work.len(), "{shown} rows are shown as running, {} are", at_work.len());
    }
}

fn drawn() -> impl Strategy<Value = Vec<Drawn>> {
    prop::collection::vec((0..64_usize, any::<bool>(), any::<bool>(), 0..12_u32, 1..11_u32), 8)
}

proptest! {
    #![proptest_config(Config { cases: 400, failure_persistence: None, ..Config::default() })]

    #[test]
    fn no_schedule_opens_under_an_unsafe_sky_or_lets_two_rows_have_one_mount(
        drawn in drawn(), events in prop::collection::vec(event(), 1..60)
    ) {
        let mut night = Night { now: "2026-11-21T00:00:00Z".parse().unwrap(), ..at_one() };
        night.follow(&Event::Schedule { of: vec![true; 8] }, &drawn);
        for event in &events {
            night.settle();
            night.check();
            night.follow(event, &drawn);
        }
    }
}

fn at_one() -> Night {
    let machine = MachineTime::from_boot(Duration::from_secs(1000));
    Night {
        sequence: Sequence::default(),
        now: "2026-11-21T01:30:00Z".parse().unwrap(),
        machine,
        verdict: safe(machine),
        is_robotic: true,
        commands: true,
        started: 0,
    }
}

#[test]
fn whatever_has_the_roof_or_the_mount_needs_a_safe_sky_but_closing() {
    for entry in crate::action::ACTIONS {
        let row = format!(
            r#"{{"device_name": "a", "action_type": "{}", "action_value": {},
            "start_time": "2026-11-21 01:00:00", "end_time": "2026-11-21 02:00:00"}}"#,
            entry.name, entry.example
        );
        let rows = parse(&row, &["a".parse().unwrap()]).unwrap();
        let needs = rows[0].action.needs();
        assert!(!needs.mount || needs.safe || entry.name == "close", "{}: {needs:?}", entry.name);
    }
}

/// Sorts of rows by their place in `sorts`, counted from its end: moving, staring, calibration.
fn one(from_the_end: usize, second: bool, parallel: bool) -> Drawn {
    (sorts().len() - from_the_end, second, parallel, 1, 5)
}

#[test]
fn a_row_that_stays_in_the_schedule_goes_on_and_one_that_is_taken_out_keeps_the_mount_until_it_has_ended() {
    let drawn = [one(3, false, false), one(3, true, false)];
    let mut night = at_one();
    night.follow(&Event::Schedule { of: vec![true, true] }, &drawn);
    night.settle();
    assert_eq!(night.sequence.statuses(), [RowStatus::Running, RowStatus::Pending]);
    let first = night.sequence.rows()[0].id.clone();

    // The other row is taken out and comes back: the first goes on.
    night.follow(&Event::Schedule { of: vec![true, false] }, &drawn);
    night.settle();
    assert_eq!(night.sequence.statuses(), [RowStatus::Running]);

    // Now the first is taken out: the second waits for it.
    night.follow(&Event::Schedule { of: vec![false, true] }, &drawn);
    night.settle();
    assert_eq!(night.sequence.statuses(), [RowStatus::Pending]);
    assert!(!night.sequence.is_over() && !night.sequence.is_idle());
    assert_eq!(night.sequence.end(&first, RowStatus::Interrupted), None);
    night.settle();
    assert_eq!(night.sequence.statuses(), [RowStatus::Running]);
    assert_eq!(night.started, 2);
}

#[test]
fn a_second_camera_runs_alongside_a_parallel_row_that_has_the_mount() {
    let drawn = [one(3, false, true), one(2, true, true), one(3, true, true)];
    let mut night = at_one();
    night.follow(&Event::Schedule { of: vec![true; 3] }, &drawn);
    night.settle();
    night.check();
    assert_eq!(night.sequence.statuses(), [RowStatus::Running, RowStatus::Running, RowStatus::Pending]);
}

#[test]
fn the_reason_of_an_interruption_goes_when_nothing_stands_against_its_row_any_more() {
    let drawn = [one(3, false, false), one(3, true, false)];
    let mut night = at_one();
    night.follow(&Event::Schedule { of: vec![true, true] }, &drawn);
    night.settle();
    let first = night.sequence.rows()[0].id.clone();
    assert_eq!(night.sequence.released(|_| false), [0; 0], "one row runs, the other one was never interrupted");
    night.sequence.end(&first, RowStatus::Interrupted);
    assert_eq!(night.sequence.released(|row| row.id == first), [0; 0], "it rains still");
    assert_eq!(night.sequence.released(|_| false), [0]);
}

#[test]
fn rows_that_were_skipped_while_the_clock_was_ahead_wait_again_and_those_that_ended_otherwise_do_not() {
    let line = |object: &str, start: &str, end: &str| {
        format!(
            "{{\"device_name\": \"c\", \"action_type\": \"object\", \"start_time\": \"2026-11-21T{start}:00\", \
             \"end_time\": \"2026-11-21T{end}:00\", \"action_value\": {{\"object\": \"{object}\", \"exptime\": 1, \"ra\": 1, \"dec\": 1}}}}\n"
        )
    };
    let text = [line("a", "01:00", "02:00"), line("b", "03:00", "04:00"), line("c", "03:30", "05:00")].concat();
    let rows = parse(&text, &["c".parse().unwrap()]).unwrap();
    let by_order = rows[2].id.clone();
    let mut sequence = Sequence::default();
    sequence.take(Arc::new(rows), |_| None);
    let at = |text: &str| -> Utc { format!("2026-11-21T{text}:00Z").parse().unwrap() };
    for index in sequence.passed(at("06:00")) {
        sequence.set(index, RowStatus::Skipped);
    }
    assert!(sequence.is_over());
    assert_eq!(sequence.skipped_before(at("03:10"), |id| *id == by_order), [1], "a has passed, and c was ordered");
    sequence.set(1, RowStatus::Pending);
    assert_eq!(sequence.next(at("03:10"), |_, _| true), Some(1));
}
