//! Which devices of the configuration this node serves.

use anyhow::bail;
use config::Common;
use contract::{Kind, Name};
use node::Node;

/// The devices of one node.
pub struct NodePart<'a> {
    /// Kinds and blocks.
    pub devices: Vec<(Kind, &'a Common)>,
    id: &'a Name,
}

impl<'a> NodePart<'a> {
    /// The part of this node; an error where it has none.
    pub fn of(node: &'a Node) -> anyhow::Result<Self> {
        let devices = node.config.served_by(node.id.as_str());
        if devices.is_empty() {
            bail!(
                "no device is served by the device node \"{}\"; this file's device nodes are: {}; start one of them with \
                 --id, or give devices node = \"{}\"",
                node.id,
                node.config.device_nodes().join(", "),
                node.id
            );
        }
        Ok(Self { devices, id: &node.id })
    }

    /// Whether this node guards an enclosure.
    pub fn has_enclosure(&self) -> bool {
        self.devices.iter().any(|(kind, _)| *kind == Kind::Dome)
    }

    /// Whether this node serves a device.
    pub fn serves(&self, kind: Kind, common: &Common) -> bool {
        common.node_id(kind) == self.id.as_str()
    }
}
