use std::collections::BTreeMap;

use contract::device::record::{StateEntry, StateRecord};
use contract::device::safety_monitor::Fields as Monitor;
use contract::observatory::Verdict;
use contract::{BootId, Datum, DeviceState, Link, Stamped};
use units::{MachineTime, SkyTime};

use super::*;
use crate::current_verdict::CurrentVerdict;
use crate::fixture::{self, m, utc};
use crate::judge::{Judgement, judge};
use crate::reading::state;
use crate::recall::{Asked, PlacedState, Recall};

fn at(second: u64) -> Now {
    fixture::at(second, 1.0)
}

/// A monitor with 120 s of dwell, of which 8 s are allowed.
fn rules() -> Rules {
    Rules { limits: Vec::new(), ..fixture::rules(120, 8, 60) }
}

fn reading(is_safe: bool, gapless_safe_s: f64) -> Monitor {
    Monitor { is_safe: Datum::Known(is_safe), gapless_safe_s }
}

fn placed(second: u64, is_safe: bool) -> PlacedState<Monitor> {
    PlacedState { at: at(second), link: Link::Connected, fields: reading(is_safe, 0.0), ages_s: BTreeMap::new() }
}

/// A node that receives a monitor's states.
struct Site {
    rules: Rules,
    history: History,
}

impl Site {
    /// Safe since 0 s, of which nothing was received between 114 s and 117 s, and now it is 120 s: the dwell ends.
    fn with_a_hole() -> Self {
        let mut site = Self { history: History::new(&rules(), at(0).sky), rules: rules() };
        site.history.go_without(&m(), None);
        site.receive(0..=114, 0.0);
        let hole = Hole { from_utc: Some(utc(114.0)), until_utc: utc(117.0) };
        site.history.miss(&site.rules, &m(), hole);
        site.receive(117..=120, 0.0);
        site
    }

    fn receive(&mut self, seconds: std::ops::RangeInclusive<u64>, gapless_safe_s: f64) {
        for second in seconds {
            let state = state(Link::Connected, reading(true, gapless_safe_s));
            self.history.observe_monitor(&self.rules, &m(), &state, at(second));
        }
    }

    /// What is judged after this verdict.
    fn judged(&self, before: Verdict, second: u64) -> Judgement {
        let mut verdict = CurrentVerdict::none(at(second).machine, utc(second as f64));
        (verdict.settled, verdict.state.verdict) = (true, before);
        verdict.hold(judge(&self.rules, &self.history, at(second)))
    }
}

#[test]
fn a_dwell_that_ends_while_a_device_node_is_asked_opens_nothing() {
    let mut site = Site::with_a_hole();
    let shut = site.judged(Verdict::Unsafe, 120);
    let why = "asks its device node what it published between 08:01:54 and 08:01:57 UTC";
    let asks = Unsafe { input: "safetymonitor/m".to_owned(), why: why.to_owned(), clears_in_s: None };
    assert_eq!((shut.verdict, shut.time_to_safe_s), (Verdict::Unsafe, None));
    assert_eq!(shut.reasons, std::slice::from_ref(&asks));
    // A dome that is shut under a safe verdict waits for what keeps it shut; an open one is not closed.
    let open = site.judged(Verdict::Safe, 120);
    assert_eq!((open.verdict, &open.reasons), (Verdict::Safe, &Vec::new()));
    assert_eq!(open.advisories, std::slice::from_ref(&asks));
    assert_eq!(open.keeps_shut, [asks]);

    let answer = |is_safe: bool| (115..=120).map(|second| placed(second, is_safe || second != 115)).collect::<Vec<_>>();
    let mut rained = Site::with_a_hole();
    rained.history.recall_monitor(&rained.rules, &m(), answer(false));
    assert_eq!(rained.judged(Verdict::Unsafe, 120).time_to_safe_s, Some(116.0), "good since 116");
    site.history.recall_monitor(&site.rules, &m(), answer(true));
    assert_eq!(site.judged(Verdict::Unsafe, 120).verdict, Verdict::Safe);
}

#[test]
fn before_its_first_inputs_were_received_a_node_that_was_restarted_closes_nothing_over_them() {
    let site = Site::with_a_hole();
    let verdict = CurrentVerdict::none(at(120).machine, utc(120.0));
    let judged = verdict.hold(judge(&site.rules, &site.history, at(120)));
    assert_eq!((judged.verdict, judged.keeps_shut.len()), (Verdict::Safe, 1));
    // A device that nothing was received of keeps a dome shut, too.
    let mut fresh = History::new(&rules(), at(0).sky);
    assert_eq!(fresh.keeps_shut(&rules(), at(1)).len(), 1);
    fresh.go_without(&m(), None);
    assert_eq!(fresh.keeps_shut(&rules(), at(1)), []);
    // One that the site can do without does not.
    let mut optional = fixture::rules(120, 8, 60);
    optional.monitors.clear();
    optional.limits.retain(|limit| !limit.needs_each());
    assert_eq!(History::new(&optional, at(0).sky).keeps_shut(&optional, at(1)), []);
}

