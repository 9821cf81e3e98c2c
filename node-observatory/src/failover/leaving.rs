//! An end in good order (SIGTERM, Ctrl-C, `systemctl stop`): the node that commands closes first, unless another one is
//! on standby.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use bus::{Catch, MachineTime};
use contract::node::NodeState;
use contract::{Key, NodeTopic, Role, Topic};

use crate::authority::Authority;

/// The closing is waited for at most this long; then the permit is withdrawn, and the guards go on (docs/deploy.md).
const CLOSE_WITHIN: Duration = Duration::from_secs(15);
/// A permit goes out at least so often.
const WITHDRAWN: Duration = Duration::from_millis(1500);
/// A node publishes its state every 5 s; one that was silent for two of them is not on standby.
const STANDS_BY: Duration = Duration::from_secs(11);

/// Waits for the order to end, has everything closed, and then ends the node. Sets `leaves_alone` when nobody takes
/// over: the permits say so.
pub async fn close_first(authority: Arc<Authority>, leaves_alone: Arc<AtomicBool>) -> anyhow::Result<()> {
    let address = authority.node.config.address();
    let keys = Topic::Node(NodeTopic::State).at(&address).of_role(Role::Observatory);
    let nodes = authority.node.bus.subscribe::<NodeState>(keys, Catch::Newest, 16).await?;
    let mut received_at: Option<MachineTime> = None;
    loop {
        tokio::select! {
            () = authority.node.ending.wait() => break,
            received = nodes.recv() => {
                let is_observatory = matches!(received.key, Key::Node(_, Role::Observatory, _, NodeTopic::State));
                if is_observatory && received.sample.boot_id != *authority.node.bus.boot_id() {
                    let takes_over = received.sample.body.stopped.is_none();
                    received_at = takes_over.then_some(received.arrived);
                }
            }
        }
    }
    let now = authority.node.bus.clock().machine();
    let stands_by = received_at.is_some_and(|at| now.since(at) <= STANDS_BY);
    let commands = authority.hold.borrow().token().is_some();
    if commands && stands_by {
        tracing::info!(
            "the node was asked to end; another observatory node is on standby and takes over, so nothing is closed"
        );
    } else if commands {
        tracing::info!(within_s = CLOSE_WITHIN.as_secs(), "the node was asked to end; everything is closed first");
        let closing = authority.close("the observatory node was asked to end and no other one is on standby");
        let is_closed = tokio::time::timeout(CLOSE_WITHIN, closing).await.is_ok();
        authority.node.ends_closed(is_closed);
        // A guard need not wait until the last permit has run out.
        leaves_alone.store(true, Ordering::Relaxed);
        if !is_closed {
            let domes: Vec<String> = authority.node.config.enclosures().iter().map(ToString::to_string).collect();
            tracing::error!(
                domes = %domes.join(", "),
                within_s = CLOSE_WITHIN.as_secs(),
                "not verified closed in time; the permit is withdrawn, and the guard of each dome goes on to ask it to close \
                 until that is verified, as long as the dome's device node runs"
            );
            tokio::time::sleep(WITHDRAWN).await;
        }
    }
    authority.node.stop.stop();
    // The node ends by its stop and not by this task.
    std::future::pending().await
}
