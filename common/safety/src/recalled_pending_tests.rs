//! What counts while a device node is asked, and how much its answer is believed.

use super::*;

fn hole() -> Hole {
    Hole { from_utc: None, until_utc: Utc::EPOCH }
}

#[test]
fn what_is_written_while_a_device_node_is_asked_loses_nothing_of_what_was_missed() {
    let mut site = Site::new(&[(Cut, 300, 4)]);
    for now in 0..304 {
        site.live(now, if now == 302 { 13.0 } else { 3.0 });
    }
    // Received, written, and killed before the answers came.
    site.publish(304, 3.0);
    let node = site.node.as_mut().unwrap();
    node.history.miss(&site.rules, &m(), hole());
    node.history.observe_monitor(&site.rules, &m(), &site.monitor.newest().body, at(304));
    node.history.miss(&site.rules, &wx(), hole());
    node.history.observe_weather(&site.rules, &wx(), &site.station.newest().body, 1.0, at(304));
    site.file = Some(node.history.store(&site.rules, &moment(304)));
    site.node = None;
    for now in 305..310 {
        site.live(now, 3.0);
    }
    let reasons = site.judged(309).reasons;
    let left_s: Vec<_> = reasons.iter().map(|reason| (reason.input.as_str(), reason.clears_in_s)).collect();
    assert!(left_s.contains(&("safetymonitor/m", Some(114.0))), "good since 303: {left_s:?}");
    assert!(left_s.contains(&("wx/WindSpeed Value true", Some(114.0))), "good since 303: {left_s:?}");
}

#[test]
fn nothing_recalled_vouches_for_more_than_what_was_received() {
    let rules = Rules { limits: Vec::new(), ..rules() };
    let mut history = History::new(&rules, at(0).sky);
    let safe = |gapless_safe_s| Monitor { is_safe: Datum::Known(true), gapless_safe_s };
    // As one that took the place of another is believed: from now on.
    history.observe_monitor(&rules, &m(), &state(Link::Connected, safe(0.0)), at(300));
    let placed =
        |second| PlacedState { at: at(second), link: Link::Connected, fields: safe(3600.0), ages_s: BTreeMap::new() };
    history.recall_monitor(&rules, &m(), vec![placed(299), placed(300)]);
    let reasons = judge(&rules, &history, at(301)).reasons;
    assert_eq!(reasons.first().and_then(|reason| reason.clears_in_s), Some(118.0), "{reasons:?}");
}

#[test]
fn what_was_missed_vouches_for_nothing_also_where_the_newest_state_is_silent() {
    let rules = Rules { limits: Vec::new(), ..rules() };
    let mut history = History::new(&rules, at(0).sky);
    let safe = |gapless_safe_s| Monitor { is_safe: Datum::Known(true), gapless_safe_s };
    history.recall_monitor(&rules, &m(), Vec::new());
    // Alone since a dispute: it is believed from now on.
    history.observe_monitor(&rules, &m(), &state(Link::Connected, safe(0.0)), at(300));
    history.miss(&rules, &m(), hole());
    let connecting = state(Link::Connecting, Monitor::default());
    history.observe_monitor(&rules, &m(), &connecting, at(302));
    let missed = PlacedState { at: at(301), link: Link::Connected, fields: safe(3600.0), ages_s: BTreeMap::new() };
    let newest =
        PlacedState { at: at(302), link: Link::Connecting, fields: Monitor::default(), ages_s: BTreeMap::new() };
    history.recall_monitor(&rules, &m(), vec![missed, newest]);
    let reasons = judge(&rules, &history, at(303)).reasons;
    assert_eq!(reasons.first().and_then(|reason| reason.clears_in_s), Some(117.0), "{reasons:?}");
}
