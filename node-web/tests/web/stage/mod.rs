//! A web node on a private bus, and a second bus on which the test publishes as all other nodes.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test ends where its stage breaks")]

pub mod raw;
pub mod socket;

use std::path::Path;
use std::time::{Duration, Instant};

use bus::{Bus, Clock};
use contract::{Address, Key, Payload, Role};
use node::Node;
use serde_json::Value;
use tempfile::TempDir;
use test_support::{LIMIT, PARANAL, RunningNode, block, join, private_bus};
use tokio::sync::watch;

pub struct Stage {
    pub bus: Bus,
    pub url: String,
    pub http: reqwest::Client,
    node: RunningNode,
    _folder: Option<TempDir>,
}

impl Stage {
    pub async fn start() -> Self {
        Self::start_alone("").await
    }

    /// With more lines in `[web]`, in a folder of its own.
    pub async fn start_alone(web: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let stage = Self::start_with(web, folder.path()).await;
        Self { _folder: Some(folder), ..stage }
    }

    /// With more lines in `[web]`; its files are in `folder`.
    pub async fn start_with(web: &str, folder: &Path) -> Self {
        let (bus, node) = Self::begin(web, folder).await;
        let url = node.page_url(&bus).await;
        Self { bus, url, http: reqwest::Client::new(), node, _folder: None }
    }

    /// The node alone, which may have reasons not to serve.
    pub async fn begin(web: &str, folder: &Path) -> (Bus, RunningNode) {
        let bus = private_bus(Clock::machine_clock()).await;
        let monitor = block("safetymonitor", "monitor", "127.0.0.1:1", "");
        let text = format!("{PARANAL}[web]\nlisten = \"127.0.0.1:0\"\n{web}\n{monitor}");
        let config = config::parse(&text, folder).unwrap();
        let node = Node::new(Role::Web, "main".parse().unwrap(), config, Default::default(), join(&bus).await);
        (bus, RunningNode::live(node, node_web::run))
    }

    /// The causes of the node's active alerts.
    pub fn alerts(&self) -> Vec<String> {
        causes(&self.node)
    }

    pub fn authority(&self) -> &str {
        self.url.split("://").nth(1).unwrap()
    }

    /// Publishes this twice a second until it is dropped, as a node does: on a busy machine it is fresh now and then, and no
    /// sample that is lost matters.
    pub async fn publish<T: Payload>(&self, key: Key, body: T) -> Published<T> {
        let publisher = self.bus.publisher(&key).await.unwrap();
        let (sender, values) = watch::channel(body);
        tokio::spawn(async move { publisher.follow(values, Duration::from_millis(500)).await.unwrap() });
        Published(sender)
    }

    pub async fn get(&self, path: &str) -> (reqwest::StatusCode, Value) {
        let response = self.http.get(format!("{}{path}", self.url)).send().await.unwrap();
        let status = response.status();
        (status, serde_json::from_slice(&response.bytes().await.unwrap()).unwrap_or_default())
    }

    /// Asks until the answer is as wanted; the last answer is in the failure.
    pub async fn until(&self, path: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        let (began, mut last) = (Instant::now(), Value::Null);
        while began.elapsed() < LIMIT {
            last = self.get(path).await.1;
            if wanted(&last) {
                return last;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        panic!("{path} never became as wanted: {last:#}");
    }

    /// Ends the node; it must end well.
    pub async fn end(self) {
        tokio::time::timeout(LIMIT, self.node.stop()).await.unwrap();
    }
}

/// What is published again and again while this is held.
#[must_use]
pub struct Published<T>(watch::Sender<T>);

impl<T> Published<T> {
    /// From now on this, at once and again and again.
    pub fn put(&self, body: T) {
        self.0.send_replace(body);
    }
}

pub fn causes(node: &RunningNode) -> Vec<String> {
    node.node.alerts.watch().borrow().alerts.iter().map(|alert| alert.cause.clone()).collect()
}

pub fn address(telescope: &str) -> Address {
    Address::new("paranal", telescope).unwrap()
}

/// The body of a golden sample of the contract, without its envelope.
pub fn sample(name: &str) -> Value {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/contract/golden/v1").join(format!("{name}.json"));
    let text = std::fs::read_to_string(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let mut body: Value = serde_json::from_str(&text).unwrap();
    if let Value::Array(samples) = body {
        body = samples[0].clone();
    }
    for envelope in ["boot_id", "seq", "at_utc"] {
        body.as_object_mut().unwrap().remove(envelope);
    }
    body
}
