//! An end in good order (SIGTERM, Ctrl-C, `systemctl stop`): the node that commands closes first, unless another one is
//! on standby.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use bus::{Catch, MachineTime};
use contract::node::NodeState;
use contract::{Key, NodeTopic, Role};

use crate::control_room::ControlRoom;

/// The closing is waited for at most this long; then the permit is withdrawn, and the guards go on (docs/deploy.md).
const CLOSE_WITHIN: Duration = Duration::from_secs(15);
/// A permit goes out at least so often.
const WITHDRAWN: Duration = Duration::from_millis(1500);
/// A node publishes its state every 5 s; one that was silent for two of them is not on standby.
const STANDS_BY: Duration = Duration::from_secs(11);

/// Waits for the order to end, has everything closed, and then ends the node.
pub async fn close_first(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let address = room.node.config.address();
    let keys = format!("{}/{address}/node/{}/*/{}", contract::key::ROOT, Role::Observatory, NodeTopic::State.word());
    let nodes = room.node.bus.subscribe::<NodeState>(&keys, Catch::Newest, 16).await?;
    let mut heard_at: Option<MachineTime> = None;
    loop {
        tokio::select! {
            () = room.node.ending.wait() => break,
            heard = nodes.hear() => {
                let is_observatory = matches!(heard.key, Key::Node(_, Role::Observatory, _, NodeTopic::State));
                if is_observatory && heard.said.boot_id != *room.node.bus.boot_id() {
                    heard_at = Some(heard.arrived);
                }
            }
        }
    }
    let now = room.node.bus.clock().machine();
    let stands_by = heard_at.is_some_and(|at| now.since(at) <= STANDS_BY);
    let commands = room.hold.borrow().token().is_some();
    if commands && stands_by {
        tracing::warn!(
            "the node was asked to end; another observatory node is on standby and takes over, so nothing is closed"
        );
    } else if commands {
        tracing::warn!(within_s = CLOSE_WITHIN.as_secs(), "the node was asked to end; everything is closed first");
        let closing = room.close("the observatory node was asked to end and no other one is on standby");
        let is_closed = tokio::time::timeout(CLOSE_WITHIN, closing).await.is_ok();
        // A guard need not wait until the last permit has run out.
        room.leaves_alone.store(true, Ordering::Relaxed);
        if !is_closed {
            tracing::error!(
                "not verified closed; the permit is withdrawn, and the guards of the enclosures go on closing"
            );
            tokio::time::sleep(WITHDRAWN).await;
        }
    }
    room.node.stop.stop();
    // The node ends by its stop and not by this task.
    std::future::pending().await
}
