use bus::Clock;
use serde_json::json;

use super::*;
use crate::network::Network;

/// A file of which nothing but the telescope's name is known.
impl From<Address> for OwnTelescope {
    fn from(address: Address) -> Self {
        Self { address, place: None }
    }
}

pub fn received(key: &str, boot: &str, seq: u64, at_s: u64, body: Value) -> Received<Value> {
    Received {
        key: Key::from_path(key).unwrap(),
        sample: Stamped {
            boot_id: serde_json::from_value(json!(boot)).unwrap(),
            seq,
            at_utc: Utc::from_seconds(1.8e9 + at_s as f64),
            sent_s: None,
            held_s: None,
            body,
        },
        arrived: MachineTime::from_boot(Duration::from_secs(at_s)),
    }
}

fn network() -> Network {
    Network::new(Clock::machine_clock(), Address::new("paranal", "callisto").unwrap())
}

const NIGHT: &str = "paranal/callisto/observatory/night/state";

fn entry(network: &Network) -> Entry {
    network.read().telescopes[&Address::new("paranal", "callisto").unwrap()].states[NIGHT].clone()
}

#[test]
fn a_repeat_refreshes_the_arrival_but_is_no_change() {
    let network = network();
    assert!(network.accept(received(NIGHT, "b1", 0, 10, json!({"frames": 1}))));
    assert!(network.accept(received(NIGHT, "b1", 1, 11, json!({"frames": 1}))));
    let repeated = entry(&network);
    assert_eq!((repeated.revision, repeated.changed), (2, 1));
    assert_eq!(repeated.age(MachineTime::from_boot(Duration::from_secs(12))), Duration::from_secs(1));
    assert!(network.accept(received(NIGHT, "b1", 2, 12, json!({"frames": 2}))));
    assert_eq!(entry(&network).changed, 3);
}

#[test]
fn an_answer_that_crossed_a_newer_sample_is_dropped() {
    let network = network();
    assert!(network.accept(received(NIGHT, "b1", 5, 10, json!({"frames": 5}))));
    assert!(!network.accept(received(NIGHT, "b1", 4, 10, json!({"frames": 4}))));
    assert_eq!(*entry(&network).body, json!({"frames": 5}));
}

#[test]
fn a_restarted_node_counts_at_once_whatever_its_clock_is_and_the_one_before_only_if_it_is_silent() {
    for (before, after) in [("b1", "b2"), ("b2", "b1")] {
        let network = network();
        for (boot, seq, at_s, is_newer, why) in [
            (before, 700, 10, true, "the first one"),
            (after, 0, 10, true, "restarted"),
            (before, 701, 11, false, "it crossed on its way"),
            (before, 702, 12, true, "the other has left"),
        ] {
            assert_eq!(network.accept(received(NIGHT, boot, seq, at_s, json!({"frames": seq}))), is_newer, "{why}");
        }
        assert_eq!(*entry(&network).body, json!({"frames": 702}));
    }
}

#[test]
fn the_facts_of_each_frame_have_a_counter_of_their_own() {
    let network = network();
    let facts = |id: &str| format!("paranal/callisto/observatory/frame/{id}/facts");
    for (id, seq, is_new) in [("a", 0, true), ("a", 0, false), ("a", 1, true), ("b", 0, true), ("b", 0, false)] {
        assert_eq!(network.accept(received(&facts(id), "b1", seq, 10, json!({}))), is_new, "{id} {seq}");
    }
}

#[test]
fn telescopes_of_all_sites_are_found_and_never_mixed() {
    let network = network();
    for (i, address) in ["paranal/io", "teide/artemis"].iter().enumerate() {
        network.accept(received(&format!("{address}/observatory/night/state"), "b", 0, 1, json!({ "frames": i })));
    }
    let model = network.read();
    let found: Vec<String> = model.telescopes.keys().map(ToString::to_string).collect();
    assert_eq!(found, ["paranal/callisto", "paranal/io", "teide/artemis"]);
    assert!(model.telescopes.values().all(|telescope| telescope.states.len() <= 1));
}

#[test]
fn a_million_keys_of_a_stranger_leave_room_for_the_telescope_of_the_file() {
    let network = network();
    for i in 0..1_000_000 {
        let (site, name) = (i % 1000, i / 1000);
        let body = json!({"text": "x".repeat(200)});
        network.accept(received(&format!("s{site}/t/device/switch/n{name}/state"), "b", 0, 1, body));
    }
    let model = network.read();
    assert!(model.telescopes.len() <= MOST_TELESCOPES && model.weight <= MOST_WEIGHT_OF_ALL, "{}", model.weight);
    let weighed: usize = model.telescopes.values().flat_map(|t| t.states.values()).map(|entry| entry.weight).sum();
    assert_eq!(weighed, model.weight);
    drop(model);
    assert!(network.accept(received(NIGHT, "b", 0, 2, json!({"frames": 1}))));
    let late = "teide/artemis/observatory/night/state";
    assert!(!network.accept(received(late, "b", 0, 30, json!({}))), "all others were received a moment ago");
    assert!(network.accept(received(late, "b", 0, 90, json!({}))), "what has fallen silent gives way");
}

const HOUR_S: u64 = 3600;

