use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpListener;

use super::*;
use crate::can;

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
    let mount = device(&address.await, Kind::Telescope);
    assert_eq!(can(&mount, "canpark").await, Ok(true));
    let foreign = server(|_, id| envelope(&json!(false), i64::from(id) + 1)).await;
    assert!(can(&device(&foreign, Kind::Telescope), "canpark").await.unwrap_err().is_foreign());
}
