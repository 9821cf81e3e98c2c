//! Alerts reach browsers that have subscribed, each message encrypted for its browser, through a push service of the test.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU16, Ordering};
use std::sync::{Arc, Mutex};

use axum::Router;
use axum::body::Bytes;
use axum::http::{HeaderMap, StatusCode, Uri};
use contract::node::{NodeState, Stopped};
use contract::observatory::{Alert, AlertKind, Alerts};
use contract::{Key, NodeTopic, Part, Role};
use serde_json::{Value, json};
use test_support::{Browser, LIMIT, serve, within};

use crate::stage::raw::{Answer, add_user, change, with_users};
use crate::stage::{Stage, address};

/// What came to a push service.
struct Taken {
    path: String,
    headers: HeaderMap,
    body: Bytes,
}

/// A push service that remembers what it gets, and answers with one status.
struct PushService {
    at: SocketAddr,
    taken: Arc<Mutex<Vec<Taken>>>,
    answers: Arc<AtomicU16>,
}

impl PushService {
    async fn start() -> Self {
        let (taken, answers) = (Arc::<Mutex<Vec<Taken>>>::default(), Arc::new(AtomicU16::new(201)));
        let (keep, answer) = (taken.clone(), answers.clone());
        let take = async move |uri: Uri, headers: HeaderMap, body: Bytes| {
            keep.lock().unwrap().push(Taken { path: uri.path().to_owned(), headers, body });
            StatusCode::from_u16(answer.load(Ordering::Relaxed)).unwrap()
        };
        Self { at: serve(Router::new().fallback(take)).await, taken, answers }
    }

    /// The configuration of a server that may send here.
    fn named(&self) -> String {
        format!("push_services = [\"http://{}\"]\n", self.at)
    }

    fn endpoint(&self, path: &str) -> String {
        format!("http://{}{path}", self.at)
    }

    /// The next message that came for a path.
    async fn next(&self, path: &str) -> Taken {
        let found = within(LIMIT, || {
            let mut taken = self.taken.lock().unwrap();
            let at = taken.iter().position(|taken| taken.path == path)?;
            Some(taken.remove(at))
        });
        found.await.unwrap_or_else(|| panic!("nothing came to {path}"))
    }
}

async fn key_of(stage: &Stage, cookie: &str) -> Value {
    stage.ask("GET /api/v1/push", cookie, None).await.json()["key"].clone()
}

async fn subscribe(stage: &Stage, cookie: &str, endpoint: &str, browser: &Browser, more: Value) -> Answer {
    let [p256dh, auth] = browser.keys();
    let subscription =
        json!({ "endpoint": endpoint, "expirationTime": null, "keys": { "p256dh": p256dh, "auth": auth } });
    let mut body =
        json!({ "subscription": subscription, "key": key_of(stage, cookie).await, "device": "Firefox on Android" });
    body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    stage.ask("POST /api/v1/push/subscriptions", cookie, Some(&body)).await
}

fn listed(answer: &Value) -> Vec<String> {
    let devices = answer["devices"].as_array().unwrap_or_else(|| panic!("{answer}"));
    devices.iter().map(|one| one["user"].as_str().unwrap().to_owned()).collect()
}