/// The keys that are left of a network, so many hours after these nodes of `paranal/io` published their last state: each with
/// the hour in which it did, and how it was stopped.
fn left_of(nodes: &[(&str, u64, Value)], hours: u64) -> Vec<String> {
    let mut model = Model::new(Address::new("paranal", "callisto").unwrap());
    for (node, hour, stopped) in nodes {
        let state = json!({ "role": "device", "version": "", "host": "pc", "pid": 1, "uptime_s": 1.0, "speed": 1.0,
            "stopped": stopped });
        for (topic, body) in [("state", state), ("alerts", json!({ "alerts": [] }))] {
            assert!(model.accept(received(&format!("paranal/io/node/{node}/{topic}"), "b", 0, hour * HOUR_S, body)));
        }
    }
    assert!(model.accept(received("paranal/io/observatory/night/state", "b", 0, 0, json!({}))));
    model.forget(MachineTime::from_boot(Duration::from_secs(hours * HOUR_S)));
    assert!(model.telescopes.contains_key(&Address::new("paranal", "callisto").unwrap()), "it is expected");
    let weighed: usize = model.telescopes.values().flat_map(|t| t.states.values()).map(|entry| entry.weight).sum();
    assert_eq!(weighed, model.weight);
    model.telescopes.values().flat_map(|telescope| telescope.states.keys().cloned()).collect()
}

#[test]
fn what_ended_in_good_order_is_forgotten_after_a_day_and_what_fell_silent_after_two_weeks() {
    let well = || json!({ "by": "starmesh up on pc", "closed": true });
    let open = || json!({ "by": "starmesh up on pc", "closed": false });
    for (nodes, hours, left, why) in [
        (vec![("observatory/main", 0, well()), ("device/main", 0, well())], 23, 5, "not yet a day"),
        (vec![("observatory/main", 0, well()), ("device/main", 0, well())], 25, 0, "all of it ended"),
        (vec![("observatory/main", 0, Value::Null), ("device/main", 0, well())], 25, 5, "one fell silent"),
        (vec![("observatory/main", 0, open())], 25, 3, "it was left open"),
        (vec![("observatory/main", 0, Value::Null)], 13 * 24, 3, "it fell silent"),
        (vec![("observatory/main", 0, Value::Null)], 15 * 24, 0, "two weeks ago"),
        (vec![], 25, 1, "nobody said that it would be silent"),
        (vec![("device/a", 0, well()), ("device/b", 24, Value::Null)], 25, 3, "one of two nodes was taken away"),
        (vec![("device/a", 0, Value::Null), ("device/b", 24, Value::Null)], 25, 5, "one of two nodes fell silent"),
        (vec![("device/a", 0, Value::Null), ("device/b", 360, Value::Null)], 361, 3, "two weeks ago"),
        (vec![("observatory/main", 0, well()), ("device/b", 24, Value::Null)], 25, 5, "its last word is still true"),
    ] {
        let found = left_of(&nodes, hours);
        assert_eq!(found.len(), left, "{why}: {found:?}");
    }
}

#[test]
fn the_expected_telescope_stays_with_its_alerts() {
    let mut model = Model::new(Address::new("paranal", "callisto").unwrap());
    assert!(model.accept(received(NIGHT, "b", 0, 0, json!({}))));
    model.forget(MachineTime::from_boot(Duration::from_secs(30 * 24 * HOUR_S)));
    assert_eq!(model.telescopes.values().map(|telescope| telescope.states.len()).sum::<usize>(), 1);
}

#[test]
fn a_place_is_that_of_the_mount_as_it_is_now() {
    let callisto = Address::new("paranal", "callisto").unwrap();
    let mut model = Model::new(callisto.clone());
    let place = |model: &Model| model.place(&callisto).map(|(place, _)| place.latitude().degrees().round());
    let mount = |seq, at_s, latitude_deg: Value| {
        let body = json!({ "can": { "site_latitude_deg": latitude_deg, "site_longitude_deg": -70.5 } });
        received("paranal/callisto/device/telescope/mount/capabilities", "b", seq, at_s, body)
    };
    for (seq, latitude_deg, found) in [
        (0, json!(-24.0), Some(-24.0)),
        (1, json!(-24.0), Some(-24.0)),
        (2, json!(-25.0), Some(-25.0)),
        (3, Value::Null, None),
        (4, json!(-26.0), Some(-26.0)),
    ] {
        assert!(model.accept(mount(seq, seq, latitude_deg)));
        assert_eq!(place(&model), found, "{seq}");
    }
    assert!(model.accept(received(NIGHT, "b", 0, 5, json!({}))));
    let telescope = model.telescopes.get_mut(&callisto).unwrap();
    assert!(telescope.give_way(MachineTime::from_boot(Duration::from_secs(1000))));
    assert_eq!(place(&model), None, "its mount gave way");
}

#[test]
fn what_cannot_be_read_is_reported_until_it_can_be_read_again() {
    let network = network();
    network.accept(received(NIGHT, "b1", 0, 10, json!({"frames": 1})));
    let key = Key::from_path(NIGHT).unwrap();
    let at = |s| MachineTime::from_boot(Duration::from_secs(s));
    network.refuse(&key, "frames is a text".to_owned(), at(11));
    let unreadable = |s| {
        let model = network.read();
        model.telescopes[&Address::new("paranal", "callisto").unwrap()].unreadable(at(s)).len()
    };
    assert_eq!([unreadable(12), unreadable(72)], [1, 0]);
    assert_eq!(*entry(&network).body, json!({"frames": 1}), "the last good one stays, and grows old");
    network.accept(received(NIGHT, "b1", 1, 13, json!({"frames": 2})));
    assert_eq!(unreadable(14), 0);
}

#[test]
fn the_memory_for_one_telescope_is_bounded() {
    let network = network();
    for i in 0..MOST_KEYS + 50 {
        network.accept(received(&format!("paranal/callisto/device/switch/s{i}/state"), "b", 0, 1, json!({})));
    }
    let model = network.read();
    assert_eq!(model.telescopes[&Address::new("paranal", "callisto").unwrap()].states.len(), MOST_KEYS);
}
