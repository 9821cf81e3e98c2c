//! Scenarios of an observatory node that is restarted together with the device nodes, which then know nothing of the
//! time before.

use std::collections::BTreeMap;

use contract::device::observing_conditions::Fields;
use contract::device::safety_monitor::Fields as Monitor;
use contract::observatory::Verdict;
use contract::{Datum, Link};
use proptest::prelude::*;

use super::*;
use crate::fixture::{self, m, wx};
use crate::judge::{Judgement, judge};
use crate::reading::state;
use crate::recall::PlacedState;

/// Sky seconds in a machine second.
const SPEED: f64 = 2.0;

fn at(second: u64) -> Now {
    fixture::at(second, SPEED)
}

fn moment(second: u64) -> Moment {
    fixture::moment(second, SPEED)
}

/// Each with 100 s of the machine of dwell; 5 s are allowed of the monitor.
fn rules() -> Rules {
    fixture::rules(200, 5, 120)
}

/// The air at this second, unless the station hangs.
fn air(second: u64, wind_mps: f64) -> Fields {
    fixture::air(second, Datum::Known(wind_mps))
}

struct Site {
    rules: Rules,
    history: History,
}

impl Site {
    fn new(second: u64) -> Self {
        Self { history: History::new(&rules(), at(second).sky), rules: rules() }
    }

    fn observe(&mut self, second: u64, wind_mps: f64) {
        let is_safe = Datum::Known(wind_mps <= 12.0);
        let monitor = state(Link::Connected, Monitor { is_safe, gapless_safe_s: 0.0 });
        self.history.observe_monitor(&self.rules, &m(), &monitor, at(second));
        self.observe_air(second, air(second, wind_mps));
    }

    fn observe_air(&mut self, second: u64, fields: Fields) {
        self.history.observe_weather(&self.rules, &wx(), &state(Link::Connected, fields), SPEED, at(second));
    }

    fn judged(&self, second: u64) -> Judgement {
        judge(&self.rules, &self.history, at(second))
    }

    /// What its node has in its file at this second, through the file.
    fn file(&self, second: u64) -> StoredHistory {
        let text = serde_json::to_vec(&self.history.store(&self.rules, &moment(second))).unwrap();
        serde_json::from_slice(&text).unwrap()
    }

    /// Its node is killed, and another one begins with the file.
    fn restarted(&self, killed: u64, begins: u64) -> Self {
        let mut site = Self::new(begins);
        site.history.restore(&site.rules, &self.file(killed), &moment(begins)).unwrap();
        site
    }

    fn reasons(&self, second: u64) -> Vec<(String, String)> {
        self.judged(second).reasons.into_iter().map(|reason| (reason.input, reason.why)).collect()
    }
}

/// A calm site from 0 s to this second.
fn calm_until(second: u64) -> Site {
    let mut site = Site::new(0);
    (0..=second).for_each(|second| site.observe(second, 3.0));
    site
}

/// The next states come from a device node that was restarted, too, and answers with no more than these.
fn recall(site: &mut Site, seconds: std::ops::RangeInclusive<u64>, fields: impl Fn(u64) -> Fields) {
    let placed =
        |second| PlacedState { at: at(second), link: Link::Connected, fields: fields(second), ages_s: BTreeMap::new() };
    let _ = site.history.recall_weather(&site.rules, &wx(), seconds.map(placed).collect(), SPEED);
}

#[test]
fn when_all_nodes_are_restarted_within_the_allowed_age_no_dwell_starts_anew() {
    let mut site = calm_until(300).restarted(300, 303);
    assert!(!site.history.all_received(), "nothing was received yet, so that nobody acts on the verdict");
    site.observe(304, 3.0);
    recall(&mut site, 304..=304, |second| air(second, 3.0));
    let judged = site.judged(304);
    assert_eq!((judged.verdict, &judged.reasons), (Verdict::Safe, &Vec::new()));
    assert!(!site.history.all_received(), "the monitor's node was not asked yet");
    site.history.recall_monitor(&site.rules, &m(), Vec::new());
    assert_eq!(site.judged(304).reasons, [], "a node without a record takes nothing away");
    assert!(site.history.all_received());
    // And once more.
    let mut site = site.restarted(304, 307);
    site.observe(308, 3.0);
    assert_eq!(site.judged(308).reasons, []);
}

