//! One node of a role and id per telescope: of two, the younger leaves.

use std::time::Duration;

use anyhow::bail;
use contract::NodeTopic;
use contract::node::NodeState;
use contract::observatory::AlertKind;

use crate::{Catch, Node};

/// A node says how it is every 5 s; a twin that was silent for three of them is gone.
const GONE: Duration = Duration::from_secs(15);

/// Listens for a twin for ever; ends with an error when there is an older one.
pub async fn leave_to_older(node: &Node) -> anyhow::Result<()> {
    let key = node.key(NodeTopic::State);
    let heard = node.bus.subscribe::<NodeState>(&key.to_string(), Catch::Newest, 8).await?;
    let (own, clock) = (node.bus.boot_id(), node.bus.clock());
    let mut foreign = None;
    loop {
        if let Ok(heard) = tokio::time::timeout(GONE, heard.hear()).await
            && heard.said.boot_id != *own
        {
            let NodeState { role, host, pid, .. } = &heard.said.body;
            let cause = format!("another {role} node with id \"{}\" runs on host \"{host}\" as process {pid}", node.id);
            // ids of later starts sort later, for both of them in the same way
            if heard.said.boot_id < *own {
                bail!("{cause}; end it, or give this one another name with --id");
            }
            foreign = Some(clock.machine());
            node.alerts.raise(AlertKind::Twin, "", &cause);
        }
        if foreign.is_some_and(|at| clock.machine().since(at) > GONE) {
            foreign = None;
            node.alerts.clear(AlertKind::Twin, "");
        }
    }
}
