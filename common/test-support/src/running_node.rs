//! A node that runs in the process of the test.

use bus::Bus;
use contract::NodeTopic;
use contract::node::NodeState;
use node::Node;
use tokio::task::JoinHandle;

use crate::wait::{LIMIT, within};

/// A node and its task.
pub struct RunningNode {
    /// The node.
    pub node: Node,
    task: JoinHandle<anyhow::Result<()>>,
}

impl RunningNode {
    /// Runs a node with all that each node publishes about itself.
    pub fn live<F>(node: Node, run: impl FnOnce(Node) -> F) -> Self
    where
        F: Future<Output = anyhow::Result<()>> + Send + 'static,
    {
        let task = tokio::spawn(node.clone().live(None, run(node.clone())));
        Self { node, task }
    }

    /// Waits until this web node serves its page: the page's address, without a slash at its end. `bus` may be any session.
    pub async fn page_url(&self, bus: &Bus) -> String {
        let states = bus.latest::<NodeState>(&self.node.key(NodeTopic::State)).await.unwrap();
        let url = within(LIMIT, || Some(states.get()?.sample.body.figures.get("page_url")?.to_string())).await;
        let url = url.expect("the node did not report its page's address");
        url.trim_end_matches('/').to_owned()
    }

    /// Runs the work of a node alone. Its alerts begin and end in time.
    pub fn work<F>(node: Node, run: impl FnOnce(Node) -> F) -> Self
    where
        F: Future<Output = anyhow::Result<()>> + Send + 'static,
    {
        let (work, alerts) = (run(node.clone()), node.alerts.clone());
        let task = tokio::spawn(async move {
            tokio::select! {
                ended = work => ended,
                () = alerts.keep_time() => Ok(()),
            }
        });
        Self { node, task }
    }

    /// Waits until the node ends by itself, and returns its result.
    pub async fn ended(self) -> anyhow::Result<()> {
        tokio::time::timeout(LIMIT, self.task).await.unwrap().unwrap()
    }

    /// Asks the node to end; it must end well.
    pub async fn stop(self) {
        self.node.stop.stop();
        let bus = self.node.bus.clone();
        self.ended().await.unwrap();
        bus.close().await;
    }

    /// Ends the node as a power cut would: it publishes nothing more.
    pub async fn kill(self) {
        self.task.abort();
        let _ = self.task.await;
        self.node.bus.close().await;
    }
}
