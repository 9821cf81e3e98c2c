//! A web node on a private bus, and a second bus on which the test speaks as all other nodes.
#![allow(dead_code, reason = "each test file uses its part")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test ends where its stage breaks")]

use std::path::Path;
use std::time::Duration;

use bus::{Bus, Clock, Node, Publisher, Quality, Stop};
use contract::node::NodeState;
use contract::{Address, Key, NodeTopic, Payload, Role};
use serde_json::Value;

pub struct Stage {
    pub bus: Bus,
    pub url: String,
    pub http: reqwest::Client,
    stop: Stop,
    node: tokio::task::JoinHandle<anyhow::Result<()>>,
}

pub fn private(connect: Vec<String>) -> config::Bus {
    config::Bus { listen: vec!["tcp/127.0.0.1:0".to_owned()], connect, multicast: false }
}

impl Stage {
    pub async fn start() -> Self {
        Self::start_at("127.0.0.1:0").await
    }

    pub async fn start_at(listen: &str) -> Self {
        let bus = Bus::open(&private(Vec::new()), Clock::machine_clock()).await.unwrap();
        let text = format!(
            r#"
            [observatory]
            site = "paranal"
            telescope = "callisto"
            latitude_deg = -24.6
            longitude_deg = -70.4
            elevation_m = 2500.0
            [web]
            listen = "{listen}"
            [[safetymonitor]]
            name = "monitor"
            server = "127.0.0.1:1"
            "#
        );
        let config = config::parse(&text, Path::new(".")).unwrap();
        let joined = Bus::open(&private(bus.locators().await), Clock::machine_clock()).await.unwrap();
        let node = Node::new(Role::Web, "main".parse().unwrap(), config, Default::default(), joined);
        let stop = node.stop.clone();
        let address = node.config.address();
        let running = tokio::spawn(async move { node.clone().live(None, node_web::run(node)).await });
        let key = Key::Node(address, Role::Web, "main".parse().unwrap(), NodeTopic::State);
        let states = bus.latest::<NodeState>(&key).await.unwrap();
        let url = eventually("the node tells its page's address", || {
            let said = states.get()?.said.body;
            Some(said.figures.get("page_url")?.to_string())
        });
        let url = url.await;
        Self { bus, url: url.trim_end_matches('/').to_owned(), http: reqwest::Client::new(), stop, node: running }
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
        self.stop.stop();
        tokio::time::timeout(Duration::from_secs(10), self.node).await.unwrap().unwrap().unwrap();
    }
}

pub async fn eventually<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    for _ in 0..200 {
        if let Some(found) = look() {
            return found;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    panic!("not within 20 s: {what}");
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
