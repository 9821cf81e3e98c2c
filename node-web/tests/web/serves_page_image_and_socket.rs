//! The page, its check of access, the image and the live socket, over real HTTP and a real bus.

use std::collections::{BTreeMap, BTreeSet};

use axum::routing::get;
use contract::device::camera::{Frame, Pixel, Purpose};
use contract::node::{DiaryLine, Level};
use contract::observatory::NightState;
use contract::{CommandId, Key, Kind, NodeTopic, Part, Role};
use serde_json::{Value, json};
use test_support::serve;

use crate::stage::socket::Socket;
use crate::stage::{Stage, address, sample};

#[tokio::test(flavor = "multi_thread")]
async fn the_page_is_served_whole_and_only_under_our_own_names() {
    let stage = Stage::start().await;
    let page = stage.http.get(&stage.url).send().await.unwrap();
    let policy = page.headers()["content-security-policy"].to_str().unwrap().to_owned();
    assert!(policy.contains("default-src 'self'") && policy.contains("frame-ancestors 'none'"), "{policy}");
    assert_eq!(page.headers()["x-content-type-options"], "nosniff");
    let html = page.text().await.unwrap();
    let telescope = stage.http.get(format!("{}/t/paranal/callisto", stage.url)).send().await.unwrap();
    assert_eq!(telescope.text().await.unwrap(), html, "one page for both addresses");
    for name in ["starmesh.css", "app.js", "pages/network.js", "vendor/preact.js", "favicon.svg"] {
        let asset = stage.http.get(format!("{}/assets/{name}", stage.url)).send().await.unwrap();
        assert!(asset.status().is_success(), "{name}");
        let tag = asset.headers()["etag"].clone();
        let again = stage.http.get(format!("{}/assets/{name}", stage.url)).header("if-none-match", tag);
        assert_eq!(again.send().await.unwrap().status().as_u16(), 304, "{name}");
    }
    let foreign = stage.http.get(&stage.url).header("host", "evil.example").send().await.unwrap();
    assert_eq!(foreign.status().as_u16(), 421);
    let named = stage.http.get(&stage.url).header("host", "localhost:1234").send().await.unwrap();
    assert!(named.status().is_success());
    for path in ["/api/v1/nothing", "/assets/../Cargo.toml", "/t/paranal", "/api/v1/telescopes/paranal/europa"] {
        let (status, problem) = stage.get(path).await;
        assert_eq!((status.as_u16(), &problem["status"]), (404, &json!(404)), "{path}");
    }
    let post = stage.http.post(format!("{}/api/v1/network", stage.url)).send().await.unwrap();
    assert_eq!(post.headers()["content-type"], "application/problem+json");
    assert_eq!(post.status().as_u16(), 405);
    let (status, health) = stage.get("/healthz").await;
    assert_eq!((status.as_u16(), &health["ok"]), (200, &json!(true)));
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_network_and_a_telescope_are_answered_in_full_but_no_spool_url() {
    let stage = Stage::start().await;
    let name = "mount".parse().unwrap();
    let device = address("callisto").device(Kind::Telescope, &name);
    let _mount = stage.publish(Key::State(device), sample("telescope.state")).await;
    let _night = stage.publish(Key::Observatory(address("callisto"), Part::Night), sample("observatory.night")).await;
    let _safety =
        stage.publish(Key::Observatory(address("callisto"), Part::Safety), sample("observatory.safety")).await;
    let camera = address("callisto").device(Kind::Camera, &"andor".parse().unwrap());
    let _frame = stage.publish(Key::Frame(camera), sample("camera.frame")).await;
    let is_whole = |answer: &Value| {
        answer["states"]["paranal/callisto/device/camera/andor/frame"].is_object()
            && answer["summary"]["safety"]["state"] == "unsafe"
            && answer["states"]["paranal/callisto/device/telescope/mount/state"].is_object()
    };
    let whole = stage.until("/api/v1/telescopes/paranal/callisto", is_whole).await;
    let mount = &whole["states"]["paranal/callisto/device/telescope/mount/state"];
    assert_eq!(mount["body"]["readings"]["Altitude"]["value"], 61.2841);
    assert!(mount["age_s"].as_f64().unwrap() < 20.0 && mount["period_s"] == 1.0);
    assert!(!whole.to_string().contains("token="), "the spool's one-frame token stays here");
    let (_, network) = stage.get("/api/v1/network").await;
    let callisto = &network["telescopes"][0];
    assert_eq!((&callisto["id"], &callisto["mode"]), (&json!("paranal/callisto"), &json!("robotic")));
    assert_eq!(
        (&callisto["posture"], &callisto["concern"]),
        (&json!("open"), &json!("critical")),
        "open for 10 min while unsafe"
    );
    let roles: Vec<&Value> = callisto["nodes"].as_array().unwrap().iter().map(|node| &node["role"]).collect();
    assert_eq!(roles, [&json!("web")]);
    stage.end().await;
}

/// A spool that serves one small frame: a ramp, with one bright star.
async fn spool(width: u32, height: u32) -> String {
    let pixels: Vec<u8> = (0..width * height)
        .flat_map(|i| if i == width * 5 + 5 { u16::MAX } else { (i % width) as u16 + 500 }.to_le_bytes())
        .collect();
    let app = axum::Router::new().route("/frame/x", get(move || std::future::ready(pixels.clone())));
    format!("http://{}/frame/x?token=y", serve(app).await)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_becomes_an_image_under_its_own_id() {
    let stage = Stage::start().await;
    let path = "/api/v1/telescopes/paranal/callisto/image.jpg";
    assert_eq!(stage.get(path).await.0.as_u16(), 404, "none before the first frame");
    let id = CommandId::fresh();
    let frame = Frame {
        id: id.clone(),
        camera: "andor".into(),
        purpose: Purpose { object: Some("M 31".into()), image_type: "Light Frame".into(), ..Purpose::default() },
        width_px: 2100,
        height_px: 300,
        planes: 1,
        pixel: Pixel::U16,
        bin: 1,
        origin_px: [0, 0],
        started_utc: units::Utc::EPOCH,
        exposure_s: 1.0,
        url: spool(2100, 300).await,
        bytes: 2100 * 300 * 2,
        sha256: String::new(),
        readings: Default::default(),
    };
    let camera = address("callisto").device(Kind::Camera, &"andor".parse().unwrap());
    let _frame = stage.publish(Key::Frame(camera), frame).await;
    let answer = stage
        .until("/api/v1/telescopes/paranal/callisto", |answer| answer["summary"]["image"]["frame"] == id.0.as_str())
        .await;
    assert_eq!(answer["summary"]["image"]["object"], "M 31");
    let image = stage.http.get(format!("{}{path}", stage.url)).send().await.unwrap();
    assert_eq!(image.headers()["content-type"], "image/jpeg");
    let tag = image.headers()["etag"].clone();
    assert_eq!(tag, format!("\"{id}\""));
    assert_eq!(image.bytes().await.unwrap()[..3], [0xFF, 0xD8, 0xFF]);
    let again = stage.http.get(format!("{}{path}", stage.url)).header("if-none-match", tag).send().await.unwrap();
    assert_eq!(again.status().as_u16(), 304);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_gets_a_snapshot_then_changes_then_beats() {
    let stage = Stage::start().await;
    let device = address("callisto").device(Kind::Dome, &"dome_1".parse().unwrap());
    let key = "paranal/callisto/device/dome/dome_1/state";
    let publisher = stage.publish(Key::State(device), sample("dome.state")).await;
    stage.until("/api/v1/telescopes/paranal/callisto", |answer| answer["states"][key].is_object()).await;
    let mut page = Socket::open(&stage, "/api/v1/ws", &format!("Origin: {}\r\n", stage.url)).await.unwrap();
    let welcome = page.recv().await;
    assert_eq!((&welcome["op"], &welcome["data"]["heartbeat_s"]), (&json!("welcome"), &json!(1.0)));
    page.send(r#"{"op":"sub","topics":["net"]}"#).await;
    let snap = page.until(|message| message["op"] == "snap").await;
    assert!(snap["data"]["items"]["paranal/callisto"].is_object(), "{snap}");
    page.send(r#"{"op":"sub","topics":["tel/paranal/callisto","log?level=warn"]}"#).await;
    let of =
        |topic: &'static str, op: &'static str| move |message: &Value| message["op"] == op && message["topic"] == topic;
    let snap = page.until(of("tel/paranal/callisto", "snap")).await;
    assert_eq!(snap["data"]["states"][key]["body"]["fields"]["shutter"], "open");
    let mut closed = sample("dome.state");
    closed["fields"]["shutter"] = json!("closed");
    publisher.put(closed.clone());
    page.until(|message| message["data"]["states"][key]["body"]["fields"]["shutter"] == "closed").await;
    publisher.put(closed);
    let repeat = page.until(|message| message["data"]["again"][key].is_array()).await;
    assert!(repeat["data"]["states"][key].is_null());
    page.until(|message| message["op"] == "beat" && message["at_utc"].is_string()).await;
    let line =
        DiaryLine { level: Level::Warn, target: "t".into(), message: "a cloud".into(), fields: Default::default() };
    let diary = Key::Node(address("callisto"), Role::Device, "main".parse().unwrap(), NodeTopic::Diary);
    // It happens once.
    let diary = stage.bus.publisher::<DiaryLine>(&diary).await.unwrap();
    diary.put(line).await.unwrap();
    let message = page.until(of("log?level=warn", "event")).await;
    assert_eq!((&message["data"][0]["message"], &message["data"][0]["level"]), (&json!("a cloud"), &json!("warn")));
    // A second socket goes on before this line: what else changed meanwhile has later numbers.
    let resume = json!({"op": "sub", "topics": ["log?level=warn"], "resume": {
        "session": welcome["data"]["session"], "seq": {"log?level=warn": message["data"][0]["number"].as_u64().unwrap() - 1}}});
    let mut again = Socket::open(&stage, "/api/v1/ws", &format!("Origin: {}\r\n", stage.url)).await.unwrap();
    again.send(&resume.to_string()).await;
    assert_eq!(again.until(of("log?level=warn", "event")).await["data"], message["data"]);
    page.send(r#"{"op":"unsub","topics":["net"]}"#).await;
    page.send(r#"{"op":"ping","t":7}"#).await;
    assert_eq!(page.until(|message| message["op"] == "pong").await["data"]["t"], 7);
    page.until(|message| {
        assert_ne!(message["topic"], "net", "it was ended");
        message["op"] == "beat"
    })
    .await;
    for wrong in [r#"{"op":"sub","topics":["nets"]}"#, r#"{"op":"watch"}"#, "[", r#"{"op":"sub","topics":[1]}"#] {
        page.send(wrong).await;
        let refused = page.until(|message| message["op"] == "err").await;
        assert!(refused["data"]["detail"].as_str().unwrap().contains("expected"), "{refused}");
    }
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn each_topic_is_answered_those_too_that_are_too_many() {
    let stage = Stage::start().await;
    let mut page = Socket::open(&stage, "/api/v1/ws", &format!("Origin: {}\r\n", stage.url)).await.unwrap();
    let welcome = page.recv().await;
    assert_eq!(welcome["data"]["most_topics"], 256);
    let topics: Vec<String> = (0..300).map(|i| format!("tel/paranal/callisto/device/camera/c{i}")).collect();
    let seq: BTreeMap<&String, u64> = topics.iter().map(|topic| (topic, 1)).collect();
    let sub = json!({"op": "sub", "topics": topics, "resume": {"session": "of before", "seq": seq}});
    page.send(&sub.to_string()).await;
    let mut answers: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
    while answers.values().map(BTreeSet::len).sum::<usize>() < topics.len() {
        let answer = page.until(|message| message["op"] == "snap" || message["op"] == "err").await;
        let op = if answer["op"] == "snap" { "snap" } else { "err" };
        let detail = answer["data"]["detail"].as_str().unwrap_or_default();
        assert!(op == "snap" || detail.contains("may have 256 topics"), "{answer}");
        assert!(answers.entry(op).or_default().insert(answer["topic"].as_str().unwrap().to_owned()), "{answer}");
    }
    assert_eq!((answers["snap"].len(), answers["err"].len()), (256, 44));
    assert!(topics.iter().all(|topic| answers.values().any(|of| of.contains(topic))));
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_from_elsewhere_opens_no_socket() {
    let stage = Stage::start().await;
    for origin in ["http://evil.example", "null", "http://127.0.0.1:1"] {
        assert_eq!(
            Socket::open(&stage, "/api/v1/ws", &format!("Origin: {origin}\r\n")).await.err(),
            Some(403),
            "{origin}"
        );
    }
    assert!(Socket::open(&stage, "/api/v1/ws", &format!("Origin: {}\r\n", stage.url)).await.is_ok());
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pictures_of_exactly_the_configured_webcams_may_be_shown() {
    let webcams = "[[web.webcam]]\nname = \"All-sky\"\nurl = \"https://allsky.example.org:8443/latest.jpg?x=1\"\n\
                   [[web.webcam]]\nname = \"Dome\"\nurl = \"http://10.0.0.9/cam\"\ntelescope = \"callisto\"\nperiod_s = 5\n\
                   [[web.webcam]]\nname = \"Elsewhere\"\nurl = \"http://10.0.0.9/other\"\nsite = \"teide\"\n";
    let stage = Stage::start_alone(webcams).await;
    let night: NightState = serde_json::from_value(sample("observatory.night")).unwrap();
    let _night = stage.publish(Key::Observatory(address("callisto"), Part::Night), night).await;
    let page = stage.http.get(&stage.url).send().await.unwrap();
    let policy = page.headers()["content-security-policy"].to_str().unwrap().to_owned();
    let images = policy.split("; ").find(|part| part.starts_with("img-src")).unwrap();
    assert_eq!(images, "img-src 'self' http://10.0.0.9 https://allsky.example.org:8443", "{policy}");
    assert!(policy.contains("default-src 'self'") && policy.contains("frame-ancestors 'none'"), "{policy}");
    let network = stage.until("/api/v1/network", |network| network["webcams"] != json!([])).await;
    let all_sky = json!({"name": "All-sky", "url": "https://allsky.example.org:8443/latest.jpg?x=1", "site_id": "paranal", "period_s": 60.0});
    let dome = json!({"name": "Dome", "url": "http://10.0.0.9/cam", "site_id": "paranal", "telescope_id": "callisto", "period_s": 5.0});
    assert_eq!(network["webcams"], json!([all_sky, dome]), "nothing of the other site is known here");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_sky_above_a_telescope_is_worked_out_for_any_moment() {
    let stage = Stage::start().await;
    let night: NightState = serde_json::from_value(sample("observatory.night")).unwrap();
    let _night = stage.publish(Key::Observatory(address("callisto"), Part::Night), night).await;
    let path = "/api/v1/telescopes/paranal/callisto/sky";
    let now = stage.until(path, |sky| sky["sun"].is_object()).await;
    assert!(now["horizon"].is_null() && now["at_utc"].is_string(), "this file has no mount: {now}");
    let (status, sky) = stage.get(&format!("{path}?at_utc=2026-11-21T03:00:00Z")).await;
    assert!(status.is_success() && sky["night"]["date"] == "20261120", "{sky}");
    let deg = |pointer: &str| sky.pointer(pointer).and_then(Value::as_f64).unwrap();
    assert!(deg("/sun/altitude_deg") < -18.0 && (0.0..360.0).contains(&deg("/sidereal_time_deg")), "{sky}");
    for wrong in ["at_utc=midnight", "at=2026-11-21T03:00:00Z"] {
        assert_eq!(stage.get(&format!("{path}?{wrong}")).await.0.as_u16(), 400, "{wrong}");
    }
    let (status, problem) = stage.get(&format!("{path}?at_utc=1900-01-01T00:00:00Z")).await;
    assert_eq!((status.as_u16(), &problem["code"]), (422, &json!("validation")), "{problem}");
    stage.end().await;
}
