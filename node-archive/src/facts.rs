//! Writes the observatory node's measurements of frames into the database; from there they go into the headers
//! ([`crate::pass`]).
//!
//! Facts come before a frame is stored, while its header waits for telemetry, or later than both; or never, where no
//! node measures. Only a header waits for them, for [`TIMEOUT`].

use std::sync::Arc;
use std::time::Duration;

use bus::Catch;
use contract::observatory::FrameFacts;
use contract::{Scalar, Topic};
use node::Node;
use tokio::sync::Notify;

use crate::database::{Database, StoredFacts, Write};

/// A header waits so long for facts, machine time: they come within a second of the frame. Those that come later are
/// put into the complete header.
pub const TIMEOUT: Duration = Duration::from_secs(3);
/// Facts that wait here when the database is slow.
const WAITING: usize = 4096;

/// Stores the facts of all frames of this telescope.
pub async fn keep(node: Node, database: Database, incomplete: Arc<Notify>) -> anyhow::Result<()> {
    let facts = node.bus.subscribe::<FrameFacts>(Topic::Facts.at(&node.config.address()), Catch::All, WAITING).await?;
    let mut count = 0;
    loop {
        let received = facts.recv().await;
        let origin = (received.sample.boot_id, received.sample.seq);
        let stored = StoredFacts { facts: received.sample.body, at: received.sample.at_utc, origin };
        database.commit(vec![Write::Facts(Box::new(stored))]).await?;
        count += 1;
        node.figure("facts_heard", Scalar::Int(count));
        incomplete.notify_one();
    }
}
