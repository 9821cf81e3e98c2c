//! Orders over HTTP: given once whatever is repeated, refused in the observatory node's own words, and followed to the end.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use contract::device::dome::Shutter;
use contract::observatory::{NightState, OperatorOrders};
use contract::{Accepted, Key, Kind, Order, OrderKind, Part, Reason, Refusal, Reply};
use serde_json::{Value, json};
use test_support::DomeNode;

use crate::stage::{Published, Stage, address, sample};

const COMMANDS: &str = "/api/v1/telescopes/paranal/callisto/commands";

type Orders = Arc<Mutex<Vec<Order>>>;

/// An observatory node that takes all orders, unless their reason is "refuse", and the orders that it got, each once however often it was asked.
async fn observatory(stage: &Stage) -> (bus::Service, Orders) {
    let orders = Orders::default();
    let got = orders.clone();
    let serve = move |order: Result<Order, String>| {
        let order = order.unwrap();
        let mut got = got.lock().unwrap();
        if got.iter().all(|one: &Order| one.id != order.id) {
            got.push(order.clone());
        }
        async move {
            match order.reason.as_str() {
                "refuse" => {
                    Reply::Refusal(Refusal { id: order.id, reason: Reason::NotNow, detail: "it is noon".to_owned() })
                }
                reason => {
                    let not_written = (reason == "full disk").then(|| "/data/orders.json: it is full".to_owned());
                    Reply::Accepted(Accepted { id: order.id, token: None, not_written })
                }
            }
        }
    };
    (stage.bus.serve(&Key::Order(address("callisto")), serve).await.unwrap(), orders)
}

async fn night(stage: &Stage) -> Published<NightState> {
    let state: NightState = serde_json::from_value(sample("observatory.night")).unwrap();
    let night = stage.publish(Key::Observatory(address("callisto"), Part::Night), state).await;
    stage.until("/api/v1/network", |network| network["telescopes"][0]["posture"] != "unknown").await;
    night
}

