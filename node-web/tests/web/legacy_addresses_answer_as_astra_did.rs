//! The addresses that pages and scripts of Astra's users know: sockets, history, sky and orders.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use contract::archive::{ArchiveQuestion, Ask};
use contract::node::{DiaryLine, Level};
use contract::{Accepted, Key, Kind, NodeTopic, Order, OrderKind, Part, Reply, Role};
use serde_json::{Value, json};

use crate::stage::raw::{add_user, change, request, with_users};
use crate::stage::socket::Socket;
use crate::stage::{Published, Stage, address, sample};

/// A telescope as its nodes publish it while this is held; the values are those of the contract's samples.
async fn telescope(stage: &Stage, telescope: &str) -> Vec<Published<Value>> {
    let mut kept = Vec::new();
    for (key, body) in published(telescope) {
        kept.push(stage.publish(key, body).await);
    }
    kept
}

fn published(telescope: &str) -> Vec<(Key, Value)> {
    let mut published = Vec::new();
    for (kind, name) in [
        (Kind::Camera, "andor"),
        (Kind::Dome, "roof"),
        (Kind::FilterWheel, "wheel"),
        (Kind::Focuser, "focus"),
        (Kind::ObservingConditions, "wx"),
        (Kind::Rotator, "turner"),
        (Kind::Telescope, "mount"),
    ] {
        let device = address(telescope).device(kind, &name.parse().unwrap());
        if kind == Kind::FilterWheel {
            published.push((Key::Capabilities(device.clone()), sample("filterwheel.capabilities")));
        }
        published.push((Key::State(device), sample(&format!("{kind}.state"))));
    }
    let shared = address(telescope).shared().device(Kind::SafetyMonitor, &"monitor".parse().unwrap());
    published.push((Key::State(shared), sample("safetymonitor.state")));
    for (part, name) in [(Part::Night, "night"), (Part::Safety, "safety"), (Part::Schedule, "schedule")] {
        published.push((Key::Observatory(address(telescope), part), sample(&format!("observatory.{name}"))));
    }
    let camera = address(telescope).device(Kind::Camera, &"andor".parse().unwrap());
    published.push((Key::Frame(camera), sample("camera.frame")));
    published
}

/// The text of what a raw request to open a socket is answered.
async fn refused(stage: &Stage, path: &str, headers: &str) -> (u16, Value) {
    let headers = format!(
        "{headers}Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
    );
    let text = request(stage.authority(), &format!("GET {path}"), &headers, None);
    let answer = stage.raw(&text).await;
    (answer.status, answer.json())
}

fn row<'a>(tables: &'a Value, item: &str) -> &'a Value {
    let rows = tables["table0"].as_array().unwrap();
    rows.iter().find(|row| row["item"] == item).unwrap_or_else(|| panic!("no {item}: {tables:#}"))
}