#[test]
fn after_a_bad_value_only_the_rest_of_the_dwell_runs() {
    let mut site = calm_until(300);
    site.observe(301, 13.0);
    (302..=340).for_each(|second| site.observe(second, 3.0));
    let mut restarted = site.restarted(340, 343);
    for site in [&mut site, &mut restarted] {
        site.observe(344, 3.0);
    }
    let reasons = restarted.reasons(344);
    assert_eq!(reasons, site.reasons(344));
    assert!(reasons.contains(&("safetymonitor/m".to_owned(), "good for 1.4 of 3.3 min".to_owned())), "{reasons:?}");
    (345..=465).for_each(|second| restarted.observe(second, 3.0));
    assert_eq!(restarted.reasons(465), [], "the largest wind of a minute, and the dwell after that");
}

#[test]
fn a_value_that_is_bad_now_is_bad_after_the_restart() {
    let mut site = calm_until(300);
    // Between the limits: it may not be opened with this wind.
    site.observe(301, 13.0);
    site.observe(302, 11.0);
    let mut site = site.restarted(302, 304);
    assert_eq!(site.judged(304).verdict, Verdict::Unsafe);
    site.observe(305, 11.0);
    let judged = site.judged(305);
    assert!(judged.reasons.iter().any(|reason| reason.why == "11 is not down to 10 yet"), "{judged:?}");
}

#[test]
fn a_gap_longer_than_allowed_starts_the_dwell_of_that_input_anew() {
    // The file is young enough, the first live states are not.
    let mut site = calm_until(300).restarted(300, 304);
    (306..=310).for_each(|second| site.observe(second, 3.0));
    let reasons = site.judged(310).reasons;
    assert_eq!(reasons.len(), 1, "{reasons:?}");
    assert_eq!((reasons[0].input.as_str(), reasons[0].clears_in_s), ("safetymonitor/m", Some(192.0)));
    // The file itself is too old for one, and for all.
    let passed_over = |begins| Site::new(begins).history.restore(&rules(), &calm_until(300).file(300), &moment(begins));
    let monitor = ("safetymonitor/m".to_owned(), "it was written 6.0 s ago, allowed are 5.0 s".to_owned());
    assert_eq!(passed_over(306), Ok(vec![monitor]));
    assert_eq!(passed_over(316).unwrap().len(), 5);
}

#[test]
fn readings_that_were_old_when_the_file_was_written_stay_as_old() {
    // A node that writes each second and has received nothing for 4 s.
    let mut site = calm_until(300).restarted(304, 305);
    assert_eq!(site.judged(305).verdict, Verdict::Safe, "the newest reading is 5 s old");
    let judged = site.judged(306);
    assert_eq!(judged.reasons[0].why, "stale: last received 6.0 s ago, allowed are 5.0 s");
    site.observe(307, 3.0);
    assert_eq!(site.judged(307).reasons.len(), 1, "the monitor's dwell runs");
}

#[test]
fn what_does_not_fit_is_passed_over_with_a_reason() {
    let file = calm_until(300).file(300);
    let refused = |moment: Moment| Site::new(302).history.restore(&rules(), &file, &moment).unwrap_err();
    let now = || moment(302);
    let other_boot = Moment { boot: "b".to_owned(), ..now() };
    assert_eq!(refused(other_boot), "it was written before this machine was started");
    assert!(refused(Moment { boot: String::new(), ..now() }).contains("before this machine"));
    assert_eq!(refused(moment(299)), "it is from the future");
    assert_eq!(refused(Moment { speed: 1.0, ..now() }), "its sky time ran at 2 x, here it runs at 1 x");
    for step_s in [3600.0, -3600.0] {
        let jumped = Moment { utc: now().utc.plus_seconds(step_s), ..now() };
        assert_eq!(refused(jumped), format!("the clock has jumped by {step_s:+.0} s since it was written"));
    }
}

