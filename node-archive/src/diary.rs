//! Writes the log lines of all nodes of this telescope into the database.

use bus::{Catch, Node};
use contract::Key;
use contract::node::DiaryLine;

use crate::database::{Database, Write};
use crate::telemetry::{first, watch_keys};

/// Lines that wait here when the database is slow.
const WAITING: usize = 16_384;

/// Stores the lines of the nodes' diaries.
pub async fn keep(node: Node, database: Database) -> anyhow::Result<()> {
    let mut diaries = Vec::new();
    for keys in watch_keys(&node.config, "node/*/*/diary") {
        diaries.push(node.bus.subscribe::<DiaryLine>(&keys, Catch::All, WAITING).await?);
    }
    loop {
        let heard = first(&diaries).await;
        let Key::Node(address, role, id, _) = heard.key else { continue };
        let line = heard.said.body;
        let mut message = line.message;
        for (name, value) in &line.fields {
            message.push_str(&format!(" {name}={value}"));
        }
        // From any sender: a table is read line by line, too.
        let message = contract::printable(&message).into_owned();
        let write = Write::Log {
            telescope: address.telescope.to_string(),
            node: format!("{role}/{id}"),
            target: line.target,
            level: line.level,
            message,
            at: heard.said.at_utc,
            said: (heard.said.boot_id, heard.said.seq),
        };
        database.put(write).await?;
    }
}