async fn post(stage: &Stage, key: Option<&str>, wait: Option<u32>, body: Value) -> (u16, Value, Option<String>) {
    let request = stage.http.post(format!("{}{COMMANDS}", stage.url)).header("Content-Type", "application/json");
    let mut request = request.body(body.to_string());
    if let Some(key) = key {
        request = request.header("Idempotency-Key", key);
    }
    if let Some(wait) = wait {
        request = request.header("Prefer", format!("wait={wait}"));
    }
    let response = request.send().await.unwrap();
    let location = response.headers().get("location").map(|location| location.to_str().unwrap().to_owned());
    let status = response.status().as_u16();
    (status, serde_json::from_slice(&response.bytes().await.unwrap()).unwrap(), location)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_repeat_is_the_same_command_and_acts_once() {
    let stage = Stage::start().await;
    let (_observatory, orders) = observatory(&stage).await;
    let _night = night(&stage).await;
    let body = json!({"command": "override", "parameters": {"input": "wx/Humidity", "minutes": 5}, "reason": "dry", "operator": "ana"});
    let (status, first, location) = post(&stage, Some("k1"), None, body.clone()).await;
    assert_eq!((status, &first["state"]), (202, &json!("done")), "{first}");
    for _ in 0..5 {
        let (status, again, _) = post(&stage, Some("k1"), None, body.clone()).await;
        assert_eq!((status, &again), (202, &first));
    }
    let at_once = (0..20).map(|_| post(&stage, Some("k2"), None, body.clone()));
    let ids: Vec<Value> =
        futures_util::future::join_all(at_once).await.into_iter().map(|(_, state, _)| state["id"].clone()).collect();
    assert!(ids.iter().all(|id| *id == ids[0] && *id != first["id"]), "{ids:?}");
    {
        let orders = orders.lock().unwrap();
        assert_eq!(orders.len(), 2, "{orders:?}");
        assert_eq!(orders[0].kind, OrderKind::Override { input: "wx/Humidity".to_owned(), for_s: 300.0 });
        assert!(orders[0].from.starts_with("web/ana@127.0.0.1") && orders[0].operator() == "ana", "{}", orders[0].from);
        assert_eq!((orders[0].reason.as_str(), json!(orders[0].id.0)), ("dry", first["id"].clone()));
    }
    let (status, other, _) = post(&stage, Some("k1"), None, json!({"command": "close"})).await;
    assert_eq!((status, &other["code"]), (422, &json!("validation")), "{other}");
    let (status, one) = stage.get(&location.unwrap()).await;
    assert_eq!((status.as_u16(), &one), (200, &first));
    let (_, all) = stage.get("/api/v1/commands?telescope=paranal/callisto").await;
    assert_eq!(all.as_array().unwrap().len(), 2, "{all}");
    assert_eq!(stage.get("/api/v1/commands/none").await.0.as_u16(), 404);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_close_is_done_when_it_is_verified_and_failed_when_it_is_not() {
    let stage = Stage::start().await;
    let (_observatory, _orders) = observatory(&stage).await;
    let night = night(&stage).await;
    let (status, state, location) = post(&stage, Some("a"), None, json!({"command": "close"})).await;
    assert_eq!((status, &state["state"]), (202, &json!("accepted")), "{state}");
    let mut closing = sample("observatory.night");
    closing["last_order"]["id"] = state["id"].clone();
    let mut closing: NightState = serde_json::from_value(closing).unwrap();
    closing.posture = contract::observatory::Posture::Closing;
    night.put(closing.clone());
    tokio::time::sleep(Duration::from_millis(300)).await;
    let location = location.unwrap();
    assert_eq!(stage.get(&location).await.1["state"], "accepted");
    closing.posture = contract::observatory::Posture::Closed;
    night.put(closing);
    let done = stage.until(&location, |state| state["state"] == "done").await;
    assert_eq!(done["events"].as_array().unwrap().len(), 3, "{done}");

    // This one is accepted by somebody who is not the observatory node, or does not close.
    let (status, late, _) = post(&stage, Some("b"), Some(60), json!({"command": "close", "deadline_s": 1})).await;
    assert_eq!((status, &late["state"]), (202, &json!("failed")), "{late}");
    assert!(late["detail"].as_str().unwrap().contains("NOT verified closed"), "{late}");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_that_holds_and_is_not_on_disk_has_failed_and_says_so() {
    let stage = Stage::start().await;
    let (_observatory, _orders) = observatory(&stage).await;
    let night = night(&stage).await;
    let body =
        |command: &str, parameters: Value| json!({"command": command, "parameters": parameters, "reason": "full disk"});
    let restore = body("restore", json!({"input": "wx/Humidity"}));
    let (status, restored, _) = post(&stage, Some("a"), None, restore).await;
    assert_eq!((status, &restored["state"]), (202, &json!("failed")), "{restored}");
    let told = "the order holds now and is NOT on disk (/data/orders.json: it is full)";
    assert!(restored["detail"].as_str().unwrap().starts_with(told), "{restored}");

    let (status, state, location) = post(&stage, Some("b"), None, body("stay-closed", json!({}))).await;
    assert_eq!((status, &state["state"]), (202, &json!("accepted")), "it closes at once: {state}");
    let mut closed = sample("observatory.night");
    closed["last_order"]["id"] = state["id"].clone();
    closed["posture"] = json!("closed");
    night.put(serde_json::from_value(closed).unwrap());
    let failed = stage.until(&location.unwrap(), |state| state["state"] == "failed").await;
    let detail = failed["detail"].as_str().unwrap();
    assert!(detail.starts_with("verified closed, but ") && detail.contains(told), "{failed}");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_refusal_has_its_reason_and_without_an_answer_the_outcome_is_unknown() {
    let stage = Stage::start().await;
    let night = night(&stage).await;
    let (status, unknown, _) = post(&stage, Some("x"), None, json!({"command": "start"})).await;
    assert_eq!((status, &unknown["code"]), (504, &json!("command-unacknowledged")), "{unknown}");
    let (_observatory, orders) = observatory(&stage).await;
    // The new queryable is known to this node a moment later; an unknown outcome stays one under its key.
    let mut keys = (0..).map(|number| format!("r{number}"));
    let refused = loop {
        let key = keys.next().unwrap();
        let (status, refused, _) =
            post(&stage, Some(&key), None, json!({"command": "start", "reason": "refuse"})).await;
        if status == 409 {
            break refused;
        }
        assert_eq!(status, 504, "{refused}");
    };
    assert_eq!(
        (&refused["code"], &refused["reason"], &refused["detail"]),
        (&json!("refused"), &json!("not_now"), &json!("it is noon"))
    );
    let before = orders.lock().unwrap().len();
    for (key, body, status, code) in [
        (None, json!({"command": "close"}), 400, "malformed"),
        (Some(""), json!({"command": "close"}), 400, "malformed"),
        (Some("1"), json!({"command": "open"}), 422, "validation"),
        (Some("2"), json!({"command": "close", "now": true}), 422, "validation"),
        (Some("3"), json!({"command": "override", "parameters": {"input": "sun"}}), 422, "validation"),
        (Some("4"), json!({"command": "ack", "parameters": {}}), 422, "validation"),
        (Some("5"), json!({"command": "close", "deadline_s": 0}), 422, "validation"),
        (Some("6"), json!({"command": "close", "operator": "a/b"}), 422, "validation"),
        (Some("7"), json!(["close"]), 422, "validation"),
    ] {
        let (found, problem, _) = post(&stage, key, None, body.clone()).await;
        assert_eq!((found, &problem["code"]), (status, &json!(code)), "{body}: {problem}");
    }
    let raw = |bytes: &'static [u8], kind: &'static str| {
        let request = stage.http.post(format!("{}{COMMANDS}", stage.url)).header("Idempotency-Key", "raw");
        // The server ends the connection of a body that it does not want to the end.
        request.header("Content-Type", kind).header("Connection", "close").body(bytes).send()
    };
    for (bytes, kind, status) in [
        (&b"{"[..], "application/json", 400),
        (b"\xff\xfe{}", "application/json", 400),
        (b"command=close", "text/plain", 415),
    ] {
        assert_eq!(raw(bytes, kind).await.unwrap().status().as_u16(), status, "{bytes:?}");
    }
    let large = vec![b' '; 3 << 20].leak();
    assert_eq!(raw(large, "application/json").await.unwrap().status().as_u16(), 413);
    assert_eq!(orders.lock().unwrap().len(), before, "none of them reached the telescope");
    let url = format!("{}{}", stage.url, COMMANDS.replace("callisto", "io"));
    let request = stage.http.post(url).header("Idempotency-Key", "z").header("Content-Type", "application/json");
    let status = request.body(r#"{"command": "close"}"#).send().await.unwrap().status().as_u16();
    assert_eq!(status, 404);
    drop(night);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_catalogue_has_what_stands_against_an_order() {
    let stage = Stage::start().await;
    let _night = night(&stage).await;
    let path = format!("{COMMANDS}/catalog");
    let offered = stage.get(&path).await.1;
    let of = |word: &str| offered.as_array().unwrap().iter().find(|order| order["command"] == word).unwrap().clone();
    let close = of("close");
    assert_eq!((&close["may"], &close["right"], &close["against"]), (&json!(true), &json!("observer"), &json!([])));
    assert!(!of("start")["against"].as_array().unwrap().is_empty(), "no verdict was received: {}", of("start"));
    assert_eq!(of("override")["parameters"]["properties"]["minutes"]["maximum"], 480.0);
    // To start what another operator has, an operator gives a reason; the holder needs none.
    let control = |from: &str| {
        let held = json!({"from": from, "reason": "visitors", "at_utc": bus::Clock::machine_clock().utc()});
        serde_json::from_value::<OperatorOrders>(json!({"control": held, "overrides": [], "shelved": []})).unwrap()
    };
    let orders =
        stage.publish(Key::Observatory(address("callisto"), Part::OperatorOrders), control("cli/ben@pc")).await;
    let takes_over = |offered: &Value| {
        let start = offered.as_array().unwrap().iter().find(|order| order["command"] == "start").unwrap().clone();
        let against = start["against"].as_array().unwrap().clone();
        against.iter().any(|why| {
            let why = why.as_str().unwrap();
            why.starts_with("ben has the telescope since") && why.contains("(visitors): give a reason to take it over")
        })
    };
    stage.until(&path, takes_over).await;
    orders.put(control("cli/local@pc"));
    stage.until(&path, |offered| offered.is_array() && !takes_over(offered)).await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_start_that_opens_nothing_yet_is_answered_with_what_keeps_the_telescope_closed() {
    let stage = Stage::start().await;
    let (_observatory, _orders) = observatory(&stage).await;
    let _night = night(&stage).await;
    let by_ben = json!({"from": "cli/ben@pc", "reason": "wet snow", "at_utc": bus::Clock::machine_clock().utc()});
    let orders = json!({"stay_closed": by_ben, "control": by_ben, "overrides": [], "shelved": []});
    let orders: OperatorOrders = serde_json::from_value(orders).unwrap();
    let _orders = stage.publish(Key::Observatory(address("callisto"), Part::OperatorOrders), orders).await;
    let any = |against: &Value, is_it: &dyn Fn(&str) -> bool| {
        against.as_array().unwrap().iter().any(|why| is_it(why.as_str().unwrap()))
    };
    let closed = "it stays closed until `open-again`: ben ordered so at ";
    let stays_closed = |against: &Value| any(against, &|why| why.starts_with(closed) && why.ends_with("(wet snow)"));
    let says = |offered: &Value| {
        let start = offered.as_array().and_then(|all| all.iter().find(|order| order["command"] == "start"));
        start.is_some_and(|start| stays_closed(&start["against"]))
    };
    stage.until(&format!("{COMMANDS}/catalog"), says).await;
    let (status, state, location) =
        post(&stage, Some("a"), None, json!({"command": "start", "reason": "it is dry"})).await;
    assert_eq!((status, &state["state"]), (202, &json!("done")), "{state}");
    assert!(stays_closed(&state["against"]), "{state}");
    assert!(!any(&state["against"], &|why| why.contains("give a reason")), "it has one: {state}");
    assert_eq!(stage.get(&location.unwrap()).await.1["against"], state["against"]);
    let (_, close, _) = post(&stage, Some("b"), None, json!({"command": "close"})).await;
    assert_eq!(close["against"], json!([]), "{close}");
    // At the address of Astra, too.
    let answer = stage.ask("POST /api/startschedule", "", None).await;
    assert!(answer.text.contains(&format!("; but {closed}")), "{}", answer.text);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_close_that_no_observatory_node_answers_is_carried_out_by_the_dome() {
    let stage = Stage::start().await;
    let device = address("callisto").device(Kind::Dome, &"dome_1".parse().unwrap());
    let dome = DomeNode::start(&stage.bus, device, "callisto").await;
    let path = "/api/v1/network";
    let silent = stage.until(path, |network| network["telescopes"][0]["posture_by"] == "domes").await;
    let says_how_it_stands = |network: &Value| {
        network["telescopes"][0]["domes"][0].as_str().is_some_and(|words| words.contains("shutter in error"))
    };
    let before = stage.until(path, says_how_it_stands).await;
    let before = &before["telescopes"][0];
    assert_eq!(
        (&silent["telescopes"][0]["id"], &before["safety"]["state"]),
        (&json!("paranal/callisto"), &json!("unknown"))
    );
    let words = before["domes"][0].as_str().unwrap();
    assert!(words.starts_with("dome dome_1: shutter in error, it may be half open, not verified closed"), "{words}");
    assert!(before["now"].as_str().unwrap().starts_with("the observatory node is silent"), "{before}");

    let body = json!({"command": "close", "operator": "ana"});
    let (status, state, location) = post(&stage, Some("a"), None, body).await;
    assert_eq!((status, &state["state"]), (202, &json!("accepted")), "{state}");
    assert!(state["detail"].as_str().unwrap().contains("does not know of this order"), "{state}");
    let done = stage.until(&location.unwrap(), |state| state["state"] == "done").await;
    let detail = done["detail"].as_str().unwrap();
    assert!(detail.starts_with("verified closed by the guard of paranal/callisto/dome/dome_1"), "{done}");
    {
        let commands = dome.commands.lock().unwrap();
        let close = commands.first().unwrap();
        assert_eq!((close.token, contract::command::operator(&close.from)), (None, "ana"));
    }
    let closed = stage.until(path, |network| network["telescopes"][0]["posture"] == "closed").await;
    assert_eq!(closed["telescopes"][0]["safety_concern"], "medium", "closed, and its safety is unknown");

    // Closed, and nobody has noted that it is to stay so.
    let (_, state, location) = post(&stage, Some("b"), None, json!({"command": "stay-closed"})).await;
    let location = location.unwrap();
    let failed = stage.until(&location, |state| state["state"] == "failed").await;
    assert!(failed["detail"].as_str().unwrap().starts_with("verified closed by the guard"), "{state} {failed}");

    // One that comes back may have begun to open: the order is done once all is closed again.
    dome.shutter.send_replace(Shutter::Opening);
    let is_open = |network: &Value| {
        network["telescopes"][0]["domes"][0].as_str().is_some_and(|words| words.contains("not verified closed"))
    };
    stage.until(path, is_open).await;
    let mut back = sample("observatory.night");
    (back["last_order"]["id"], back["posture"]) = (state["id"].clone(), json!("closed"));
    let back: NightState = serde_json::from_value(back).unwrap();
    let _night = stage.publish(Key::Observatory(address("callisto"), Part::Night), back).await;
    let (_observatory, orders) = observatory(&stage).await;
    let is_taken = |state: &Value| {
        state["detail"].as_str().is_some_and(|detail| detail.ends_with("answers now, and has taken the order"))
    };
    let taken = stage.until(&location, is_taken).await;
    assert_eq!(taken["state"], "failed", "{taken}");
    dome.shutter.send_replace(Shutter::Closed);
    let done = stage.until(&location, |state| state["state"] == "done").await;
    assert_eq!(done["detail"], "verified closed", "{done}");
    assert!(orders.lock().unwrap().iter().any(|order| order.kind == OrderKind::StayClosed(true)));
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_that_only_the_dome_took_is_not_given_any_more_when_a_newer_one_was_taken_from_anybody() {
    let stage = Stage::start().await;
    let device = address("callisto").device(Kind::Dome, &"dome_1".parse().unwrap());
    let _dome = DomeNode::start(&stage.bus, device, "callisto").await;
    stage.until("/api/v1/network", |network| network["telescopes"][0]["posture_by"] == "domes").await;
    let body = json!({"command": "stay-closed", "operator": "ana"});
    let (status, state, location) = post(&stage, Some("a"), None, body).await;
    assert_eq!((status, &state["state"]), (202, &json!("accepted")), "{state}");
    let location = location.unwrap();
    stage.until(&location, |state| state["state"] == "failed").await;

    // The observatory node is back, and has taken an order of somebody else; it answers a moment later.
    let mut after = sample("observatory.night");
    after["last_order"] = json!({
        "id": "newer", "from": "cli/ben@pc", "verb": "robotic", "at_utc": bus::Clock::machine_clock().utc(),
    });
    let after: NightState = serde_json::from_value(after).unwrap();
    let _night = stage.publish(Key::Observatory(address("callisto"), Part::Night), after).await;
    let is_replaced =
        |state: &Value| state["detail"].as_str().is_some_and(|detail| detail.contains("a newer order of ben at "));
    let replaced = stage.until(&location, is_replaced).await;
    assert_eq!(replaced["state"], "failed", "{replaced}");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_close_that_the_dome_carries_out_late_has_failed_and_is_given_on_until_it_is_closed() {
    let stage = Stage::start().await;
    let device = address("callisto").device(Kind::Dome, &"dome_1".parse().unwrap());
    let dome = DomeNode::start(&stage.bus, device, "callisto").await;
    dome.sticks.store(true, Ordering::Relaxed);
    stage.until("/api/v1/network", |network| network["telescopes"][0]["posture_by"] == "domes").await;
    let body = json!({"command": "close", "operator": "ana", "deadline_s": 1});
    let (status, state, location) = post(&stage, Some("a"), None, body).await;
    assert_eq!(status, 202, "{state}");
    let location = location.unwrap();
    let late = stage.until(&location, |state| state["state"] == "failed").await;
    let detail = late["detail"].as_str().unwrap();
    assert!(detail.starts_with("NOT verified closed within 1 s: paranal/callisto/dome/dome_1"), "{late}");
    assert!(detail.contains("the guard of each dome goes on to ask it to close until that is verified"), "{late}");

    let mut closed = sample("observatory.night");
    (closed["last_order"]["id"], closed["posture"]) = (state["id"].clone(), json!("closed"));
    let closed: NightState = serde_json::from_value(closed).unwrap();
    let _night = stage.publish(Key::Observatory(address("callisto"), Part::Night), closed).await;
    let (_observatory, orders) = observatory(&stage).await;
    test_support::until("the order is given on", || !orders.lock().unwrap().is_empty()).await;
    dome.shutter.send_replace(Shutter::Closed);
    let done = stage.until(&location, |state| state["state"] == "done").await;
    assert!(done["detail"].as_str().unwrap().starts_with("verified closed"), "{done}");
    stage.end().await;
}
