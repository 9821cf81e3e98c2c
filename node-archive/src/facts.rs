//! Writes the observatory node's measurements of frames into the database; from there they go into the headers
//! ([`crate::pass`]).
//!
//! Facts come before a frame is stored, while its header waits for telemetry, or later than both; or never, where no
//! node measures. Only a header waits for them, for [`PATIENCE`].

use std::sync::Arc;
use std::time::Duration;

use bus::{Catch, Node};
use contract::Scalar;
use contract::observatory::FrameFacts;
use tokio::sync::Notify;

use crate::database::{Database, StoredFacts, Write};

/// A header waits so long for facts, machine time: they come within a second of the frame. Those that come later are
/// put into the complete header.
pub const PATIENCE: Duration = Duration::from_secs(3);
/// Facts that wait here when the database is slow.
const WAITING: usize = 4096;

/// Stores the facts of all frames of this telescope.
pub async fn keep(node: Node, database: Database, incomplete: Arc<Notify>) -> anyhow::Result<()> {
    let frames = format!("{}/{}/observatory/frame/*/facts", contract::key::ROOT, node.config.address());
    let facts = node.bus.subscribe::<FrameFacts>(&frames, Catch::All, WAITING).await?;
    let mut count = 0;
    loop {
        let heard = facts.hear().await;
        let said = (heard.said.boot_id, heard.said.seq);
        let stored = StoredFacts { facts: heard.said.body, at: heard.said.at_utc, said };
        database.commit(vec![Write::Facts(Box::new(stored))]).await?;
        count += 1;
        node.figure("facts_heard", Scalar::Int(count));
        incomplete.notify_one();
    }
}
