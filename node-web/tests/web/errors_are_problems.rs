//! Whatever is wrong with a request, the answer is a problem document in plain sentences.

use serde_json::json;

use crate::stage::Stage;
use crate::stage::raw::exchange;

#[tokio::test(flavor = "multi_thread")]
async fn no_error_of_the_api_is_plain_text_and_each_names_what_was_expected() {
    let stage = Stage::start().await;
    let jsonl = "Content-Type: application/jsonl\r\n";
    let json_type = "Content-Type: application/json\r\n";
    let commands = "POST /api/v1/telescopes/paranal/callisto/commands";
    for (ask, headers, body, status, words) in [
        ("GET /api/v1/telescopes/%FF/callisto", "", &b""[..], 404, "UTF-8"),
        ("GET /api/v1/telescopes/paranal/%FF/schedule/drafts/a", "", b"", 404, "UTF-8"),
        ("GET /api/v1/telescopes/paranal/callisto/schedule/drafts/%2e%2e", "", b"", 404, ""),
        ("GET /api/v1/alerts?priority=loud", "", b"", 400, "no such word as \"loud\""),
        (
            "GET /api/v1/alerts?colour=red",
            "",
            b"",
            400,
            "colour: there is no such member; expected one of telescope, priority.",
        ),
        ("GET /api/v1/commands?limit=-1", "", b"", 400, "limit: expected a whole number, 0 or more."),
        ("GET /api/v1/telescopes/paranal/callisto/frames?limit=a", "", b"", 400, "limit: expected a whole number"),
        (
            "GET /api/v1/telescopes/paranal/callisto/image.jpg?camera=a&camera=b",
            "",
            b"",
            400,
            "camera: it is given twice",
        ),
        ("GET /api/heartbeat?telescope=a&telescope=b", "", b"", 400, "telescope: it is given twice"),
        ("GET /api/log?limit=x", "", b"", 400, "limit: expected a whole number"),
        (commands, json_type, b"{", 400, "The body is no JSON: line 1"),
        (commands, json_type, b"", 400, "The body is empty"),
        (commands, json_type, b"\xff{}", 400, "no UTF-8 from byte 0"),
        (commands, json_type, b"{}", 422, "command: it is missing."),
        (commands, json_type, b"{\"command\": 7}", 422, "command: expected a text, found 7."),
        (commands, json_type, b"[]", 422, "expected an object"),
        (commands, jsonl, b"{}", 415, "application/json"),
        ("POST /api/v1/login", json_type, b"{\"name\": \"ana\"}", 422, "password: it is missing."),
        ("POST /api/v1/telescopes/paranal/callisto/schedule/validate", jsonl, b"\xff", 400, "no UTF-8 from byte 0"),
        (
            "POST /api/v1/telescopes/paranal/callisto/schedule/validate",
            json_type,
            b"{}",
            422,
            "expected a list, found an object",
        ),
        (
            "POST /api/v1/telescopes/paranal/callisto/schedule/validate",
            "Content-Type: text/plain\r\n",
            b"x",
            415,
            "application/json",
        ),
        ("PUT /api/v1/network", json_type, b"{}", 405, "PUT is not answered"),
        ("GET /api/v1/nothing", "", b"", 404, "/api/v1/nothing"),
        ("GET /api/v1/ws", "", b"", 400, ""),
    ] {
        let host = stage.authority();
        let head = format!(
            "{ask} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{headers}Content-Length: {}\r\n\r\n",
            body.len()
        );
        let mut bytes = head.into_bytes();
        bytes.extend(body);
        let answer = exchange_bytes(&stage, &bytes).await;
        assert_eq!(answer.status, status, "{ask}: {} {}", answer.head, answer.text);
        assert_eq!(answer.header("content-type"), Some("application/problem+json"), "{ask}: {}", answer.text);
        let problem = answer.json();
        let detail = problem["detail"].as_str().unwrap();
        assert!(detail.contains(words) && detail.ends_with('.'), "{ask}: {detail}");
        assert!(
            !detail.contains('`') && !detail.contains(" at line ") && !detail.contains("eserialize"),
            "{ask}: {detail}"
        );
        assert_eq!((&problem["status"], problem["type"].is_string()), (&json!(status), true));
    }
    stage.end().await;
}

async fn exchange_bytes(stage: &Stage, bytes: &[u8]) -> crate::stage::raw::Answer {
    let mut stream = stage.connect_from("127.0.0.1").await.unwrap();
    tokio::io::AsyncWriteExt::write_all(&mut stream, bytes).await.unwrap();
    exchange(stream, "").await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_is_ready_once_it_has_received_something_and_gives_its_version_to_everybody() {
    let folder = crate::stage::raw::with_users();
    let stage = Stage::start_with("", folder.path()).await;
    assert_eq!(stage.status("GET /healthz", "").await, 200);
    let early = stage.ask("GET /readyz", "", None).await;
    assert_eq!((early.status, &early.json()["code"]), (503, &json!("not-ready")), "{}", early.text);
    let version = stage.ask("GET /version", "", None).await;
    assert_eq!((version.status, &version.json()["api"]), (200, &json!("v1")), "{}", version.text);
    let night =
        serde_json::from_value::<contract::observatory::NightState>(crate::stage::sample("observatory.night")).unwrap();
    let key = contract::Key::Observatory(crate::stage::address("callisto"), contract::Part::Night);
    let _night = stage.publish(key, night).await;
    let ready = async {
        while stage.status("GET /readyz", "").await != 200 {
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(test_support::LIMIT, ready).await.unwrap();
    stage.end().await;
}