fn list(alerts: &[Alert]) -> Alerts {
    Alerts { alerts: alerts.to_vec(), notifications: Vec::new() }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_alert_and_a_test_message_reach_browsers_until_their_push_service_says_that_they_are_gone() {
    let (service, folder) = (PushService::start().await, tempfile::tempdir().unwrap());
    let stage = Stage::start_with(&service.named(), folder.path()).await;
    let (phone, desk) = (Browser::new(), Browser::new());
    let made = subscribe(&stage, "", &service.endpoint("/phone"), &phone, json!({})).await;
    assert_eq!((made.status, &made.json()["min_priority"]), (201, &json!("high")), "{}", made.text);
    service.next("/phone").await;
    let alert = |kind: AlertKind, priority_cause: &str| kind.alert("dome_1", stage.bus.clock().utc(), priority_cause);
    let held = alert(AlertKind::DomeHeld, "it is half open");
    let published =
        stage.publish(Key::Observatory(address("callisto"), Part::Alerts), list(std::slice::from_ref(&held))).await;

    let message = service.next("/phone").await;
    let header = |name: &str| message.headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default();
    assert_eq!((header("content-encoding"), header("urgency"), header("ttl")), ("aes128gcm", "high", "86400"));
    let key = key_of(&stage, "").await;
    assert!(
        header("authorization").starts_with("vapid t=") && header("authorization").ends_with(key.as_str().unwrap())
    );
    assert_eq!(header("topic").len(), 32);
    assert!(!String::from_utf8_lossy(&message.body).contains("dome"), "the push service reads nothing");
    let read: Value = serde_json::from_str(&phone.read(&message.body).expect("it is for this browser")).unwrap();
    assert_eq!(read["title"], "[paranal/callisto] high raised: dome-held/dome_1");
    let text = read["body"].as_str().unwrap();
    assert!(text.starts_with("it is half open\nWhat to do: ") && text.contains(&held.action), "{text}");
    assert_eq!(
        (&read["tag"], &read["url"]),
        (&json!("paranal/callisto/dome-held/dome_1"), &json!("/t/paranal/callisto"))
    );
    // What was sent is published, so that after a restart nothing is repeated.
    let key = Key::Node(address("callisto"), Role::Web, "main".parse().unwrap(), NodeTopic::Alerts);
    let node = stage.bus.latest::<Alerts>(&key).await.unwrap();
    let is_told = || {
        let told = node.get()?.sample.body.notifications;
        told.iter().any(|one| one.id == held.id && one.receiver.starts_with("push/local/")).then_some(())
    };
    assert!(within(LIMIT, is_told).await.is_some());

    let made = subscribe(&stage, "", &service.endpoint("/desk"), &desk, json!({ "min_priority": "critical" })).await;
    assert_eq!(made.status, 201, "{}", made.text);
    service.next("/desk").await;
    let told = stage.ask("POST /api/v1/alerts/test", "", None).await.json();
    let receivers = told["receivers"].as_array().unwrap();
    assert_eq!(receivers.len(), 2, "{told}");
    assert!(receivers.iter().all(|one| one["way"] == "push" && one["error"].is_null()), "{told}");
    let read: Value = serde_json::from_str(&desk.read(&service.next("/desk").await.body).unwrap()).unwrap();
    assert!(read["body"].as_str().is_some_and(|text| text.contains("local tests whether messages arrive")), "{read}");

    service.answers.store(410, Ordering::Relaxed);
    published.put(list(&[held, alert(AlertKind::DomeNotClosed, "it is open")]));
    stage.until("/api/v1/push", |now| listed(now).is_empty()).await;
    assert!(stage.alerts().iter().all(|cause| !cause.contains("gets no alerts")), "{:?}", stage.alerts());
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn while_no_observatory_node_sends_a_browser_gets_the_alerts_of_the_other_nodes() {
    let (service, folder) = (PushService::start().await, tempfile::tempdir().unwrap());
    let stage = Stage::start_with(&service.named(), folder.path()).await;
    let phone = Browser::new();
    assert_eq!(subscribe(&stage, "", &service.endpoint("/phone"), &phone, json!({})).await.status, 201);
    service.next("/phone").await;
    let of = |role, id: &str, topic| Key::Node(address("callisto"), role, id.parse().unwrap(), topic);
    let stopped = NodeState {
        role: Role::Observatory,
        version: String::new(),
        host: String::new(),
        pid: 1,
        uptime_s: 1.0,
        speed: 1.0,
        figures: BTreeMap::new(),
        stopped: Some(Stopped { by: "a person".to_owned(), closed: Some(true) }),
    };
    let _stopped = stage.publish(of(Role::Observatory, "main", NodeTopic::State), stopped).await;
    let alert = AlertKind::DomeNotClosed.alert("dome_1", stage.bus.clock().utc(), "it is open");
    let _alerts = stage.publish(of(Role::Device, "enclosure", NodeTopic::Alerts), list(&[alert])).await;
    let read = phone.read(&service.next("/phone").await.body).expect("it is for this browser");
    assert!(read.contains("critical raised: dome-not-closed/dome_1"), "{read}");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_new_browser_gets_a_message_at_once_and_one_whose_push_service_refuses_is_not_stored() {
    let (service, folder) = (PushService::start().await, tempfile::tempdir().unwrap());
    let web = format!("push_services = [\"http://{}\", \"http://127.0.0.1:1\"]\n", service.at);
    let stage = Stage::start_with(&web, folder.path()).await;
    let phone = Browser::new();
    for (status, why) in [(404, "has ended"), (410, "has ended"), (403, "clock of this host"), (400, "400 Bad Request")]
    {
        service.answers.store(status, Ordering::Relaxed);
        let refused = subscribe(&stage, "", &service.endpoint("/refused"), &phone, json!({})).await;
        assert!(refused.status == 422 && refused.text.contains(why), "{status}: {}", refused.text);
        assert!(refused.text.contains("Nothing was stored"), "{}", refused.text);
        assert_eq!(refused.header("content-type"), Some("application/problem+json"));
        assert!(listed(&stage.ask("GET /api/v1/push", "", None).await.json()).is_empty(), "{status}");
    }
    let what = |answer: &Answer| {
        let told = answer.json();
        (answer.status, told["tried"].clone(), told["error"].as_str().unwrap_or_default().to_owned())
    };
    // What may be better in the night is kept, and told.
    for (status, at, why) in [
        (503, service.endpoint("/busy"), "it answered 503 Service Unavailable"),
        (429, service.endpoint("/often"), "it answered 429 Too Many Requests"),
        (201, "http://127.0.0.1:1/away".to_owned(), "it cannot be reached"),
    ] {
        service.answers.store(status, Ordering::Relaxed);
        let (status, tried, error) = what(&subscribe(&stage, "", &at, &Browser::new(), json!({})).await);
        assert!(status == 201 && tried == true && error.contains(why), "{at}: {status} {tried} {error}");
    }
    let made = subscribe(&stage, "", &service.endpoint("/phone"), &phone, json!({})).await;
    assert_eq!(what(&made), (201, json!(true), String::new()), "{}", made.text);
    let again = subscribe(&stage, "", &service.endpoint("/phone"), &phone, json!({ "min_priority": "critical" })).await;
    assert_eq!(what(&again), (201, json!(false), String::new()), "{}", again.text);
    assert_eq!(listed(&stage.ask("GET /api/v1/push", "", None).await.json()).len(), 4);
    let read: Value = serde_json::from_str(&phone.read(&service.next("/phone").await.body).unwrap()).unwrap();
    let text = read["body"].as_str().unwrap();
    assert!(text.starts_with("Alerts of paranal/callisto reach this device."), "{text}");
    assert!(service.taken.lock().unwrap().iter().all(|taken| taken.path != "/phone"), "it is sent once");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn each_person_has_their_own_devices_and_whoever_loses_the_right_gets_no_more_alerts() {
    let (service, folder) = (PushService::start().await, with_users());
    add_user(folder.path(), "vic", &["viewer:paranal/callisto"]);
    add_user(folder.path(), "ota", &["operator:teide/*"]);
    let stage = Stage::start_with(&service.named(), folder.path()).await;
    let [ana, eve, vic, ota] = [
        stage.session("ana").await,
        stage.session("eve").await,
        stage.session("vic").await,
        stage.session("ota").await,
    ];
    let at = service.endpoint("/phone");
    let at = at.as_str();
    let phone = Browser::new();
    let made = subscribe(&stage, &vic, at, &phone, json!({})).await;
    assert_eq!(made.status, 201, "{}", made.text);
    let id = made.json()["id"].as_str().unwrap().to_owned();
    assert_eq!(
        subscribe(&stage, &vic, at, &phone, json!({ "min_priority": "advisory" })).await.json()["id"],
        json!(id)
    );
    let seen = async |cookie: &str| listed(&stage.ask("GET /api/v1/push", cookie, None).await.json());
    assert_eq!([seen(&vic).await, seen(&ana).await, seen(&eve).await], [vec!["vic"], vec![], vec!["vic"]]);
    let remove = format!("DELETE /api/v1/push/subscriptions/{id}");
    assert_eq!([stage.status(&remove, &ana).await, stage.status(&remove, &vic).await], [404, 204]);
    assert_eq!(stage.status(&remove, &vic).await, 404);

    let refused = async |cookie: &str, endpoint: &str, more: Value, status: u16, wanted: &str| {
        let answer = subscribe(&stage, cookie, endpoint, &Browser::new(), more).await;
        assert!(
            answer.status == status && answer.text.contains(wanted),
            "{endpoint}: {} {}",
            answer.status,
            answer.text
        );
    };
    refused(&ota, at, json!({}), 403, "ota has no right there").await;
    refused(&format!("{vic}Origin: https://evil.example\r\n"), at, json!({}), 403, "").await;
    for endpoint in
        ["http://push.example.net/x", "https://127.0.0.1/x", "https://localhost/x", "https://push.example.net:22/x"]
    {
        refused(&vic, endpoint, json!({}), 422, "web.push_services").await;
    }
    refused(&vic, at, json!({ "key": "another" }), 409, "subscribe anew").await;
    refused(&vic, at, json!({ "device": "" }), 422, "1 to 60 characters").await;
    refused(&vic, at, json!({ "after_min": -1.0 }), 422, "0 to 1440").await;
    refused(
        &vic,
        at,
        json!({ "subscription": { "endpoint": at, "keys": { "p256dh": "BA", "auth": "BA" } } }),
        422,
        "keys.auth",
    )
    .await;
    let token = stage.ask("POST /api/v1/tokens", &vic, Some(&json!({ "name": "cron", "days": 1 }))).await.json();
    let token = format!("Authorization: Bearer {}\r\n", token["token"].as_str().unwrap());
    refused(&token, at, json!({}), 403, "log in with a password").await;

    assert_eq!(subscribe(&stage, &vic, at, &Browser::new(), json!({})).await.status, 201);
    change(folder.path(), |users| users.users.remove(&"vic".parse::<contract::Name>().unwrap()));
    let gone = async || {
        while !seen(&eve).await.is_empty() {
            tokio::time::sleep(std::time::Duration::from_millis(100)).await
        }
    };
    tokio::time::timeout(LIMIT, gone()).await.expect("vic's phone is removed");
    stage.end().await;
}