#[tokio::test(flavor = "multi_thread")]
async fn the_socket_sends_two_tables_again_and_again_with_the_words_of_astra() {
    let stage = Stage::start().await;
    let kept = telescope(&stage, "callisto").await;
    let mut socket = Socket::open(&stage, "/ws", "").await.unwrap_or_else(|status| panic!("{status}"));
    // Whole, and all of it fresh.
    let is_whole = |tables: &Value| {
        let rows = tables["table0"].as_array().filter(|rows| rows.len() == 8);
        let is = |item, status| row(tables, item)["status"] == status;
        rows.is_some_and(|rows| rows.iter().all(|row| row["status"] != "error"))
            && is("Telescope", "tracking")
            && is("SafetyMonitor", "safe")
            && tables["table1"][2]["value"] == "running"
            && tables["table1"][8]["value"] != "unknown"
    };
    let tables = socket.until(is_whole).await;
    let items: Vec<&Value> = tables["table0"].as_array().unwrap().iter().map(|row| &row["item"]).collect();
    let order =
        ["Telescope", "guider", "Dome", "FilterWheel", "Camera", "Focuser", "ObservingConditions", "SafetyMonitor"];
    assert_eq!(items, order.map(|item| json!(item)).each_ref().to_vec(), "a rotator has no row");
    let status = |item| &row(&tables, item)["status"];
    assert_eq!((status("Telescope"), status("Dome")), (&json!("tracking"), &json!("open")));
    assert_eq!((status("Camera"), status("guider")), (&json!("exposing (-59.98 C)"), &json!(false)));
    assert_eq!((status("FilterWheel"), status("SafetyMonitor")), (&json!("I+z"), &json!("safe")));
    assert!(status("Focuser").is_i64(), "{tables:#}");
    assert!(!row(&tables, "FilterWheel")["filter_names"].as_array().unwrap().is_empty());
    let mount = row(&tables, "Telescope");
    assert_eq!((&mount["name"], &mount["valid"]), (&json!("mount"), &json!(true)), "{mount:#}");
    assert!(mount["last_update"].as_str().unwrap().ends_with(" s ago"), "{mount}");
    let hours = sample("telescope.state")["readings"]["RightAscension"]["value"].as_f64().unwrap();
    let ascension = &mount["polled"]["RightAscension"];
    assert!((ascension["value"].as_f64().unwrap() - hours * 15.0).abs() < 1e-9, "degrees: {ascension}");
    assert_eq!(ascension["datetime"], "2026-11-21 03:12:45");

    let table1 = tables["table1"].as_array().unwrap();
    let items: Vec<&str> = table1.iter().map(|row| row["item"].as_str().unwrap()).collect();
    let positions = [
        "error free",
        "utc time",
        "watchdog",
        "schedule",
        "robotic switch",
        "weather safe",
        "error source",
        "threads",
        "time to safe",
    ];
    assert_eq!(items, positions);
    let values: Vec<&Value> = [2, 4, 5, 8].map(|i| &table1[i]["value"]).to_vec();
    assert_eq!(values, [&json!("running"), &json!("on"), &json!("unsafe"), &json!("19.43 mins")]);
    assert_eq!(table1[1]["value"].as_str().unwrap().len(), 19);
    assert!(table1[6]["error_source"].is_array() && table1[7]["threads"].is_array());
    assert_eq!(table1[7]["value"], table1[7]["threads"].as_array().unwrap().len());

    for _ in 0..3 {
        assert!(socket.recv().await["table0"].is_array());
    }
    drop(kept);
    // Nothing is published any more: an old status is never repeated as if it were of now.
    let silent = socket
        .until(|tables| row(tables, "Dome")["status"] == "error" && tables["table1"][2]["value"] == "stopped")
        .await;
    assert_eq!((&row(&silent, "Dome")["valid"], &silent["table1"][0]["value"]), (&json!(false), &json!(false)));
    assert_eq!(silent["table1"][8]["value"], "unknown");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_value_that_is_no_number_is_null_and_the_document_stays_json() {
    let stage = Stage::start().await;
    let mut state = sample("camera.state");
    state["fields"]["ccd_c"] = json!({"no_data": "not a number: NaN"});
    state["readings"]["CCDTemperature"] = json!({"no_data": "not a number: NaN", "at_utc": "2026-11-21T03:12:45Z"});
    let device = address("callisto").device(Kind::Camera, &"andor".parse().unwrap());
    let _camera = stage.publish(Key::State(device), state).await;
    let mut socket =
        Socket::open(&stage, "/ws?telescope=callisto", "").await.unwrap_or_else(|status| panic!("{status}"));
    // The stage reads each message with a JSON reader, which takes no NaN.
    let tables = socket.until(|tables| tables["table0"].as_array().is_some_and(|rows| !rows.is_empty())).await;
    let camera = row(&tables, "Camera");
    assert_eq!((&camera["status"], &camera["valid"]), (&json!("exposing"), &json!(false)));
    assert_eq!(camera["polled"]["CCDTemperature"]["value"], Value::Null);
    assert_eq!(tables["last_image"], Value::Null);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_log_socket_sends_each_line_once_also_where_times_are_equal_and_begins_with_an_empty_log() {
    let stage = Stage::start().await;
    // A telescope of another site, whose log is empty.
    let far = contract::Address::new("oca", "io").unwrap();
    let _night = stage.publish(Key::Observatory(far.clone(), Part::Night), sample("observatory.night")).await;
    stage.until("/api/v1/network", |network| network["telescopes"].as_array().is_some_and(|all| all.len() == 2)).await;
    let mut socket =
        Socket::open(&stage, "/ws/log?telescope=oca/io", "").await.unwrap_or_else(|status| panic!("{status}"));
    assert_eq!(socket.recv().await, json!({"log": [], "schedule_mtime": 0.0}));
    assert_eq!(socket.recv().await["log"], json!([]), "it lives on");

    let key = Key::Node(far.clone(), Role::Observatory, "main".parse().unwrap(), NodeTopic::Diary);
    let diary = stage.bus.publisher::<DiaryLine>(&key).await.unwrap();
    let mut got = Vec::new();
    for batch in 0..3 {
        for line in 0..7 {
            let line = DiaryLine {
                level: if line == 3 { Level::Warn } else { Level::Info },
                target: String::new(),
                message: format!("{batch}-{line}"),
                fields: Default::default(),
            };
            diary.put(line).await.unwrap();
        }
        while got.len() < 7 * (batch + 1) {
            got.extend(socket.until(|message| message["log"] != json!([])).await["log"].as_array().unwrap().clone());
        }
    }
    let messages: Vec<&str> = got.iter().map(|line| line["message"].as_str().unwrap()).collect();
    let all: Vec<String> = (0..3).flat_map(|batch| (0..7).map(move |line| format!("{batch}-{line}"))).collect();
    assert_eq!(messages, all, "each once and in order");
    assert_eq!((&got[3]["level"], &got[4]["level"]), (&json!("warning"), &json!("info")));
    let datetime = got[0]["datetime"].as_str().unwrap();
    assert!(datetime.len() == 23 && datetime.as_bytes()[10] == b' ', "{datetime}");
    assert_eq!(socket.recv().await["log"], json!([]), "none is repeated");

    let _schedule = stage.publish(Key::Observatory(far, Part::Schedule), sample("observatory.schedule")).await;
    let mtime = socket.until(|message| message["schedule_mtime"] != json!(0.0)).await["schedule_mtime"].clone();
    assert!(mtime.as_f64().unwrap() > 1.7e9, "{mtime}");
    assert_eq!(socket.recv().await["schedule_mtime"], mtime, "the same schedule");
    let (_, log) = stage.get("/api/log?telescope=oca/io&limit=2").await;
    assert_eq!((&log[0]["message"], &log[1]["message"]), (&json!("2-5"), &json!("2-6")));
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn of_several_telescopes_one_has_to_be_named_and_the_problem_names_them() {
    let stage = Stage::start().await;
    let _telescope = telescope(&stage, "callisto").await;
    let _io = telescope(&stage, "io").await;
    stage.until("/api/v1/network", |network| network["telescopes"].as_array().is_some_and(|all| all.len() == 2)).await;
    for path in
        ["/ws", "/ws/log", "/api/sky_data", "/api/db/guiding", "/api/db/polling/Dome", "/api/schedule", "/api/log"]
    {
        let (status, problem) = match path.starts_with("/ws") {
            true => refused(&stage, path, "").await,
            false => {
                let (status, problem) = stage.get(path).await;
                (status.as_u16(), problem)
            }
        };
        assert_eq!((status, &problem["code"]), (400, &json!("malformed")), "{path}: {problem}");
        assert_eq!(problem["telescopes"], json!(["paranal/callisto", "paranal/io"]), "{path}");
        assert!(problem["detail"].as_str().unwrap().contains("paranal/callisto, paranal/io"), "{path}: {problem}");
    }
    for path in ["/ws?telescope=europa", "/ws/log?telescope=paranal/europa"] {
        let (status, problem) = refused(&stage, path, "").await;
        assert_eq!((status, &problem["code"]), (404, &json!("not-found")), "{path}");
        assert!(problem["detail"].as_str().unwrap().contains("europa"), "{problem}");
    }
    let mut io = Socket::open(&stage, "/ws?telescope=io", "").await.unwrap_or_else(|status| panic!("{status}"));
    io.until(|tables| !tables["table0"].as_array().unwrap().is_empty()).await;
    // A browser's page of another server, and a request that is no WebSocket.
    assert_eq!(refused(&stage, "/ws?telescope=io", "Origin: http://evil.example\r\n").await.0, 403);
    let (status, problem) = stage.get("/ws?telescope=io").await;
    assert_eq!((status.as_u16(), &problem["code"]), (400, &json!("malformed")), "{problem}");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_user_without_the_right_opens_no_socket_and_one_who_loses_it_is_let_go() {
    let folder = with_users();
    add_user(folder.path(), "bob", &["viewer:paranal/io"]);
    let stage = Stage::start_with("", folder.path()).await;
    let _telescope = telescope(&stage, "callisto").await;
    let _io = telescope(&stage, "io").await;
    let (ana, bob) = (stage.session("ana").await, stage.session("bob").await);
    for path in ["/ws", "/ws/log"] {
        assert_eq!(refused(&stage, &format!("{path}?telescope=paranal/io"), "").await.0, 401);
        for telescope in ["paranal/callisto", "paranal/nowhere"] {
            let (status, problem) = refused(&stage, &format!("{path}?telescope={telescope}"), &bob).await;
            assert_eq!((status, &problem["required_right"]), (403, &json!("viewer")), "{telescope}: {problem}");
        }
        let (status, _) = refused(&stage, &format!("{path}?telescope=callisto"), &bob).await;
        assert_eq!(status, 404, "he does not learn that it is there");
    }
    let opened = Socket::open(&stage, "/ws", &bob).await;
    let mut socket = opened.unwrap_or_else(|status| panic!("the only one that he sees: {status}"));
    socket.until(|tables| !tables["table0"].as_array().unwrap().is_empty()).await;
    // A viewer orders nothing, and an operator only at his telescopes.
    for (headers, path, wanted) in [
        (&bob, "POST /api/close", 403),
        (&bob, "POST /api/startschedule?telescope=io", 403),
        (&ana, "POST /api/close?telescope=io", 504),
    ] {
        assert_eq!(stage.ask(path, headers, None).await.status, wanted, "{path}");
    }
    change(folder.path(), |users| {
        let bob = users.users.get_mut(&"bob".parse().unwrap()).unwrap();
        bob.grants = vec!["viewer:paranal/callisto".parse().unwrap()];
    });
    assert_eq!(socket.closed().await, 4003);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn these_sockets_count_among_the_places_of_all() {
    let stage = Stage::start().await;
    let _telescope = telescope(&stage, "callisto").await;
    let mut open = Vec::new();
    let full = loop {
        let path = if open.len() % 2 == 0 { "/ws?telescope=callisto" } else { "/ws/log?telescope=callisto" };
        match Socket::open(&stage, path, "").await {
            Ok(socket) => open.push(socket),
            Err(status) => break status,
        }
        assert!(open.len() <= 200, "there is no limit");
    };
    assert_eq!(full, 503);
    let mut last = open.pop().unwrap();
    assert_eq!(Socket::open(&stage, "/api/v1/ws", "").await.err(), Some(503), "the same places");
    // Nobody reads the others.
    assert!(last.until(|message| message.get("log").or(message.get("table0")).is_some()).await.is_object());
    stage.end().await;
}

type Questions = Arc<Mutex<Vec<ArchiveQuestion>>>;

async fn archive(stage: &Stage, answer: Value) -> (bus::Service, Questions) {
    let questions = Questions::default();
    let got = questions.clone();
    let serve = move |question: Result<ArchiveQuestion, String>| {
        got.lock().unwrap().push(question.unwrap());
        let answer = answer.clone();
        async move { answer }
    };
    (stage.bus.serve(&Key::History(address("callisto")), serve).await.unwrap(), questions)
}

#[tokio::test(flavor = "multi_thread")]
async fn polled_numbers_come_a_row_per_minute_with_limits_and_twilight() {
    let stage = Stage::start().await;
    let _telescope = telescope(&stage, "callisto").await;
    let point = |at: &str, value: f64| json!({"at_utc": at, "count": 2, "min": value, "mean": value, "max": value});
    let series = |kind: &str, device: &str, property: &str, points: Value| json!({"series": {"kind": kind, "device": device, "property": property, "piece_s": 60.0, "points": points, "gaps": []}});
    let first = "2026-11-21T03:10:00Z";
    let answer = json!({"truncated": false, "rows": [
        series("observingconditions", "wx", "SkyTemperature", json!([point(first, -41.0)])),
        series("observingconditions", "wx", "Temperature", json!([point(first, 9.0), point("2026-11-21T03:11:20Z", 8.0)])),
        series("observingconditions", "wx2", "Temperature", json!([point(first, 11.0)])),
        series("dome", "roof", "ShutterStatus", json!([point(first, 1.0), point("2026-11-21T03:11:00Z", 0.0)])),
        series("safetymonitor", "monitor", "IsSafe", json!([point(first, 1.0)])),
    ]});
    let (_archive, questions) = archive(&stage, answer).await;
    stage.until("/api/heartbeat", |answer| answer["data"]["polling"]["ObservingConditions"].is_object()).await;
    let days = stage
        .until("/api/db/polling/ObservingConditions?day=0.5", |answer| {
            // On a busy machine the verdict and the station are stale now and then.
            answer["data"][0]["WeatherSafe"].is_number() && answer["latest"]["Humidity"].is_number()
        })
        .await;
    let rows = days["data"].as_array().unwrap();
    assert_eq!((rows.len(), &rows[0]["datetime"]), (2, &json!("2026-11-21T03:10:00")));
    assert_eq!((&rows[0]["Temperature"], &rows[0]["RelativeSkyTemp"]), (&json!(10.0), &json!(-51.0)), "{days:#}");
    assert_eq!((&rows[0]["DomeOpen"], &rows[1]["DomeOpen"]), (&json!(0.0), &json!(1.0)));
    assert_eq!((&rows[0]["IsSafe"], &rows[0]["WeatherSafe"]), (&json!(1.0), &json!(0.0)));
    assert_eq!((&rows[1]["Temperature"], rows[1].get("SkyTemperature")), (&json!(8.0), None), "no row is dropped");
    assert_eq!(days["latest"]["DomeOpen"], json!(1.0), "the same sense as in the rows");
    assert!(days["latest"]["Humidity"].is_number() && days["safety_limits"].is_object(), "{days:#}");
    {
        let questions = questions.lock().unwrap();
        let question = questions.last().unwrap();
        let span_s = question.to_utc.unwrap().seconds_since(question.from_utc.unwrap());
        assert!((span_s - 43_200.0).abs() < 1.0, "{span_s}");
        let Ask::Series { properties, points } = &question.ask else { panic!("{question:?}") };
        let has = |kind, name: &str| properties.iter().any(|one| one.kind == kind && one.property == name);
        assert!(has(Kind::ObservingConditions, "Humidity") && has(Kind::Dome, "ShutterStatus"), "{properties:?}");
        assert!(has(Kind::SafetyMonitor, "IsSafe") && *points == 1440, "{points}");
    }
    // A whole day: half of one may be all day, as it is in the evening.
    let whole = stage.until("/api/db/polling/ObservingConditions?day=1", |answer| answer["data"].is_array()).await;
    let twilight = whole["twilight_periods"].as_array().unwrap();
    assert!(twilight.len() >= 4, "a day has day, night and two twilights: {twilight:?}");
    for pair in twilight.windows(2) {
        assert_eq!(pair[0]["end"], pair[1]["start"]);
        assert_ne!(pair[0]["phase"], pair[1]["phase"]);
    }
    let (_, camera) = stage.get("/api/db/polling/Camera").await;
    assert!(camera["latest"]["CCDTemperature"].is_number(), "{camera}");
    assert!(camera.get("safety_limits").is_none() && camera.get("twilight_periods").is_none());
    for (path, status) in [
        ("/api/db/polling/Fridge", 404),
        ("/api/db/polling/Camera?day=NaN", 400),
        ("/api/db/polling/Camera?day=0", 400),
        ("/api/db/polling/Camera?day=1e9", 400),
        ("/api/db/polling/Camera?since=yesterday", 400),
        ("/api/db/guiding?day=-1", 400),
    ] {
        let (got, problem) = stage.get(path).await;
        assert_eq!(got.as_u16(), status, "{path}: {problem}");
        assert!(problem["detail"].as_str().is_some_and(|detail| !detail.is_empty()), "{path}: {problem}");
    }
    let (status, _) = stage.get("/api/db/polling/Camera?since=2026-11-21%2003:00:00.5").await;
    assert_eq!(status.as_u16(), 200, "as Astra wrote times");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn corrections_of_the_guide_loop_come_from_the_archive() {
    let stage = Stage::start().await;
    let _telescope = telescope(&stage, "callisto").await;
    let correction = sample("observatory.correction");
    let (_archive, questions) =
        archive(&stage, json!({"rows": [{"correction": correction}], "truncated": false})).await;
    let guiding = stage.until("/api/db/guiding?day=0.1", |answer| answer["status"] == "success").await;
    let row = &guiding["data"][0];
    assert_eq!(row["telescope_name"], "callisto");
    assert_eq!(row["post_pid_x"].as_f64(), correction["dx_px"].as_f64().map(|px| -px), "{guiding}");
    assert_eq!(row["datetime"].as_str().map(str::len), Some(23));
    assert_eq!(questions.lock().unwrap()[0].ask, Ask::Corrections);
    let response = stage.http.get(format!("{}/api/db/guiding", stage.url)).send().await.unwrap();
    let link = response.headers()["link"].to_str().unwrap();
    assert_eq!(link, "</api/v1/telescopes/paranal/callisto/guiding>; rel=\"successor-version\"");
    assert_eq!(response.headers()["deprecation"], "true");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_sky_is_that_of_the_site_and_pages_lead_to_the_telescope() {
    let stage = Stage::start().await;
    let _telescope = telescope(&stage, "callisto").await;
    let (status, sky) = stage.get("/api/sky_data").await;
    assert_eq!((status.as_u16(), &sky["status"]), (200, &json!("success")), "{sky}");
    let data = &sky["data"];
    assert!((data["observatory"]["lat"].as_f64().unwrap() + 24.6).abs() < 0.1, "{data}");
    let bodies = data["celestial_bodies"].as_array().unwrap();
    let names: Vec<&Value> = bodies.iter().map(|body| &body["name"]).collect();
    let wanted = ["Sun", "Moon", "Mercury", "Venus", "Mars", "Jupiter", "Saturn"].map(|name| json!(name));
    assert_eq!(names, wanted.iter().collect::<Vec<_>>());
    for body in bodies {
        let [alt, az] = ["alt", "az"].map(|part| body[part].as_f64().unwrap());
        assert!((-90.0..=90.0).contains(&alt) && (0.0..360.0).contains(&az), "{body}");
        assert_eq!(body["type"] == "moon", body.get("phase").is_some(), "{body}");
    }
    let (status, none) = stage.get("/api/allsky/latest?name=north").await;
    assert_eq!(status.as_u16(), 404);
    assert!(none["detail"].as_str().unwrap().contains("/api/v1/telescopes/paranal/callisto/image.jpg"), "{none}");
    for path in ["/schedule", "/fits_explorer", "/fits_explorer/"] {
        let answer = stage.ask(&format!("GET {path}"), "", None).await;
        assert_eq!((answer.status, answer.header("location")), (307, Some("/t/paranal/callisto")), "{path}");
        assert_eq!(answer.header("deprecation"), Some("true"));
    }
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn orders_at_the_old_addresses_are_orders_of_today_and_toggles_are_gone() {
    let stage = Stage::start().await;
    let orders = Arc::new(Mutex::new(Vec::<Order>::new()));
    let got = orders.clone();
    let serve = move |order: Result<Order, String>| {
        let order = order.unwrap();
        got.lock().unwrap().push(order.clone());
        async move { Reply::Accepted(Accepted { id: order.id, token: None, not_written: None }) }
    };
    let _observatory = stage.bus.serve(&Key::Order(address("callisto")), serve).await.unwrap();
    // An answer counts only from the program that publishes the night.
    let _night = stage.publish(Key::Observatory(address("callisto"), Part::Night), sample("observatory.night")).await;
    stage.until("/api/v1/network", |network| network["telescopes"][0]["posture"] == "open").await;
    for (path, kind) in [
        ("close", OrderKind::Close),
        ("cool_camera/andor", OrderKind::Cool { camera: "andor".to_owned(), set_c: None }),
        ("complete_headers", OrderKind::CompleteHeaders { night: None }),
        ("startschedule", OrderKind::Robotic(true)),
        ("stopschedule", OrderKind::Robotic(false)),
    ] {
        let answer = stage.ask(&format!("POST /api/{path}"), "", None).await;
        let ordered = answer.json();
        assert_eq!(
            (answer.status, &ordered["status"], &ordered["data"]),
            (200, &json!("success"), &json!("null")),
            "{path}: {ordered}"
        );
        let last = orders.lock().unwrap().last().cloned().unwrap();
        assert_eq!((last.kind, json!(last.id.0)), (kind, ordered["command_id"].clone()), "{path}");
        let (_, command) = stage.get(answer.header("location").unwrap()).await;
        assert_eq!(command["id"], ordered["command_id"]);
        assert!(answer.header("link").unwrap().contains("/api/v1/telescopes/paranal/callisto/commands"));
    }
    let count = || orders.lock().unwrap().len();
    let before = count();
    let again = stage.ask("POST /api/complete_headers", "Idempotency-Key: once\r\n", None).await.json();
    let repeated = stage.ask("POST /api/complete_headers", "Idempotency-Key: once\r\n", None).await.json();
    assert_eq!((&again["command_id"], count()), (&repeated["command_id"], before + 1));
    assert_eq!(stage.ask("POST /api/close", "Origin: http://evil.example\r\n", None).await.status, 403);
    assert_eq!(stage.ask("GET /api/close", "", None).await.status, 405);
    for path in ["roboticswitch", "startwatchdog", "stopwatchdog", "editschedule", "uploadschedule"] {
        let answer = stage.ask(&format!("POST /api/{path}"), "", None).await;
        assert_eq!((answer.status, &answer.json()["code"]), (410, &json!("gone")), "{path}");
        assert!(answer.json()["detail"].as_str().unwrap().contains("/commands"), "{path}");
    }
    assert_eq!(count(), before + 1, "none of these ordered anything");
    stage.end().await;
}

mod proof {
    use super::*;

    /// A bound in seconds on a real clock.
    #[tokio::test(flavor = "multi_thread")]
    async fn the_socket_sends_its_tables_once_a_second() {
        let stage = Stage::start().await;
        let _telescope = telescope(&stage, "callisto").await;
        let mut socket = Socket::open(&stage, "/ws", "").await.unwrap_or_else(|status| panic!("{status}"));
        socket.until(|tables| tables["table0"].as_array().is_some_and(|rows| rows.len() == 8)).await;
        let started = std::time::Instant::now();
        for _ in 0..3 {
            assert!(socket.recv().await["table0"].is_array());
        }
        let took = started.elapsed();
        assert!(took > Duration::from_secs(2) && took < Duration::from_secs(6), "one per second: {took:?}");
        stage.end().await;
    }
}
