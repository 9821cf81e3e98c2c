//! Scenarios of a watch.

use super::*;

const VALID: Duration = Duration::from_secs(10);

fn at(ms: u64) -> MachineTime {
    MachineTime::from_boot(Duration::from_millis(1_000_000 + ms))
}

fn ns(ms: u64) -> u64 {
    (1_000_000 + ms) * 1_000_000
}

fn report(ms: u64, may_be_open_ms: u64, sees: bool) -> Report {
    let dome_report = DomeReport { at_ns: ns(ms), may_be_open_ms, sees, is_closed: false, waits_for_mounts: false };
    Report { domes: [("d".to_owned(), dome_report)].into(), tokens: BTreeMap::new() }
}

fn watch(now: MachineTime, before: &Before) -> Watch {
    Watch::new(now, &[("d".to_owned(), VALID)], before, true)
}

fn deadline(ms: u64) -> Before {
    Before::Deadlines([("d".to_owned(), at(ms))].into())
}

#[test]
fn a_node_that_dies_leaves_its_last_permit_and_no_more() {
    let mut watch = watch(at(0), &Before::Nothing);
    assert_eq!(watch.tick(at(0)), Some(Effect::Start));
    watch.started(at(0), vec![]);
    watch.observe(at(2_000), &report(2_000, 9_000, true));
    assert_eq!(watch.who("d", at(2_100)), Who::Node);
    watch.ended(at(3_000));
    assert_eq!(watch.who("d", at(10_900)), Who::Permit);
    assert_eq!(watch.who("d", at(11_000)), Who::This);
}

#[test]
fn a_crash_loop_with_runs_of_any_length_gains_no_time() {
    for uptime_ms in [100, 1_000, 3_000, 8_000, 9_900] {
        let (mut now_ms, mut before) = (0, Before::Nothing);
        let mut closes_at = None;
        // Both processes die each time, and only what was written is left.
        while closes_at.is_none() && now_ms < 60_000 {
            let mut watch = watch(at(now_ms), &before);
            let end_ms = now_ms + uptime_ms;
            watch.started(at(now_ms), vec![]);
            while now_ms < end_ms && closes_at.is_none() {
                if watch.who("d", at(now_ms)) == Who::This {
                    closes_at = Some(now_ms);
                }
                // A node in its time of grace gets the deadline, and grants no more.
                let left = watch.deadlines()["d"].since(at(now_ms));
                if now_ms + 2_000 > end_ms {
                    watch.observe(at(now_ms), &report(now_ms, left.as_millis() as u64, false));
                }
                watch.tick(at(now_ms));
                now_ms += 250;
            }
            before = Before::Deadlines(watch.deadlines().clone());
            now_ms += 2_000;
        }
        let closes_at = closes_at.unwrap_or_else(|| panic!("restarts each {uptime_ms} ms: never closed"));
        assert!(closes_at <= 14_000, "restarts each {uptime_ms} ms: {closes_at}");
    }
}

#[test]
fn what_stands_on_disk_never_grants_more_than_one_permit() {
    assert_eq!(watch(at(0), &deadline(900_000)).who("d", at(10_000)), Who::This);
    assert_eq!(watch(at(0), &deadline(4_000)).who("d", at(3_999)), Who::Permit);
    assert_eq!(watch(at(0), &deadline(4_000)).who("d", at(4_000)), Who::This);
    assert_eq!(watch(at(0), &Before::OtherBoot).who("d", at(0)), Who::This, "no permit outlives a machine");
}

#[test]
fn a_node_that_hangs_is_not_trusted_after_three_seconds_and_killed_after_fifteen() {
    let mut watch = watch(at(0), &Before::Nothing);
    watch.started(at(0), vec![]);
    watch.observe(at(0), &report(0, 1_000, true));
    let mut killed = None;
    for tick in 1..=80_u64 {
        let now = at(tick * 250);
        let effect = watch.tick(now);
        let expected = if tick < u64::from(SILENT) { Who::Node } else { Who::This };
        assert_eq!(watch.who("d", now), expected, "tick {tick}");
        if effect.is_some() && killed.is_none() {
            killed = Some(tick);
        }
    }
    assert_eq!(killed, Some(60));
}

