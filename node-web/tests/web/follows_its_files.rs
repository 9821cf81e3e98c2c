//! Files of users and of the certificate that change while the web node runs.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use contract::node::NodeState;
use contract::observatory::Alerts;
use contract::{Key, Kind, NodeTopic, Role};
use rustls::pki_types::{CertificateDer, ServerName};
use serde_json::{Value, json};
use test_support::{LIMIT, until};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use users::PasswordHash;

use crate::stage::raw::{PASSWORD, add_user, change, exchange, request, with_users};
use crate::stage::socket::Socket;
use crate::stage::{Stage, address, causes, sample};

const ME: &str = "GET /api/v1/me";

/// Asks until the status is as wanted.
async fn until_status(stage: &Stage, headers: &str, wanted: u16) {
    let looked = async {
        while stage.status(ME, headers).await != wanted {
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
    };
    tokio::time::timeout(LIMIT, looked).await.unwrap_or_else(|_| panic!("never {wanted}"));
}

/// What a program sees changes with its user's rights, also at a socket that is open.
#[tokio::test(flavor = "multi_thread")]
async fn topics_end_and_begin_anew_with_the_rights() {
    let folder = with_users();
    add_user(folder.path(), "vera", &["viewer:paranal/callisto"]);
    let stage = Stage::start_with("", folder.path()).await;
    let dome = address("callisto").device(Kind::Dome, &"dome_1".parse().unwrap());
    let _dome = stage.publish(Key::Capabilities(dome), sample("dome.capabilities")).await;
    let (vera, ana) = (stage.session("vera").await, stage.session("ana").await);
    let device = "GET /api/v1/telescopes/paranal/callisto/devices/dome/dome_1";
    let server =
        async |cookie: &str| stage.ask(device, cookie, None).await.json()["capabilities"]["body"]["server"].clone();
    let seen = async {
        while !server(&ana).await.is_string() {
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    tokio::time::timeout(LIMIT, seen).await.unwrap();
    assert!(server(&vera).await.is_null(), "who may only look does not see where a device is");
    let mut page = Socket::open(&stage, "/api/v1/ws", &vera).await.unwrap();
    page.send(r#"{"op":"sub","topics":["tel/paranal/callisto","log"]}"#).await;
    let of = |topic: &'static str, op: &'static str| move |m: &Value| m["op"] == op && m["topic"] == topic;
    let snap = page.until(of("tel/paranal/callisto", "snap")).await;
    let states = snap["data"]["states"].as_object().unwrap();
    let dome = states.iter().find(|(key, _)| key.ends_with("/capabilities")).unwrap().1;
    assert!(dome["body"]["device_name"].is_string() && dome["body"]["server"].is_null(), "{dome}");
    change(folder.path(), |users| {
        users.users.get_mut(&"vera".parse().unwrap()).unwrap().grants = vec!["viewer:paranal/io".parse().unwrap()];
    });
    assert_eq!(page.until(of("tel/paranal/callisto", "err")).await["data"]["code"], "forbidden");
    page.until(of("log", "snap")).await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_taken_away_in_the_users_file_is_gone_within_seconds() {
    let folder = with_users();
    let stage = Stage::start_with("", folder.path()).await;
    let (ana, eve) = (stage.session("ana").await, stage.session("eve").await);
    // Other rights count in a session that is open.
    change(folder.path(), |users| {
        users.users.get_mut(&"ana".parse().unwrap()).unwrap().grants = vec!["viewer".parse().unwrap()];
    });
    let rights = async {
        while stage.ask(ME, &ana, None).await.json()["rights"] != json!(["viewer"]) {
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
    };
    tokio::time::timeout(LIMIT, rights).await.unwrap();
    // Another password ends the sessions, though the words are the same.
    let password = PasswordHash::of_new(PASSWORD, "ana").unwrap();
    change(folder.path(), |users| users.users.get_mut(&"ana".parse().unwrap()).unwrap().password = password);
    until_status(&stage, &ana, 401).await;
    let ana = stage.session("ana").await;
    change(folder.path(), |users| assert!(users.remove(&"ana".parse().unwrap())));
    until_status(&stage, &ana, 401).await;
    assert_eq!(stage.log_in_as("ana", PASSWORD, "127.0.0.1").await.status, 401);
    assert_eq!(stage.status(ME, &eve).await, 200);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_users_file_changes_nothing_and_raises_an_alert_and_a_missing_one_lets_nobody_in() {
    let folder = with_users();
    let file = folder.path().join("users.toml");
    let stage = Stage::start_with("", folder.path()).await;
    let ana = stage.session("ana").await;
    let whole = fs::read_to_string(&file).unwrap();
    let alerted = |part: &str| stage.alerts().iter().any(|cause| cause.contains("web.users") && cause.contains(part));
    fs::write(&file, &whole[..whole.len() / 2]).unwrap();
    until("an alert of the damaged file", || alerted("still count")).await;
    assert_eq!(stage.status(ME, &ana).await, 200);
    stage.session("eve").await;
    fs::write(&file, &whole).unwrap();
    until("the end of the alert", || !alerted("")).await;
    assert_eq!(stage.status(ME, &ana).await, 200, "the session has lived on");
    fs::rename(&file, folder.path().join("elsewhere")).unwrap();
    until_status(&stage, &ana, 401).await;
    until("an alert of the missing file", || alerted("is gone")).await;
    assert_eq!(stage.log_in_as("ana", PASSWORD, "127.0.0.1").await.status, 401);
    assert_eq!(stage.status("GET /api/v1/network", "").await, 401, "nobody, and not everybody");
    fs::rename(folder.path().join("elsewhere"), &file).unwrap();
    until_status(&stage, &ana, 200).await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_first_user_closes_the_door_of_a_page_that_was_open_on_this_host() {
    let folder = tempfile::tempdir().unwrap();
    let stage = Stage::start_with("public = [\"/api/v1/network\"]", folder.path()).await;
    assert_eq!(stage.status(ME, "").await, 200);
    add_user(folder.path(), "ana", &["viewer"]);
    until_status(&stage, "", 401).await;
    assert_eq!(stage.status("GET /api/v1/network", "").await, 200, "what is public stays so");
    assert_eq!(stage.status("GET /api/heartbeat", "").await, 200, "for scripts of this host");
    assert_eq!(stage.status("GET /api/heartbeat", "X-Forwarded-For: 1.2.3.4\r\n").await, 401);
    assert_eq!(stage.status("GET /api/heartbeat/", "").await, 401);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_that_others_could_open_is_not_served_before_there_is_a_user() {
    let folder = tempfile::tempdir().unwrap();
    let (bus, node) = Stage::begin("trust_proxy = [\"127.0.0.1\"]", folder.path()).await;
    let states = bus.latest::<NodeState>(&node.node.key(NodeTopic::State)).await.unwrap();
    let served = || states.get().is_some_and(|state| state.sample.body.figures.contains_key("page_url"));
    until("an alert", || causes(&node).iter().any(|cause| cause.contains("starmesh user add"))).await;
    assert!(!served());
    add_user(folder.path(), "ana", &["viewer"]);
    until("the page is served", served).await;
    until("the end of the alert", || causes(&node).is_empty()).await;
    node.stop().await;
}

/// As where another program has its port: what was published meanwhile is not published again.
#[tokio::test(flavor = "multi_thread")]
async fn a_telescope_that_is_stopped_before_its_page_can_be_served_is_shown_as_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let web = "trust_proxy = [\"127.0.0.1\"]\npublic = [\"/api/v1/network\"]";
    let (bus, node) = Stage::begin(web, folder.path()).await;
    // Heard over the bus, so that this session knows by now what the web node has subscribed to.
    let raised = bus.latest::<Alerts>(&node.node.key(NodeTopic::Alerts)).await.unwrap();
    until("an alert", || raised.get().is_some_and(|alerts| !alerts.sample.body.alerts.is_empty())).await;
    let state = json!({ "role": "observatory", "version": "", "host": "pc", "pid": 1, "uptime_s": 1.0, "speed": 1.0,
        "stopped": { "by": "starmesh up on pc", "closed": true } });
    let key = Key::Node(address("callisto"), Role::Observatory, "main".parse().unwrap(), NodeTopic::State);
    let observatory = bus.publisher::<NodeState>(&key).await.unwrap();
    for _ in 0..3 {
        observatory.put(serde_json::from_value(state.clone()).unwrap()).await.unwrap();
        let answers = bus.get_all::<NodeState>(node.node.key(NodeTopic::State), LIMIT).await;
        assert_eq!(answers.len(), 1, "the web node answers");
    }
    drop(observatory);
    add_user(folder.path(), "ana", &["viewer"]);
    let url = node.page_url(&bus).await;
    let answer = reqwest::get(format!("{url}/api/v1/network")).await.unwrap().bytes().await.unwrap();
    let network: Value = serde_json::from_slice(&answer).unwrap();
    assert_eq!(network["telescopes"][0]["stopped"]["text"], "stopped by starmesh up on pc, closed", "{network:#}");
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_open_page_is_an_alert_for_as_long_as_it_is_open() {
    let folder = tempfile::tempdir().unwrap();
    let stage = Stage::start_with("insecure_open = true", folder.path()).await;
    until("an alert", || stage.alerts().iter().any(|cause| cause.contains("web.insecure_open"))).await;
    let me = stage.ask(ME, "X-Forwarded-For: 8.8.8.8\r\n", None).await.json();
    assert_eq!((&me["name"], &me["insecure_open"]), (&json!("anybody"), &json!(true)));
    add_user(folder.path(), "ana", &["viewer"]);
    until_status(&stage, "", 401).await;
    until("the end of the alert", || stage.alerts().is_empty()).await;
    stage.end().await;
}

/// Writes a certificate of its own with its key, and returns what trusts it alone.
fn renew(folder: &Path) -> TlsConnector {
    let made = rcgen::generate_simple_self_signed(vec!["localhost".to_owned()]).unwrap();
    fs::write(folder.join("cert.pem"), made.cert.pem()).unwrap();
    fs::write(folder.join("key.pem"), made.signing_key.serialize_pem()).unwrap();
    let mut roots = rustls::RootCertStore::empty();
    roots.add(CertificateDer::from(made.cert.der().to_vec())).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let builder = rustls::ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions().unwrap();
    let mut config = builder.with_root_certificates(roots).with_no_client_auth();
    // A session that is resumed shows no certificate.
    config.resumption = rustls::client::Resumption::disabled();
    TlsConnector::from(Arc::new(config))
}

async fn connect(stage: &Stage, trust: &TlsConnector) -> Option<TlsStream<TcpStream>> {
    let stream = stage.connect_from("127.0.0.1").await.unwrap();
    trust.connect(ServerName::try_from("localhost").unwrap(), stream).await.ok()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_with_a_certificate_speaks_tls_only_and_takes_a_renewed_one_without_a_restart() {
    let folder = with_users();
    let old = renew(folder.path());
    let stage = Stage::start_with("certificate = \"cert.pem\"\nkey = \"key.pem\"", folder.path()).await;
    assert!(stage.url.starts_with("https://127.0.0.1:"), "{}", stage.url);
    let plain = stage.ask(ME, "", None).await;
    assert!(plain.status == 400 && plain.text.contains("https://"), "{} {}", plain.head, plain.text);
    let body = json!({"name": "ana", "password": PASSWORD});
    let log_in = request(stage.authority(), "POST /api/v1/login", "", Some(&body));
    let answer = exchange(connect(&stage, &old).await.unwrap(), &log_in).await;
    let set = answer.header("set-cookie").unwrap();
    assert!(
        set.starts_with("__Host-starmesh=") && set.ends_with("; Path=/; HttpOnly; SameSite=Strict; Secure"),
        "{set}"
    );
    let me = async |trust: &TlsConnector, headers: &str| {
        exchange(connect(&stage, trust).await.unwrap(), &request(stage.authority(), ME, headers, None)).await.status
    };
    let cookie = format!("Cookie: {}\r\n", answer.cookie());
    assert_eq!(me(&old, &cookie).await, 200);
    assert_eq!(me(&old, &cookie.replace("__Host-", "")).await, 401, "a cookie that a page without TLS could have set");
    // A renewal that is half done changes nothing.
    fs::write(folder.path().join("key.pem"), "half").unwrap();
    until("an alert", || stage.alerts().iter().any(|cause| cause.contains("web.key"))).await;
    assert_eq!(me(&old, &cookie).await, 200);
    let new = renew(folder.path());
    let renewed = async {
        while connect(&stage, &new).await.is_none() {
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
    };
    tokio::time::timeout(LIMIT, renewed).await.unwrap();
    assert!(connect(&stage, &old).await.is_none());
    assert_eq!(me(&new, &cookie).await, 200, "sessions live on");
    until("the end of the alert", || stage.alerts().is_empty()).await;
    stage.end().await;
}
