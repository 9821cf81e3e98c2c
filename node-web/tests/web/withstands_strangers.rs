//! The page withstands unknown programs on the bus and on the network: nonsense, floods, half requests and many
//! sockets.

use std::net::SocketAddr;
use std::time::Duration;

use contract::{Key, Kind, Part};
use serde_json::{Value, json};
use test_support::LIMIT;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpSocket, TcpStream};

use crate::stage::{Stage, address, sample};

#[tokio::test(flavor = "multi_thread")]
async fn a_field_of_a_wrong_type_is_reported_and_never_displayed() {
    let stage = Stage::start().await;
    let key = Key::Observatory(address("callisto"), Part::Safety);
    let name = "paranal/callisto/observatory/safety/state";
    let publisher = stage.publish(key, sample("observatory.safety")).await;
    let path = "/api/v1/telescopes/paranal/callisto";
    stage.until(path, |answer| answer["states"][name].is_object()).await;
    for (field, wrong) in [
        ("verdict", json!({"tag": "script", "attrs": {"src": "http://evil.example"}, "children": []})),
        ("reasons", json!("rain")),
        ("since_utc", json!(17)),
    ] {
        let mut spoilt = sample("observatory.safety");
        spoilt[field] = wrong.clone();
        publisher.put(spoilt);
        let answer = stage.until(path, |answer| answer["summary"]["unreadable"][0]["key"] == name).await;
        assert_ne!(answer["states"][name]["body"][field], wrong, "{field}");
        publisher.put(sample("observatory.safety"));
        stage.until(path, |answer| answer["summary"]["unreadable"].is_null()).await;
    }
    // A writer that sends nothing else: the value that is shown is old, and is marked as old.
    let mut spoilt = sample("observatory.safety");
    spoilt["verdict"] = json!("splendid");
    publisher.put(spoilt);
    stage.until(path, |answer| answer["summary"]["safety"]["state"] == "unknown").await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_keys_leaves_the_telescope_on_the_page() {
    let stage = Stage::start().await;
    for i in 0..3000 {
        let device = contract::Address::new(&format!("s{}", i % 300), "t").unwrap();
        let key = Key::State(device.device(Kind::Switch, &format!("n{i}").parse().unwrap()));
        // A late joiner is answered by the publisher: it is dropped, and its key is gone from the bus.
        let publisher = stage.bus.publisher_as::<serde_json::Value>(&key, bus::Quality::Urgent).await.unwrap();
        publisher.put(sample("switch.state")).await.unwrap();
    }
    let key = Key::Observatory(address("callisto"), Part::Night);
    let _night = stage.publish(key, sample("observatory.night")).await;
    let is_there = |answer: &Value| answer["states"]["paranal/callisto/observatory/night/state"].is_object();
    stage.until("/api/v1/telescopes/paranal/callisto", is_there).await;
    let network = stage.get("/api/v1/network").await.1;
    assert!(network["telescopes"].as_array().unwrap().len() <= 200);
    stage.end().await;
}

/// A connection that comes from another address of this host, as from another host.
async fn connect_from(source: &str, stage: &Stage) -> std::io::Result<TcpStream> {
    let socket = TcpSocket::new_v4()?;
    socket.bind(SocketAddr::new(source.parse().unwrap(), 0))?;
    socket.connect(stage.authority().parse().unwrap()).await
}

/// Opens a live socket; `None` where it is refused or the connection is closed.
async fn open_socket(source: &str, stage: &Stage) -> Option<TcpStream> {
    let mut stream = connect_from(source, stage).await.ok()?;
    let ask = format!(
        "GET /api/v1/ws HTTP/1.1\r\nHost: {}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
        stage.authority()
    );
    stream.write_all(ask.as_bytes()).await.ok()?;
    let mut head = [0; 12];
    tokio::time::timeout(LIMIT, stream.read_exact(&mut head)).await.ok()?.ok()?;
    (&head == b"HTTP/1.1 101").then_some(stream)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_thousand_sockets_of_one_address_lock_nobody_else_out() {
    let stage = Stage::start().await;
    let mut held = Vec::new();
    for _ in 0..1000 {
        held.extend(open_socket("127.0.0.2", &stage).await);
    }
    assert!((10..=100).contains(&held.len()), "one address has {} sockets", held.len());
    for source in ["127.0.0.1", "127.0.0.3"] {
        assert!(open_socket(source, &stage).await.is_some(), "no socket is left for {source}");
    }
    let (status, _) = stage.get("/healthz").await;
    assert!(status.is_success());
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn half_requests_hold_nobody_up_and_are_gone_after_seconds() {
    let stage = Stage::start().await;
    let mut held = Vec::new();
    for _ in 0..1500 {
        if let Ok(mut stream) = connect_from("127.0.0.2", &stage).await {
            let _ = stream.write_all(b"GET / HTTP/1.1\r\nHost: ").await;
            held.push(stream);
        }
    }
    let (status, _) = stage.get("/healthz").await;
    assert!(status.is_success(), "another address is served meanwhile");
    let ask = format!("GET /healthz HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", stage.authority());
    let asked = async {
        loop {
            let mut answer = String::new();
            if let Ok(mut again) = connect_from("127.0.0.2", &stage).await {
                let _ = again.write_all(ask.as_bytes()).await;
                let _ = again.read_to_string(&mut answer).await;
            }
            if answer.starts_with("HTTP/1.1 200") {
                return;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    let gone = tokio::time::timeout(LIMIT, asked).await;
    assert!(gone.is_ok(), "the half requests still hold their places");
    drop(held);
    stage.end().await;
}
