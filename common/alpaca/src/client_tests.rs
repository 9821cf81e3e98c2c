use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpListener;

use super::*;
use crate::{Abilities, value};

/// A server that answers request after request with the result of `answer` for its text and its transaction id.
async fn server(mut answer: impl FnMut(&str, u32) -> String + Send + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    tokio::spawn(async move {
        loop {
            let (mut stream, _) = listener.accept().await.unwrap();
            let (mut request, mut buffer) = (String::new(), [0; 4096]);
            // The requests of these tests are short, and a PUT's form comes with its head.
            while !request.contains("ClientTransactionID=") {
                let length = stream.read(&mut buffer).await.unwrap();
                request.push_str(std::str::from_utf8(&buffer[..length]).unwrap());
            }
            let id: String = request
                .split("ClientTransactionID=")
                .nth(1)
                .unwrap()
                .chars()
                .take_while(char::is_ascii_digit)
                .collect();
            let body = answer(&request, id.parse().unwrap());
            let head = format!("HTTP/1.1 200 OK\r\nContent-Length: {}\r\nConnection: close\r\n\r\n", body.len());
            stream.write_all(format!("{head}{body}").as_bytes()).await.unwrap();
        }
    });
    address
}

/// A server whose one answer comes with this header.
async fn server_with(header: &'static str) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    tokio::spawn(async move {
        let (mut stream, _) = listener.accept().await.unwrap();
        let mut buffer = [0; 4096];
        let length = stream.read(&mut buffer).await.unwrap();
        let request = std::str::from_utf8(&buffer[..length]).unwrap().to_ascii_lowercase();
        assert!(request.contains("cache-control: no-cache"), "{request}");
        let body = envelope(&json!(true), 0);
        let head = format!("HTTP/1.1 200 OK\r\nContent-Length: {}\r\n{header}Connection: close\r\n\r\n", body.len());
        stream.write_all(format!("{head}{body}").as_bytes()).await.unwrap();
    });
    address
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_cache_stored_is_no_answer() {
    for (header, is_taken) in [("", true), ("Age: 0\r\n", true), ("Age: 12\r\n", false), ("Age: soon\r\n", false)] {
        let address = server_with(header).await;
        let answer = device(&address, Kind::SafetyMonitor).get("issafe").await;
        assert_eq!(answer.is_ok(), is_taken, "{header:?}: {answer:?}");
        assert!(is_taken || answer.unwrap_err().to_string().starts_with("stale: "));
    }
}

fn envelope(value: &Value, id: i64) -> String {
    json!({"Value": value, "ClientTransactionID": id, "ServerTransactionID": 1, "ErrorNumber": 0, "ErrorMessage": ""})
        .to_string()
}

fn device(server: &str, kind: Kind) -> Alpaca {
    Alpaca::new(http_client().unwrap(), server, kind, 0).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_answer_to_another_request_counts_for_no_device() {
    for kind in Kind::ALL {
        let address = server(|_, id| envelope(&json!(1), i64::from(id) - 1)).await;
        let device = device(&address, kind);
        assert!(device.get("shutterstatus").await.unwrap_err().is_foreign(), "{kind}");
        let put = device.put("closeshutter", &[]).await.unwrap_err();
        assert!(put.is_foreign() && put.is_unknown_outcome(), "{kind}: it may have been done");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_returns_no_ids_can_be_used() {
    let address = server(|_, _| envelope(&json!(true), 0)).await;
    for kind in Kind::ALL {
        assert_eq!(device(&address, kind).get("issafe").await, Ok(json!(true)), "{kind}");
        assert_eq!(device(&address, kind).put("closeshutter", &[]).await, Ok(()), "{kind}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_capability_is_asked_again_when_its_answer_cannot_be_read() {
    let mut spoilt = 2;
    let address = server(move |_, id| {
        spoilt -= 1;
        if spoilt >= 0 { "{\"Value\":tr".to_owned() } else { envelope(&json!(true), i64::from(id)) }
    });
    let mut mount = Abilities::of(device(&address.await, Kind::Telescope));
    assert_eq!(mount.can("CanPark").await, Ok(true));
    assert!(mount.unread().is_empty());
    let foreign = server(|_, id| envelope(&json!(false), i64::from(id) + 1)).await;
    let mut foreign = Abilities::of(device(&foreign, Kind::Telescope));
    assert!(foreign.can("CanPark").await.unwrap_err().is_foreign());
}

#[tokio::test(flavor = "multi_thread")]
async fn only_a_denial_is_no_and_what_was_answered_is_not_asked_again() {
    let asked = std::sync::Arc::new(std::sync::Mutex::new(Vec::<String>::new()));
    let log = asked.clone();
    let address = server(move |request, id| {
        let member = request.split(['/', '?', ' ']).find(|part| part.starts_with("can") || part.starts_with("max"));
        log.lock().unwrap().push(member.unwrap().to_owned());
        let error =
            |number: u32| json!({"ErrorNumber": number, "ErrorMessage": "x", "ClientTransactionID": id}).to_string();
        match member.unwrap() {
            "canpark" => error(0x500),
            "cansync" => error(0x400),
            "maxstep" => envelope(&json!("many"), i64::from(id)),
            _ => envelope(&json!(false), i64::from(id)),
        }
    });
    let mut abilities = Abilities::of(device(&address.await, Kind::Telescope));
    for pass in 1..=2 {
        assert_eq!(abilities.can("CanPark").await, Ok(true), "not known, so that the device decides");
        assert_eq!(abilities.can("CanSync").await, Ok(false));
        assert_eq!(abilities.can("CanSlewAsync").await, Ok(false));
        assert!(abilities.read("MaxStep", value::whole).await.unwrap().is_err());
        assert_eq!(abilities.unread().keys().collect::<Vec<_>>(), ["CanPark", "MaxStep"], "pass {pass}");
        assert_eq!(abilities.unread()["CanPark"].0, "ascom 0x500: x");
    }
    let asked = asked.lock().unwrap();
    let times = |member: &str| asked.iter().filter(|asked| *asked == member).count();
    assert_eq!(["canpark", "cansync", "canslewasync", "maxstep"].map(times), [6, 1, 1, 6]);
}
