//! The page, its check of access, the image and the live socket, over real HTTP and a real bus.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test ends where its stage breaks")]

mod stage;

use std::time::Duration;

use axum::routing::get;
use bus::Quality::{Event, State};
use contract::device::camera::{Frame, Pixel, Purpose};
use contract::node::{DiaryLine, Level};
use contract::{CommandId, Key, Kind, NodeTopic, Part, Role};
use serde_json::{Value, json};
use stage::{Stage, address, sample};
use test_support::serve;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

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
    for name in ["style.css", "app.js", "favicon.svg"] {
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
    for path in ["/api/v1/nothing", "/assets/../Cargo.toml", "/t/A/b/c", "/api/v1/telescopes/paranal/europa"] {
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
async fn the_network_and_a_telescope_are_told_in_full_but_no_spool_url() {
    let stage = Stage::start().await;
    let name = "mount".parse().unwrap();
    let device = address("callisto").device(Kind::Telescope, &name);
    stage.say(Key::State(device), State { cache: 1 }, sample("telescope.state")).await;
    stage
        .say(Key::Observatory(address("callisto"), Part::Night), State { cache: 1 }, sample("observatory.night"))
        .await;
    stage
        .say(Key::Observatory(address("callisto"), Part::Safety), State { cache: 1 }, sample("observatory.safety"))
        .await;
    let camera = address("callisto").device(Kind::Camera, &"andor".parse().unwrap());
    stage.say(Key::Frame(camera), Event { cache: 10 }, sample("camera.frame")).await;
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
        (&json!("open"), &json!(1)),
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
    stage.say(Key::Frame(camera), Event { cache: 10 }, frame).await;
    let shown = stage
        .until("/api/v1/telescopes/paranal/callisto", |answer| answer["summary"]["image"]["frame"] == id.0.as_str())
        .await;
    assert_eq!(shown["summary"]["image"]["object"], "M 31");
    let image = stage.http.get(format!("{}{path}", stage.url)).send().await.unwrap();
    assert_eq!(image.headers()["content-type"], "image/jpeg");
    let tag = image.headers()["etag"].clone();
    assert_eq!(tag, format!("\"{id}\""));
    assert_eq!(image.bytes().await.unwrap()[..3], [0xFF, 0xD8, 0xFF]);
    let again = stage.http.get(format!("{}{path}", stage.url)).header("if-none-match", tag).send().await.unwrap();
    assert_eq!(again.status().as_u16(), 304);
    stage.end().await;
}

/// A WebSocket client of a few lines: it receives text frames and sends short ones.
struct Socket(TcpStream);

impl Socket {
    async fn open(stage: &Stage, path: &str, origin: &str) -> Result<Self, u16> {
        let mut stream = TcpStream::connect(stage.authority()).await.unwrap();
        let host = stage.authority();
        let ask = format!(
            "GET {path} HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        );
        stream.write_all(ask.as_bytes()).await.unwrap();
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            head.push(stream.read_u8().await.unwrap());
        }
        match String::from_utf8_lossy(&head[9..12]).parse::<u16>().unwrap() {
            101 => Ok(Self(stream)),
            status => Err(status),
        }
    }

    async fn hear(&mut self) -> Value {
        let [first, short] = [self.0.read_u8().await.unwrap(), self.0.read_u8().await.unwrap()];
        assert_eq!(first, 0x81, "one whole text frame, unmasked");
        let length = match short {
            126 => u64::from(self.0.read_u16().await.unwrap()),
            127 => self.0.read_u64().await.unwrap(),
            short => u64::from(short),
        };
        let mut text = vec![0; usize::try_from(length).unwrap()];
        self.0.read_exact(&mut text).await.unwrap();
        serde_json::from_slice(&text).unwrap()
    }

    async fn until(&mut self, wanted: impl Fn(&Value) -> bool) -> Value {
        let looked = async {
            loop {
                let said = self.hear().await;
                if wanted(&said) {
                    return said;
                }
            }
        };
        tokio::time::timeout(Duration::from_secs(10), looked).await.unwrap()
    }

    async fn say(&mut self, text: &str) {
        // Clients mask; a mask of zeros is one too.
        let mut frame = vec![0x81, 0x80 | u8::try_from(text.len()).unwrap(), 0, 0, 0, 0];
        frame.extend(text.as_bytes());
        self.0.write_all(&frame).await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_gets_a_snapshot_then_changes_then_beats() {
    let stage = Stage::start().await;
    let device = address("callisto").device(Kind::Dome, &"dome_1".parse().unwrap());
    let key = "paranal/callisto/device/dome/dome_1/state";
    let publisher = stage.say(Key::State(device), State { cache: 1 }, sample("dome.state")).await;
    stage.until("/api/v1/telescopes/paranal/callisto", |answer| answer["states"][key].is_object()).await;
    let mut page = Socket::open(&stage, "/api/v1/ws", &stage.url).await.unwrap();
    let snap = page.hear().await;
    assert_eq!((&snap["op"], &snap["watch"]), (&json!("snap"), &Value::Null));
    assert_eq!(snap["net"][0]["id"], "paranal/callisto");
    assert!(snap.get("states").is_none(), "the overview needs tiles only");
    page.say(r#"{"op":"watch","telescope":"paranal/callisto"}"#).await;
    let snap = page.until(|said| said["op"] == "snap").await;
    assert_eq!(snap["states"][key]["body"]["fields"]["shutter"], "open");
    let mut closed = sample("dome.state");
    closed["fields"]["shutter"] = json!("closed");
    publisher.put(closed.clone()).await.unwrap();
    page.until(|said| said["states"][key]["body"]["fields"]["shutter"] == "closed").await;
    publisher.put(closed).await.unwrap();
    let repeat = page.until(|said| said["again"][key].is_array()).await;
    assert!(repeat["states"][key].is_null());
    page.until(|said| said["op"] == "beat" && said["server_time_utc"].is_string()).await;
    let line =
        DiaryLine { level: Level::Warn, target: "t".into(), message: "a cloud".into(), fields: Default::default() };
    let diary = Key::Node(address("callisto"), Role::Device, "main".parse().unwrap(), NodeTopic::Diary);
    stage.say(diary, Event { cache: 10 }, line).await;
    let said = page.until(|said| said["log"].is_array()).await;
    assert_eq!((&said["log"][0]["message"], &said["log"][0]["level"]), (&json!("a cloud"), &json!("warn")));
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_from_elsewhere_opens_no_socket() {
    let stage = Stage::start().await;
    for origin in ["http://evil.example", "null", "http://127.0.0.1:1"] {
        assert_eq!(Socket::open(&stage, "/api/v1/ws", origin).await.err(), Some(403), "{origin}");
    }
    assert!(Socket::open(&stage, "/api/v1/ws", &stage.url).await.is_ok());
    stage.end().await;
}