#[test]
fn what_cannot_be_taken_starts_the_dwell_of_a_shut_dome_anew_also_over_a_restart() {
    let mut site = Site::with_a_hole();
    let refused = ("its state 115 differs from the one that was received".to_owned(), at(120));
    site.history.go_without(&m(), Some(refused));
    site.receive(121..=130, 0.0);
    let shut = site.judged(Verdict::Unsafe, 130);
    assert_eq!((shut.verdict, shut.time_to_safe_s), (Verdict::Unsafe, Some(110.0)));
    let why = "what its device node published between 08:01:54 and 08:01:57 UTC is not known, since its state 115 differs \
               from the one that was received: 0.2 of 2.0 min have passed";
    assert_eq!(shut.reasons[0].why, why);
    assert_eq!(site.judged(Verdict::Safe, 130).verdict, Verdict::Safe, "an open dome stays open");

    let stored = site.history.store(&site.rules, &fixture::moment(130, 1.0));
    let stored = serde_json::from_str(&serde_json::to_string(&stored).unwrap()).unwrap();
    let mut restarted = Site { history: History::new(&rules(), at(132).sky), rules: rules() };
    restarted.history.restore(&restarted.rules, &stored, &fixture::moment(132, 1.0)).unwrap();
    restarted.history.go_without(&m(), None);
    for site in [&mut site, &mut restarted] {
        site.receive(133..=239, 0.0);
        assert_eq!(site.judged(Verdict::Unsafe, 239).time_to_safe_s, Some(1.0));
        site.receive(240..=240, 0.0);
        assert_eq!(site.judged(Verdict::Unsafe, 240).verdict, Verdict::Safe);
    }
}

#[test]
fn a_device_without_a_record_is_silent_like_any_other() {
    let mut site = Site::with_a_hole();
    site.history.go_without(&m(), None);
    assert_eq!(site.judged(Verdict::Unsafe, 120).verdict, Verdict::Safe, "3 s without a reading, of 8 s allowed");
}

#[test]
fn what_a_monitor_itself_vouches_for_is_not_waited_for() {
    let mut site = Site::with_a_hole();
    site.receive(121..=121, 119.0);
    assert_eq!(site.judged(Verdict::Unsafe, 121).verdict, Verdict::Unsafe);
    site.receive(122..=122, 120.0);
    assert_eq!(site.judged(Verdict::Unsafe, 122).verdict, Verdict::Safe);
}

#[test]
fn states_from_before_a_boot_of_this_host_are_no_fresh_ones_after_it() {
    // This host was started 10 s ago. The monitor, on another one, was read until 100 s ago, and again since 4 s.
    let after_boot = |second: u64| {
        let since_boot = Duration::from_secs(second);
        Now { sky: SkyTime::from_start(since_boot), machine: MachineTime::from_boot(since_boot) }
    };
    let (rules, boot_id) = (Rules { limits: Vec::new(), ..fixture::rules(10, 8, 60) }, BootId::fresh());
    let ages_s: Vec<u64> = (100..=200).rev().chain((0..=4).rev()).collect();
    let entry = |(seq, age_s): (u64, &u64)| StateEntry {
        seq,
        age_s: *age_s as f64,
        reading_ages_s: BTreeMap::new(),
        link: Link::Connected,
        fields: reading(true, 0.0),
    };
    let entries: Vec<_> = (0..).zip(&ages_s).map(entry).collect();
    let newest = Stamped::<DeviceState<Monitor>> {
        boot_id: boot_id.clone(),
        seq: entries.len() as u64 - 1,
        at_utc: utc(0.0),
        sent_s: None,
        held_s: None,
        body: state(Link::Connected, reading(true, 0.0)),
    };
    let mut history = History::new(&rules, after_boot(9).sky);
    let mut recall = Recall::default();
    assert!(recall.observe(&newest, after_boot(10)));
    history.miss(&rules, &m(), recall.hole().unwrap());
    history.observe_monitor(&rules, &m(), &newest.body, after_boot(10));
    let record = StateRecord { boot_id, speed: 1.0, entries, earlier: Vec::new() };
    let asked = Asked { at: after_boot(10).machine, answered: after_boot(10), speed: 1.0 };
    let states = recall.place(&record, asked).unwrap();
    history.recall_monitor(&rules, &m(), states);
    assert_eq!(judge(&rules, &history, after_boot(10)).time_to_safe_s, Some(6.0), "good since 6 s after the boot");
}
