//! A web node on a private bus, and a second bus on which the test publishes as all other nodes.
#![allow(dead_code, reason = "each test file uses its part")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test ends where its stage breaks")]

use std::path::Path;
use std::time::Duration;

use bus::{Bus, Clock, Node, Publisher, Quality};
use contract::node::NodeState;
use contract::{Address, Key, NodeTopic, Payload, Role};
use serde_json::Value;
use test_support::{LIMIT, PARANAL, RunningNode, block, join, private_bus, within};

pub struct Stage {
    pub bus: Bus,
    pub url: String,
    pub http: reqwest::Client,
    node: RunningNode,
}

impl Stage {
    pub async fn start() -> Self {
        Self::start_at("127.0.0.1:0").await
    }

    pub async fn start_at(listen: &str) -> Self {
        let bus = private_bus(Clock::machine_clock()).await;
        let monitor = block("safetymonitor", "monitor", "127.0.0.1:1", "");
        let text = format!("{PARANAL}[web]\nlisten = \"{listen}\"\n{monitor}");
        let config = config::parse(&text, Path::new(".")).unwrap();
        let key = Key::Node(config.address(), Role::Web, "main".parse().unwrap(), NodeTopic::State);
        let node = Node::new(Role::Web, "main".parse().unwrap(), config, Default::default(), join(&bus).await);
        let node = RunningNode::live(node, node_web::run);
        let states = bus.latest::<NodeState>(&key).await.unwrap();
        let url = within(LIMIT, || Some(states.get()?.said.body.figures.get("page_url")?.to_string())).await;
        let url = url.unwrap_or_else(|| panic!("the node did not tell its page's address"));
        Self { bus, url: url.trim_end_matches('/').to_owned(), http: reqwest::Client::new(), node }
    }

    pub fn authority(&self) -> &str {
        self.url.strip_prefix("http://").unwrap()
    }

    pub async fn say<T: Payload>(&self, key: Key, quality: Quality, body: T) -> Publisher<T> {
        let publisher = self.bus.publisher(&key, quality).await.unwrap();
        publisher.put(body).await.unwrap();
        publisher
    }

    pub async fn get(&self, path: &str) -> (reqwest::StatusCode, Value) {
        let response = self.http.get(format!("{}{path}", self.url)).send().await.unwrap();
        let status = response.status();
        (status, serde_json::from_slice(&response.bytes().await.unwrap()).unwrap_or_default())
    }

    /// Asks until the answer is as wanted; the last answer is in the failure.
    pub async fn until(&self, path: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        let mut last = Value::Null;
        for _ in 0..200 {
            last = self.get(path).await.1;
            if wanted(&last) {
                return last;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        panic!("{path} never became as wanted: {last:#}");
    }

    /// Ends the node; it must end well and soon.
    pub async fn end(self) {
        tokio::time::timeout(Duration::from_secs(10), self.node.stop()).await.unwrap();
    }
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