#[test]
fn a_guard_process_that_was_stopped_itself_takes_the_unread_reports_for_what_they_are() {
    let mut watch = watch(at(0), &Before::Nothing);
    watch.started(at(0), vec![]);
    watch.observe(at(0), &report(0, 9_000, true));
    watch.tick(at(250));
    // 20 s of nothing, then one tick before the reports are read.
    watch.tick(at(20_250));
    assert_eq!(watch.who("d", at(20_250)), Who::Node);
}

#[test]
fn a_node_that_never_sees_the_shutter_at_a_new_address_does_not_guard() {
    let mut watch = watch(at(0), &Before::Nothing);
    watch.started(at(0), vec![]);
    watch.observe(at(1_000), &report(1_000, 0, false));
    assert!(!watch.works(["d"].into_iter()));
    assert_eq!(watch.who("d", at(1_000)), Who::This, "by the last-good copy");
    watch.observe(at(2_000), &report(2_000, 0, true));
    assert!(watch.works(["d"].into_iter()));
    assert_eq!(watch.who("d", at(2_000)), Who::Node);
}

#[test]
fn a_server_that_is_away_is_left_to_the_node_that_asks_the_same_one() {
    let mut watch = watch(at(0), &Before::OtherBoot);
    watch.started(at(0), vec!["d".to_owned()]);
    watch.observe(at(1_000), &report(1_000, 0, false));
    assert_eq!(watch.who("d", at(1_000)), Who::Node);
}

#[test]
fn a_node_that_waits_for_a_mount_without_receiving_its_state_is_helped_until_it_waits_no_more() {
    let mut watch = watch(at(0), &Before::Nothing);
    watch.started(at(0), vec![]);
    let mut waits = report(1_000, 0, true);
    waits.domes.get_mut("d").unwrap().waits_for_mounts = true;
    watch.observe(at(1_000), &waits);
    assert_eq!(watch.who("d", at(1_000)), Who::Both);
    watch.observe(at(2_000), &report(2_000, 9_000, true));
    assert_eq!(watch.who("d", at(2_000)), Who::Node);
}

#[test]
fn an_end_closes_whatever_lasts_and_starts_nothing() {
    let mut watch = watch(at(0), &Before::Nothing);
    watch.end();
    assert_eq!(watch.tick(at(0)), None);
    assert_eq!(watch.who("d", at(0)), Who::This);
}

#[test]
fn a_node_that_was_asked_to_end_and_ended_well_leaves_its_dome_closed() {
    let mut watch = watch(at(0), &Before::Nothing);
    watch.started(at(0), vec![]);
    watch.observe(at(1_000), &report(1_000, 9_000, true));
    watch.end();
    watch.ended_closed(at(2_000));
    assert!(watch.node_reports_closed("d"), "the guard process need not prove it again");
    watch.ended(at(3_000));
    assert!(!watch.node_reports_closed("d"), "any other end proves nothing");
}

#[test]
fn starts_come_after_5_s_at_most_and_the_first_one_at_once() {
    let mut watch = watch(at(0), &Before::Nothing);
    let mut now_ms = 0;
    let mut pauses = Vec::new();
    for _ in 0..8 {
        watch.started(at(now_ms), vec![]);
        watch.ended(at(now_ms));
        let began = now_ms;
        while watch.tick(at(now_ms)).is_none() {
            now_ms += 50;
        }
        pauses.push(now_ms - began);
    }
    assert_eq!(pauses, [200, 1_000, 2_000, 4_000, 5_000, 5_000, 5_000, 5_000]);
}
