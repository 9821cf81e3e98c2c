//! Writes the log lines of all nodes of this telescope into the database.

use contract::node::DiaryLine;
use contract::{Key, NodeTopic, Topic};
use node::Node;

use crate::database::{Database, Write};
use crate::streams::{self, Lost, Stream};
use crate::telemetry::watch_keys;

/// Lines that wait here when the database is slow.
const WAITING: usize = 16_384;

/// Stores the lines of the nodes' diaries.
pub async fn keep(node: Node, database: Database) -> anyhow::Result<()> {
    let mut diaries = Vec::new();
    for keys in watch_keys(&node.config, Topic::Node(NodeTopic::Diary)) {
        diaries.push(Stream::<DiaryLine>::open(&node, &database, keys, WAITING).await?);
    }
    let mut looks = tokio::time::interval(streams::LOOK);
    let mut lost = Lost::new(&node, ("log lines", "log"));
    loop {
        let received = tokio::select! {
            received = streams::first(&diaries) => received,
            _ = looks.tick() => {
                lost.look(&database, &diaries).await?;
                continue;
            }
        };
        let written = streams::received(&received);
        let Key::Node(address, role, id, _) = received.key else { continue };
        let line = received.sample.body;
        let message = line.text();
        let write = Write::Log {
            telescope: address.telescope.to_string(),
            node: contract::node::name(role, &id),
            target: line.target,
            level: line.level,
            message,
            at: received.sample.at_utc,
            origin: (received.sample.boot_id, received.sample.seq),
        };
        database.put(write).await?;
        database.put(written).await?;
    }
}
