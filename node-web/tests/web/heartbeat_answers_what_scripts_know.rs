//! `/api/heartbeat` for one, several and silent telescopes.

use contract::device::dome::Shutter;
use contract::device::{DeviceState, Link, safety_monitor};
use contract::observatory::{ActionNow, Alert, AlertKind, Alerts, NightState, Posture, Priority, SafetyState, Verdict};
use contract::{Datum, Key, Kind, Part, Reading, Scalar, datum::ReadingOutcome};
use serde_json::{Value, json};
use test_support::DomeNode;
use units::Utc;

use crate::stage::{Published, Stage, address};

fn now() -> Utc {
    "2026-11-21T03:12:45.250Z".parse().unwrap()
}

fn night(robotic: bool, posture: Posture) -> NightState {
    NightState {
        robotic,
        posture,
        actions: vec![ActionNow {
            row: 3,
            action: "object".into(),
            camera: "andor".into(),
            object: Some("TRAPPIST-1".into()),
            step: "slewing".into(),
            started_utc: now(),
            expected_by_utc: None,
        }],
        frames: 7,
        open_s: 60.0,
        speed: 1.0,
        simulated: false,
        ended: false,
        last_frame: None,
        triggers: Vec::new(),
        last_order: None,
    }
}

fn safety(verdict: Verdict) -> SafetyState {
    SafetyState {
        avoid: Vec::new(),
        intervals: Vec::new(),
        verdict,
        since_utc: now(),
        reasons: Vec::new(),
        suspended: Vec::new(),
        advisories: Vec::new(),
        time_to_safe_s: (verdict == Verdict::Unsafe).then_some(900.0),
        inputs: Vec::new(),
    }
}

/// An observatory node that goes on publishing until it is dropped.
async fn observatory(stage: &Stage, telescope: &str, verdict: Verdict, posture: Posture) -> [Published<Value>; 2] {
    let key = |part| Key::Observatory(address(telescope), part);
    let night = serde_json::to_value(night(true, posture)).unwrap();
    let safety = serde_json::to_value(safety(verdict)).unwrap();
    [stage.publish(key(Part::Night), night).await, stage.publish(key(Part::Safety), safety).await]
}

const OLD_KEYS: [&str; 11] = [
    "datetime",
    "error_free",
    "error_source",
    "weather_safe",
    "schedule_running",
    "cpu_percent",
    "memory_percent",
    "disk_percent",
    "threads",
    "polling",
    "monitor-action-queue",
];

