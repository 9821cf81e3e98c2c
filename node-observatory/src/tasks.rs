//! The tasks of the node: each runs as long as the node does.

use std::future::Future;

use anyhow::{Context as _, bail};
use node::Node;
use tokio::task::JoinSet;

/// The tasks, by name.
#[derive(Default)]
pub struct Tasks(JoinSet<(&'static str, anyhow::Result<()>)>);

impl Tasks {
    /// Starts a task.
    pub fn spawn(&mut self, name: &'static str, task: impl Future<Output = anyhow::Result<()>> + Send + 'static) {
        let task = Box::pin(task);
        self.0.spawn(async move { (name, task.await) });
    }

    /// Waits until the node is ordered to stop, and ends all tasks.
    ///
    /// # Errors
    /// When a task ends earlier, with its reason.
    pub async fn run(mut self, node: &Node) -> anyhow::Result<()> {
        let ended = node.stop.or(self.0.join_next()).await;
        self.0.shutdown().await;
        let Some(ended) = ended else { return Ok(()) };
        match ended {
            Some(Ok((name, result))) => {
                result.with_context(|| format!("the task {name:?} failed"))?;
                bail!("the task {name:?} ended")
            }
            Some(Err(error)) => Err(error).context("a task was lost"),
            None => bail!("there are no tasks"),
        }
    }
}
