//! What gets past the question who asks, or uses up what others need: odd paths and headers, foreign pages, floods.

use std::time::Instant;

use test_support::LIMIT;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::stage::Stage;
use crate::stage::raw::{PASSWORD, with_users};

#[tokio::test(flavor = "multi_thread")]
async fn no_notation_of_a_path_and_no_header_gets_past_the_question() {
    let folder = with_users();
    let stage = Stage::start_with("requests_per_s = 1000", folder.path()).await;
    let host = stage.authority().to_owned();
    for target in [
        "/%61pi/v1/network",
        "//api/v1/network",
        "/API/v1/network",
        "/api/v1/../v1/network",
        "/healthz/../api/v1/network",
        "/assets/../api/v1/network",
        "/assets/login.js/../../api/v1/network",
        "/assets/%2e%2e/api/v1/network",
        "/assets/..%2fapi/v1/network",
        "/api/v1/network/",
        "/api/v1/network;/healthz",
        "/api/v1/network%00",
        "/api/v1/network?/healthz",
        "/api/heartbeat/../v1/network",
        "/t/../api/v1/network",
        "/t/..%2f..%2fapi%2fv1%2fnetwork",
        "/./api/v1/network",
        "/api//v1/network",
        "/api/v1/network#/healthz",
        "/api/v1/ws?ticket=",
        "/api/v1/ws?ticket=x&ticket=y",
        "/api/v1/network?ticket=x",
        "*",
        &format!("http://{host}/api/v1/network"),
        "http://evil.example/healthz",
        "http://evil.example/api/v1/network",
        &format!("http://ana@{host}/api/v1/network"),
    ] {
        for method in ["GET", "HEAD", "get", "POST", "TRACE"] {
            let text = format!("{method} {target} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
            let answer = stage.raw(&text).await;
            assert!(matches!(answer.status, 400..=499), "{method} {target}: {} {}", answer.head, answer.text);
            assert!(!answer.text.contains("server_time_utc"), "{method} {target}");
        }
    }
    assert_eq!(
        stage
            .raw(&format!("GET http://{host}/healthz HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"))
            .await
            .status,
        200
    );
    let ana = stage.session("ana").await;
    let cookie = ana.trim_end();
    for (headers, status) in [
        (format!("{cookie}\r\n{cookie}\r\n"), 400),
        (format!("Host: evil.example\r\n{ana}"), 400),
        (format!("{ana}Authorization: Bearer a\r\nAuthorization: Bearer b\r\n"), 400),
        (format!("{ana}Origin: http://{host}\r\nOrigin: http://evil.example\r\n"), 400),
        (format!("X-Remote-User: eve\r\nX-Remote-User: ana\r\n{ana}"), 400),
        (format!(" {ana}"), 400),
        (format!("Cookie : {}", &cookie[8..]), 400),
        ("X-Original-URL: /healthz\r\nX-Rewrite-URL: /healthz\r\nX-HTTP-Method-Override: GET\r\n".to_owned(), 401),
        (ana.clone(), 200),
    ] {
        let answer = stage.ask("GET /api/v1/network", &headers, None).await;
        assert_eq!(answer.status, status, "{headers}: {}", answer.head);
    }
    // A second request that hides in the body of the first.
    let inner = format!("GET /api/v1/network HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
    for lengths in [
        format!("Content-Length: {}\r\nTransfer-Encoding: chunked\r\n", inner.len() + 5),
        "Content-Length: 0\r\nContent-Length: 5\r\n".to_owned(),
        "Transfer-Encoding: xchunked\r\n".to_owned(),
        "Transfer-Encoding: chunked\r\n".to_owned(),
    ] {
        let text = format!("GET /healthz HTTP/1.1\r\nHost: {host}\r\n{lengths}\r\n0\r\n\r\n{inner}");
        let answer = stage.raw(&text).await;
        assert!(!format!("{}{}", answer.head, answer.text).contains("server_time_utc"), "{lengths}: {}", answer.text);
    }
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_foreign_page_commands_nothing_with_the_cookie_of_its_reader() {
    let folder = with_users();
    for users in [true, false] {
        let none = tempfile::tempdir().unwrap();
        let stage = Stage::start_with("requests_per_s = 1000", if users { folder.path() } else { none.path() }).await;
        let ana = if users { stage.session("ana").await } else { String::new() };
        let own = stage.url.clone();
        let (form, sent) = ("application/x-www-form-urlencoded", "a=1");
        for (headers, status) in [
            ("Origin: http://evil.example\r\n".to_owned(), 403),
            ("Origin: null\r\n".to_owned(), 403),
            ("Sec-Fetch-Site: cross-site\r\n".to_owned(), 403),
            (format!("Origin: {own}\r\nSec-Fetch-Site: same-site\r\n"), 403),
            (format!("Origin: {own}\r\nContent-Type: {form}\r\nContent-Length: 3\r\n"), 415),
            ("Content-Type: text/plain\r\n".to_owned(), 415),
            ("Content-Length: 3\r\n".to_owned(), 415),
            ("Transfer-Encoding: chunked\r\n".to_owned(), 415),
            (format!("Origin: {own}\r\nSec-Fetch-Site: same-origin\r\n"), 200),
            (String::new(), 200),
        ] {
            let body = if headers.contains("Length") {
                sent
            } else if headers.contains("chunked") {
                "0\r\n\r\n"
            } else {
                ""
            };
            let text = format!(
                "POST /api/v1/ws-ticket HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n{ana}{headers}\r\n{body}",
                stage.authority()
            );
            let answer = stage.raw(&text).await;
            assert_eq!(answer.status, status, "{headers}: {}", answer.text);
            assert_eq!(answer.header("access-control-allow-origin"), None);
        }
        stage.end().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_login_is_refused_with_a_problem() {
    let folder = with_users();
    let stage = Stage::start_with("", folder.path()).await;
    let send = async |body: &[u8]| {
        let head = format!(
            "POST /api/v1/login HTTP/1.1\r\nHost: {}\r\nConnection: close\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n",
            stage.authority(),
            body.len()
        );
        let mut stream = stage.connect_from("127.0.0.1").await.unwrap();
        stream.write_all(&[head.as_bytes(), body].concat()).await.unwrap();
        let mut answer = String::new();
        let _ = stream.read_to_string(&mut answer).await;
        answer
    };
    let long = format!("{{\"name\": \"ana\", \"password\": \"{}\"}}", "x".repeat(2000));
    let huge = format!("{{\"name\": \"ana\", \"password\": \"{}\"}}", "x".repeat(20_000));
    for (body, status) in [
        (&b""[..], "400"),
        (b"{", "400"),
        (b"\xff\xfe", "400"),
        (b"{\"name\": \"\xff\"}", "400"),
        (b"[]", "422"),
        (b"{}", "422"),
        (b"{\"name\": 7, \"password\": \"x\"}", "422"),
        (b"{\"name\": \"a\", \"password\": \"b\", \"c\": 1}", "422"),
        (b"{\"name\": \"a\", \"password\": null}", "422"),
        (long.as_bytes(), "401"),
        (huge.as_bytes(), "413"),
        (&vec![b'['; 10_000], "400"),
    ] {
        let answer = send(body).await;
        assert!(
            answer.starts_with(&format!("HTTP/1.1 {status}")) && answer.contains("application/problem+json"),
            "{answer}"
        );
    }
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_thousand_logins_at_once_neither_keep_an_operator_out_nor_burn_the_processor() {
    let folder = with_users();
    let stage = std::sync::Arc::new(Stage::start_with("", folder.path()).await);
    let (began, mut flood) = (Instant::now(), tokio::task::JoinSet::new());
    for number in 0..1000 {
        let stage = stage.clone();
        flood.spawn(async move {
            let source = format!("127.0.0.{}", 20 + number % 5);
            match tokio::time::timeout(LIMIT, stage.log_in_as("ana", "not the password", &source)).await {
                Ok(answer) => (answer.status, answer.header("retry-after").map(str::to_owned)),
                Err(_) => panic!("a login was not answered"),
            }
        });
    }
    let operator = tokio::time::timeout(LIMIT, stage.log_in_as("ana", PASSWORD, "127.0.0.1")).await.unwrap();
    assert_eq!(operator.status, 200, "{}", operator.text);
    let mut tried = 0;
    while let Some(answer) = flood.join_next().await {
        // 0: no place was free for one more connection of this address
        match answer.unwrap() {
            (401, _) => tried += 1,
            (429, Some(wait)) => assert!(wait.parse::<u64>().unwrap() >= 1),
            (0, _) => {}
            other => panic!("{other:?}"),
        }
    }
    // Each of five addresses gets one more in ten seconds.
    let most = 30 + began.elapsed().as_secs() / 2;
    assert!((5..=most).contains(&tried), "{tried} passwords were verified, at most {most}");
    assert_eq!(stage.log_in_as("ana", PASSWORD, "127.0.0.1").await.status, 200);
    let mut refused = stage.log_in_as("ana", PASSWORD, "127.0.0.20").await;
    for _ in 0..100 {
        if refused.status == 429 {
            break;
        }
        // So slow a machine gave that address another try.
        stage.log_in_as("ana", "not the password", "127.0.0.20").await;
        refused = stage.log_in_as("ana", PASSWORD, "127.0.0.20").await;
    }
    assert!(refused.status == 429 && refused.json()["retry_after_s"].as_u64().unwrap() <= 10, "{}", refused.text);
    std::sync::Arc::into_inner(stage).unwrap().end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn somebody_who_asks_too_often_waits_and_others_do_not() {
    let folder = with_users();
    let stage = Stage::start_with("requests_per_s = 2", folder.path()).await;
    let (ana, eve) = (stage.session("ana").await, stage.session("eve").await);
    let ask = async |headers: &str| stage.ask("GET /api/v1/me", headers, None).await;
    let mut last = ask(&ana).await;
    for _ in 0..100 {
        // At once, so that they are too many also where each takes long.
        let mut answers = futures_util::future::join_all((0..20).map(|_| ask(&ana))).await;
        if let Some(at) = answers.iter().position(|answer| answer.status != 200) {
            last = answers.swap_remove(at);
            break;
        }
    }
    assert!(last.status == 429 && last.header("retry-after") == Some("1"), "{} {}", last.head, last.text);
    assert_eq!(last.json()["code"], "rate-limited");
    assert_eq!(ask(&eve).await.status, 200);
    for _ in 0..50 {
        let page = stage.ask("GET /", &ana, None).await;
        assert_eq!(page.status, 200, "the page itself is always there");
    }
    stage.end().await;
}

/// Opens a socket; absent if it is refused.
async fn socket(stage: &Stage, target: &str, headers: &str) -> Option<TcpStream> {
    let mut stream = stage.connect_from("127.0.0.1").await.unwrap();
    let ask = format!(
        "GET {target} HTTP/1.1\r\nHost: {}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n{headers}\r\n",
        stage.authority()
    );
    stream.write_all(ask.as_bytes()).await.unwrap();
    let mut head = [0; 12];
    stream.read_exact(&mut head).await.ok()?;
    (&head == b"HTTP/1.1 101").then_some(stream)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_socket_needs_a_proof_and_ends_with_it() {
    let folder = with_users();
    let stage = Stage::start_with("", folder.path()).await;
    assert!(socket(&stage, "/api/v1/ws", "").await.is_none());
    let ana = stage.session("ana").await;
    let mut by_cookie = socket(&stage, "/api/v1/ws", &ana).await.unwrap();
    assert!(socket(&stage, "/api/v1/ws", &format!("{ana}Origin: http://evil.example\r\n")).await.is_none());
    let made = stage.ask("POST /api/v1/ws-ticket", &ana, None).await.json();
    assert_eq!(made["valid_s"], 30);
    let target = format!("/api/v1/ws?ticket={}", made["ticket"].as_str().unwrap());
    assert_eq!(
        stage.status(&format!("GET {}", target.replace("/ws?", "/network?")), "").await,
        401,
        "for sockets only"
    );
    let mut by_ticket = socket(&stage, &target, "").await.unwrap();
    assert!(socket(&stage, &target, "").await.is_none(), "a ticket works once");
    assert_eq!(stage.status("POST /api/v1/logout", &ana).await, 204);
    for stream in [&mut by_cookie, &mut by_ticket] {
        let mut rest = Vec::new();
        let ended = tokio::time::timeout(LIMIT, stream.read_to_end(&mut rest)).await;
        assert!(ended.is_ok(), "a socket goes on after its user has logged out");
    }
    stage.end().await;
}
