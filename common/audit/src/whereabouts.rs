//! The host on which each node of the site runs, as the nodes themselves publish it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use bus::{BusError, Catch};
use contract::node::NodeState;
use contract::{Key, NodeTopic, Topic};
use node::Node;

/// Names remembered: more than any site has nodes.
const MOST: usize = 1000;

/// Hosts by signature (`observatory/alpha/main`).
#[derive(Clone, Default)]
pub struct Whereabouts {
    hosts: Arc<Mutex<BTreeMap<String, String>>>,
}

impl Whereabouts {
    /// Follows the states that the nodes of the site publish.
    pub async fn listen(node: &Node) -> Result<Self, BusError> {
        let all = Self::default();
        let keys = Topic::Node(NodeTopic::State).on_site(&node.config.place.site);
        let states = node.bus.subscribe::<NodeState>(keys, Catch::Newest, 256).await?;
        let (hosts, stop) = (all.hosts.clone(), node.stop.clone());
        tokio::spawn(async move {
            while let Some(received) = stop.or(states.recv()).await {
                let Key::Node(address, role, id, _) = received.key else { continue };
                let mut hosts = hosts.lock().unwrap_or_else(PoisonError::into_inner);
                if hosts.len() < MOST {
                    hosts.insert(format!("{role}/{}/{id}", address.telescope), received.sample.body.host);
                }
            }
        });
        Ok(all)
    }

    /// The host of a node, empty where it is not known.
    pub fn host(&self, signature: &str) -> String {
        self.hosts.lock().unwrap_or_else(PoisonError::into_inner).get(signature).cloned().unwrap_or_default()
    }
}