#[tokio::test(flavor = "multi_thread")]
async fn one_telescope_answers_with_every_old_key() {
    let stage = Stage::start().await;
    let monitor = DeviceState {
        link: Link::Connected,
        busy: false,
        period_s: 1.0,
        poll_s: None,
        last_command: None,
        fields: safety_monitor::Fields { is_safe: Datum::Known(true), gapless_safe_s: 5.0 },
        readings: [
            ("IsSafe", ReadingOutcome::Value { value: Scalar::Bool(true), unit: String::new() }),
            ("Description", ReadingOutcome::Missing { no_data: contract::NoData::not_implemented() }),
        ]
        .map(|(name, outcome)| (name.to_owned(), Reading { outcome, at_utc: now(), age_s: None }))
        .into(),
    };
    let device = address("callisto").shared().device(Kind::SafetyMonitor, &"monitor".parse().unwrap());
    let _monitor = stage.publish(Key::State(device), monitor).await;
    let _callisto = observatory(&stage, "callisto", Verdict::Safe, Posture::Open).await;
    let answer = stage
        .until("/api/heartbeat", |answer| {
            let data = &answer["data"];
            data["weather_safe"] == true && data["error_free"] == true && data["polling"]["SafetyMonitor"].is_object()
        })
        .await;
    assert_eq!((&answer["status"], &answer["message"]), (&json!("success"), &json!("")));
    let data = answer["data"].as_object().unwrap();
    for key in OLD_KEYS {
        assert!(data.contains_key(key), "{key}");
    }
    assert_eq!((&data["error_free"], &data["error_source"]), (&json!(true), &json!([])));
    assert_eq!((&data["schedule_running"], &data["robotic_switch"]), (&json!(true), &json!(true)));
    assert_eq!((&data["stale"], &data["telescope_id"]), (&json!(false), &json!("callisto")));
    let ids: Vec<&Value> = data["threads"].as_array().unwrap().iter().map(|thread| &thread["id"]).collect();
    assert_eq!(ids, [&json!("watchdog"), &json!(3)]);
    // Shape of the old stamps: a blank, three decimals, no zone; ISO with an offset inside `polling`.
    let datetime = data["datetime"].as_str().unwrap();
    assert!(datetime.len() == 23 && datetime.as_bytes()[10] == b' ' && datetime.as_bytes()[19] == b'.', "{datetime}");
    let polled = &data["polling"]["SafetyMonitor"]["monitor"];
    assert_eq!(polled["IsSafe"], json!({ "value": true, "datetime": "2026-11-21T03:12:45.250+00:00" }));
    assert_eq!(polled["Description"]["value"], Value::Null);
    let measured = stage.until("/api/heartbeat", |answer| answer["data"]["cpu_percent"].is_number()).await;
    for part in ["cpu_percent", "memory_percent", "disk_percent"] {
        let percent = measured["data"][part].as_f64().unwrap();
        assert!((0.0..=100.0).contains(&percent), "{part} {percent}");
    }
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn several_telescopes_roll_up_and_each_can_be_asked_alone() {
    let stage = Stage::start().await;
    let _callisto = observatory(&stage, "callisto", Verdict::Safe, Posture::Open).await;
    let _io = observatory(&stage, "io", Verdict::Unsafe, Posture::Closed).await;
    let alerts = |priority| Alerts {
        alerts: vec![Alert { priority, ..AlertKind::DomeNotClosed.alert("dome_1", now(), "the dome does not close") }],
        ..Alerts::default()
    };
    let key = Key::Observatory(address("io"), Part::Alerts);
    let publisher = stage.publish(key, alerts(Priority::Critical)).await;
    let is_whole = |answer: &Value| {
        let of = &answer["data"]["telescopes"];
        let (callisto, io) = (&of["callisto"], &of["io"]);
        let has_alert = io["error_source"][0]["device_name"] == "dome_1";
        callisto["weather_safe"] == true && callisto["error_free"] == true && io["weather_safe"] == false && has_alert
    };
    let data = stage.until("/api/heartbeat", is_whole).await["data"].take();
    assert_eq!(data["error_free"], false, "one has an error");
    assert_eq!(data["weather_safe"], true, "the one that is unsafe is closed");
    assert_eq!(data["telescopes"]["callisto"]["error_free"], true);
    let error = &data["error_source"][0];
    assert_eq!((&error["telescope_id"], &error["device_name"]), (&json!("io"), &json!("dome_1")));
    for key in OLD_KEYS {
        assert!(data.get(key).is_some(), "{key}");
    }
    let (_, alone) = stage.get("/api/heartbeat?telescope=io").await;
    assert_eq!((&alone["data"]["telescope_id"], &alone["data"]["time_to_safe_s"]), (&json!("io"), &json!(900.0)));
    assert_eq!(stage.get("/api/heartbeat?telescope=paranal/callisto").await.1["data"]["telescope_id"], "callisto");
    let (status, problem) = stage.get("/api/heartbeat?telescope=europa").await;
    assert_eq!((status.as_u16(), &problem["code"]), (404, &json!("not-found")));
    // Cleared, and no person has seen it: no error of now, but a script that asks every few minutes must see it.
    let mut over = alerts(Priority::Critical);
    over.alerts[0].returned_utc = Some(now());
    publisher.put(over);
    let calm = stage.until("/api/heartbeat?telescope=io", |answer| answer["data"]["error_free"] == true).await;
    let returned = &calm["data"]["returned"][0];
    assert_eq!((&returned["device_name"], &calm["data"]["error_source"]), (&json!("dome_1"), &json!([])));
    assert!(returned["error"].as_str().unwrap().starts_with("dome-not-closed/dome_1"), "{returned}");
    stage.until("/api/heartbeat", |answer| answer["data"]["returned"][0]["telescope_id"] == "io").await;
    publisher.put(alerts(Priority::Advisory));
    let none = |answer: &Value| answer["data"]["error_free"] == true && answer["data"]["returned"] == json!([]);
    stage.until("/api/heartbeat?telescope=io", none).await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_silent_observatory_is_an_error_and_never_safe() {
    let stage = Stage::start().await;
    let (_, never) = stage.get("/api/heartbeat").await;
    assert_eq!((&never["data"]["error_free"], &never["data"]["stale"]), (&json!(false), &json!(true)));
    let publishing = observatory(&stage, "callisto", Verdict::Safe, Posture::Open).await;
    stage.until("/api/heartbeat", |answer| answer["data"]["error_free"] == true).await;
    drop(publishing);
    let silent = stage.until("/api/heartbeat", |answer| answer["data"]["stale"] == true).await["data"].take();
    assert_eq!((&silent["error_free"], &silent["weather_safe"]), (&json!(false), &Value::Null));
    assert_eq!((&silent["watchdog_running"], &silent["schedule_running"]), (&json!(false), &json!(false)));
    let age_s = silent["age_s"].as_f64().unwrap();
    assert!(age_s >= 5.0, "{age_s}");
    assert!(silent["error_source"][0]["error"].as_str().unwrap().starts_with("stale"), "{silent}");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_silent_observatory_leaves_the_posture_of_the_dome_its_alerts_and_what_closes_it() {
    let stage = Stage::start().await;
    let device = address("callisto").device(Kind::Dome, &"dome_1".parse().unwrap());
    let dome = DomeNode::start(&stage.bus, device, "callisto").await;
    dome.shutter.send_replace(Shutter::Open);
    // State, guard and alerts come one by one; since when it is silent is known by the age of the guard's permit.
    let open = |answer: &Value| {
        let data = &answer["data"];
        data["posture"] == "open"
            && data["error_source"][1] != Value::Null
            && data["observatory_silent_since_utc"].is_string()
    };
    let data = stage.until("/api/heartbeat", open).await["data"].take();
    assert_eq!((&data["stale"], &data["weather_safe"]), (&json!(true), &Value::Null));
    let errors = data["error_source"].as_array().unwrap();
    let has = |words: &[&str]| {
        errors
            .iter()
            .filter_map(|error| error["error"].as_str())
            .any(|text| words.iter().all(|word| text.contains(word)))
    };
    assert!(has(&["dome-not-closed/dome_1: it is half open"]), "{errors:#?}");
    let words = [
        "the observatory node is silent since ",
        " UTC, so safety is unknown",
        "posture open",
        "its guard closes it now",
    ];
    assert!(has(&words), "{errors:#?}");
    stage.end().await;
}
