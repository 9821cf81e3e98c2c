//! Which devices of the configuration this node serves.

use anyhow::bail;
use bus::Node;
use config::Common;
use contract::{Kind, Name};

/// The devices of one node.
pub struct NodePart<'a> {
    /// Kinds and blocks.
    pub devices: Vec<(Kind, &'a Common)>,
    id: &'a Name,
    any_named: bool,
}

impl<'a> NodePart<'a> {
    /// The part of this node; an error where it has none.
    pub fn of(node: &'a Node) -> anyhow::Result<Self> {
        let all = node.config.devices();
        let any_named = all.iter().any(|(_, common)| common.node.is_some());
        let mut part = Self { devices: Vec::new(), id: &node.id, any_named };
        part.devices = all.into_iter().filter(|(_, common)| part.serves(common)).collect();
        if part.devices.is_empty() {
            bail!(
                "no device is served by the node \"{}\": give devices node = \"{}\", or start the node with another --id",
                node.id,
                node.id
            );
        }
        Ok(part)
    }

    /// Devices name their node. Those that name none belong to the only node, or, where other devices name
    /// theirs, to `main`.
    pub fn serves(&self, common: &Common) -> bool {
        match &common.node {
            Some(node) => node == self.id,
            None => !self.any_named || self.id.as_str() == "main",
        }
    }
}
