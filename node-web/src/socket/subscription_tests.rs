use bus::Clock;

use super::*;
use crate::model::tests::received;

const DOME: &str = "paranal/callisto/device/dome/d/state";

fn network() -> Network {
    Network::new(Clock::machine_clock(), Address::new("paranal", "callisto").unwrap())
}

fn subscribed(topic: &str) -> Subscription {
    Subscription::new(Topic::read(topic).unwrap(), topic.to_owned(), None)
}

fn next_for(caller: &Principal, one: &mut Subscription, network: &Network, beat: bool) -> Vec<Value> {
    one.next(network, &Commands::default(), caller, beat).iter().map(|message| json!(message)).collect()
}

fn next(one: &mut Subscription, network: &Network, beat: bool) -> Vec<Value> {
    next_for(&Principal::open("local"), one, network, beat)
}

fn log_line(network: &Network, seq: u64, message: &str) {
    let line = json!({"level": "info", "target": "t", "message": message});
    network.accept(received("paranal/callisto/node/device/main/diary", "b", seq, 1, line));
}

#[test]
fn a_slow_program_gets_the_newest_value_of_each_key_once() {
    let network = network();
    let mut one = subscribed("tel/paranal/callisto");
    network.accept(received(DOME, "b", 0, 1, json!({"n": 0})));
    let [snap] = &next(&mut one, &network, true)[..] else { panic!("one message") };
    assert_eq!((&snap["op"], &snap["data"]["states"][DOME]["body"]["n"]), (&json!("snap"), &json!(0)));
    for n in 1..=1000 {
        network.accept(received(DOME, "b", n, 1 + n, json!({ "n": n })));
    }
    let [delta] = &next(&mut one, &network, false)[..] else { panic!("one message") };
    assert_eq!(delta["data"]["states"].as_object().unwrap().len(), 1);
    assert_eq!((&delta["op"], &delta["data"]["states"][DOME]["body"]["n"]), (&json!("delta"), &json!(1000)));
    assert!(delta["seq"].as_u64() > snap["seq"].as_u64());
    assert!(next(&mut one, &network, false).is_empty(), "nothing new, nothing sent");
}

#[test]
fn a_repeat_sends_only_its_age() {
    let network = network();
    let mut one = subscribed("tel/paranal/callisto");
    network.accept(received(DOME, "b", 0, 1, json!({"n": 0})));
    next(&mut one, &network, true);
    network.accept(received(DOME, "b", 1, 2, json!({"n": 0})));
    let [delta] = &next(&mut one, &network, false)[..] else { panic!("one message") };
    assert!(delta["data"].get("states").is_none() && delta["data"]["again"][DOME][0].is_number(), "{delta}");
}

#[test]
fn a_telescope_comes_with_what_its_site_shares_and_a_longer_topic_with_the_keys_below_it() {
    let network = network();
    for telescope in ["callisto", "shared", "io"] {
        network.accept(received(&format!("paranal/{telescope}/device/dome/d/state"), "b", 0, 1, json!({})));
    }
    network.accept(received("paranal/callisto/device/dome/d2/state", "b", 0, 1, json!({})));
    let keys = |topic: &str| -> Vec<String> {
        let first = next(&mut subscribed(topic), &network, false).remove(0);
        first["data"]["states"].as_object().unwrap().keys().cloned().collect()
    };
    let second = "paranal/callisto/device/dome/d2/state";
    assert_eq!(keys("tel/paranal/callisto"), [DOME, second, "paranal/shared/device/dome/d/state"]);
    assert_eq!(keys("tel/paranal/callisto/device/dome/d"), [DOME]);
    assert_eq!(keys("tel/paranal/callisto/device"), [DOME, second]);
    let net = next(&mut subscribed("net"), &network, false).remove(0);
    assert_eq!(net["data"]["items"].as_object().unwrap().len(), 3, "summaries of all");
}

#[test]
fn nothing_is_seen_of_a_telescope_without_a_right() {
    let network = network();
    for telescope in ["callisto", "shared", "io"] {
        network.accept(received(&format!("paranal/{telescope}/device/dome/d/state"), "b", 0, 1, json!({})));
        let line = json!({"level": "info", "target": "t", "message": telescope});
        network.accept(received(&format!("paranal/{telescope}/node/device/main/diary"), "b", 0, 1, line));
    }
    let grants = vec!["viewer:paranal/io".parse().unwrap()];
    let ana = Principal { name: "ana".to_owned(), way: users::Way::Token, grants };
    let first = |topic: &str| next_for(&ana, &mut subscribed(topic), &network, false).remove(0)["data"].clone();
    assert_eq!(first("tel/paranal/callisto"), json!({"states": {}}));
    assert_eq!(first("tel/paranal/io")["states"].as_object().unwrap().len(), 2);
    let seen: Vec<_> = first("net")["items"].as_object().unwrap().keys().cloned().collect();
    assert_eq!(seen, ["paranal/io", "paranal/shared"]);
    let lines: Vec<_> = first("log").as_array().unwrap().iter().map(|line| line["telescope"].clone()).collect();
    assert_eq!(lines, ["paranal/shared", "paranal/io"]);
}