#[test]
fn limits_that_were_changed_meanwhile_begin_anew() {
    let mut rules = rules();
    rules.limits[0].bad.upper = Some(14.0);
    let mut history = History::new(&rules, at(302).sky);
    let passed_over = history.restore(&rules, &calm_until(300).file(300), &moment(302)).unwrap();
    let (input, why) = &passed_over[0];
    assert_eq!(passed_over.len(), 1);
    assert_eq!(
        (input.as_str(), why.as_str()),
        ("wx/WindSpeed Value true", "nothing was written of this input with these limits")
    );
}

#[test]
fn what_the_device_node_knows_of_the_time_between_counts() {
    // The observatory alone was restarted; its station's node goes on, and has seen a gust.
    let restarted = |begins| calm_until(300).restarted(300, begins);
    let inputs = |site: &Site, second| site.reasons(second).into_iter().map(|(input, _)| input).collect::<Vec<_>>();
    let mut site = restarted(305);
    site.observe(306, 3.0);
    recall(&mut site, 250..=306, |second| air(second, if second == 303 { 13.0 } else { 3.0 }));
    assert_eq!(inputs(&site, 306).len(), 6, "{:?}", site.reasons(306));
    // Without one, both records together reach as far back as this node's own.
    let mut site = restarted(305);
    site.observe(306, 3.0);
    recall(&mut site, 250..=306, |second| air(second, 3.0));
    assert_eq!(inputs(&site, 306), ["safetymonitor/m"], "its gap is longer than 5 s");
    // Where they do not meet, the station's is taken alone, as far as it reaches.
    let mut site = restarted(312);
    site.observe(320, 3.0);
    recall(&mut site, 316..=320, |second| air(second, 3.0));
    assert_eq!(inputs(&site, 320).len(), 6, "{:?}", site.reasons(320));
}

#[test]
fn a_station_that_stands_still_does_so_over_a_restart() {
    let mut site = calm_until(100);
    let hangs = |site: &mut Site, seconds: std::ops::Range<u64>| {
        seconds.for_each(|second| site.observe_air(second, air(0, 3.0)));
    };
    hangs(&mut site, 101..500);
    let mut site = site.restarted(499, 502);
    hangs(&mut site, 503..504);
    recall(&mut site, 503..=503, |_| air(0, 3.0));
    hangs(&mut site, 504..702);
    let frozen = |site: &Site, second| site.judged(second).reasons.iter().any(|reason| reason.input == "wx/frozen");
    assert!(!frozen(&site, 690) && frozen(&site, 702));
}

/// Winds each second, and when the node is killed and begins again.
fn nights() -> impl Strategy<Value = (Vec<f64>, u64, u64)> {
    let wind = prop_oneof![60 => Just(3.0), 1 => Just(11.0), 1 => Just(13.0)];
    (proptest::collection::vec(wind, 300..400), 60_u64..290, 1_u64..4)
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(24), ..ProptestConfig::with_cases(100) })]

    #[test]
    fn a_restart_within_the_allowed_age_is_judged_as_if_nothing_had_come_meanwhile((winds, killed, pause) in nights()) {
        let (mut whole, mut restarted) = (Site::new(0), Site::new(0));
        for (second, wind_mps) in (0..).zip(&winds) {
            if second == killed {
                restarted = restarted.restarted(killed - 1, killed + pause);
            }
            if !(killed..=killed + pause).contains(&second) {
                whole.observe(second, *wind_mps);
                restarted.observe(second, *wind_mps);
            }
            let (one, other) = (whole.judged(second + 1), restarted.judged(second + 1));
            prop_assert_eq!(one.verdict, other.verdict, "{} {:?} {:?}", second, one.reasons, other.reasons);
            prop_assert_eq!(whole.reasons(second + 1), restarted.reasons(second + 1));
        }
    }
}