#[test]
fn ages_of_the_network_come_each_second_though_nothing_changed() {
    let network = network();
    let mut one = subscribed("net");
    assert_eq!(next(&mut one, &network, true)[0]["op"], "snap");
    assert!(next(&mut one, &network, false).is_empty());
    let [delta] = &next(&mut one, &network, true)[..] else { panic!("one message") };
    assert!(delta["data"]["ages"]["paranal/callisto"].is_object() && delta["data"].get("items").is_none(), "{delta}");
}

#[test]
fn lines_come_once_in_their_order_and_only_of_the_wanted_level() {
    let network = network();
    let (mut all, mut urgent) = (subscribed("log"), subscribed("log?level=warn"));
    log_line(&network, 0, "first");
    assert_eq!(next(&mut all, &network, false)[0]["data"][0]["message"], "first");
    assert_eq!(next(&mut urgent, &network, false)[0]["data"], json!([]));
    log_line(&network, 1, "<script>");
    let [event] = &next(&mut all, &network, false)[..] else { panic!("one message") };
    assert_eq!((&event["op"], &event["data"][0]["message"]), (&json!("event"), &json!("<script>")));
    assert_eq!(
        (&event["data"][0]["node"], &event["data"][0]["telescope"]),
        (&json!("device/main"), &json!("paranal/callisto"))
    );
    assert!(next(&mut all, &network, false).is_empty() && next(&mut urgent, &network, false).is_empty());
}

#[test]
fn who_comes_back_gets_what_was_missed_once_and_the_bounds_of_what_is_no_longer_there() {
    let network = network();
    let mut one = subscribed("log?telescope=paranal/callisto");
    log_line(&network, 0, "0");
    let seq = next(&mut one, &network, false)[0]["seq"].as_u64().unwrap();
    let resumed = |topic: &str| Subscription::new(Topic::read(topic).unwrap(), topic.to_owned(), Some(seq));
    for n in 1..=10 {
        log_line(&network, n, &n.to_string());
    }
    let [event] = &next(&mut resumed("log"), &network, false)[..] else { panic!("one message") };
    let words: Vec<_> = event["data"].as_array().unwrap().iter().map(|line| line["message"].clone()).collect();
    assert_eq!((&event["op"], words), (&json!("event"), (1..=10).map(|n| json!(n.to_string())).collect::<Vec<_>>()));
    for n in 11..=600 {
        log_line(&network, n, &n.to_string());
    }
    let [gap, event] = &next(&mut resumed("log"), &network, false)[..] else { panic!("two messages") };
    assert_eq!((&gap["op"], &gap["data"]["from"]), (&json!("gap"), &json!(seq)));
    let lines = event["data"].as_array().unwrap();
    assert_eq!((lines.len(), &lines[0]["message"]), (500, &json!("101")));
    assert!(gap["data"]["to"].as_u64() < lines[0]["number"].as_u64(), "{gap}");
    // What comes and goes has no numbers: it begins anew.
    assert_eq!(next(&mut resumed("net"), &network, false)[0]["op"], "snap");
}

#[test]
fn each_frame_is_an_event_of_its_own() {
    let network = network();
    let mut one = subscribed("frames/paranal/callisto");
    let frame = |seq: u64| received("paranal/callisto/device/camera/c/frame", "b", seq, 1, json!({ "id": seq }));
    network.accept(frame(0));
    assert_eq!(next(&mut one, &network, false)[0]["data"][0]["body"]["id"], 0);
    for seq in 1..=3 {
        network.accept(frame(seq));
    }
    let [event] = &next(&mut one, &network, false)[..] else { panic!("one message") };
    let ids: Vec<_> = event["data"].as_array().unwrap().iter().map(|frame| frame["body"]["id"].clone()).collect();
    assert_eq!(ids, [1, 2, 3]);
}

#[test]
fn alerts_come_and_go() {
    let network = network();
    let mut one = subscribed("alerts");
    let key = "paranal/callisto/node/device/main/alerts";
    assert_eq!(next(&mut one, &network, false)[0]["data"], json!({"items": {}}));
    let alert = contract::observatory::AlertKind::Journal.alert("", units::Utc::EPOCH, "the disk is full");
    network.accept(received(key, "b", 0, 1, json!({ "alerts": [alert] })));
    let raised = next(&mut one, &network, false).remove(0)["data"]["items"].clone();
    let (name, alert) = raised.as_object().unwrap().iter().next().unwrap();
    let cause = "the disk is full; last known, from the device node main, silent since 2027-01-15 08:00:01 UTC";
    assert_eq!((&alert["cause"], &alert["telescope"]), (&json!(cause), &json!("paranal/callisto")));
    network.accept(received(key, "b", 1, 2, json!({ "alerts": [] })));
    assert_eq!(next(&mut one, &network, false).remove(0)["data"]["gone"], json!([name]));
}
