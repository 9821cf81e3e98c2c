//! Which device node serves which device.
//!
//! An enclosure has a node of its own unless its block says otherwise, so that nothing else that is served, listened on or
//! misconfigured can take the guard down with it.

use contract::Kind;

use crate::device::Common;
use crate::observatory::Observatory;

/// Id of the device node that serves domes and roofs whose block names no node.
pub const ENCLOSURE_NODE: &str = "enclosure";
/// Id of the device node that serves everything else whose block names no node.
pub const MAIN_NODE: &str = "main";

impl Common {
    /// Id of the device node that serves this device.
    pub fn node_id(&self, kind: Kind) -> &str {
        match (&self.node, kind) {
            (Some(node), _) => node.as_str(),
            (None, Kind::Dome) => ENCLOSURE_NODE,
            (None, _) => MAIN_NODE,
        }
    }
}

impl Observatory {
    /// Ids of the device nodes of this file, those of enclosures first.
    pub fn device_nodes(&self) -> Vec<&str> {
        let mut devices = self.devices();
        devices.sort_by_key(|(kind, _)| *kind != Kind::Dome);
        let mut ids: Vec<&str> = Vec::new();
        for (kind, common) in devices {
            let id = common.node_id(kind);
            if !ids.contains(&id) {
                ids.push(id);
            }
        }
        ids
    }

    /// The devices that a device node serves.
    pub fn served_by(&self, id: &str) -> Vec<(Kind, &Common)> {
        self.devices().into_iter().filter(|(kind, common)| common.node_id(*kind) == id).collect()
    }

    /// Device nodes of this file that serve an enclosure together with other devices, because blocks say so.
    pub fn crowded_enclosure_nodes(&self) -> Vec<&str> {
        let is_mixed = |id: &&str| {
            let served = self.served_by(id);
            let domes = served.iter().filter(|(kind, _)| *kind == Kind::Dome).count();
            domes > 0 && domes < served.len()
        };
        self.device_nodes().into_iter().filter(is_mixed).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn of(blocks: &[(&str, &str, &str)]) -> Observatory {
        let mut text = "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0.0\nlongitude_deg = 0.0\n\
                        elevation_m = 0.0\n"
            .to_owned();
        for (kind, name, more) in blocks {
            text.push_str(&format!("[[{kind}]]\nname = \"{name}\"\nserver = \"h:1\"\n{more}\n"));
        }
        crate::parse(&text, Path::new(".")).unwrap()
    }

    fn names(config: &Observatory, id: &str) -> Vec<String> {
        config.served_by(id).iter().map(|(_, common)| common.name.to_string()).collect()
    }

    #[test]
    fn an_enclosure_has_a_node_of_its_own_where_no_block_names_one() {
        let config = of(&[("telescope", "mount", ""), ("camera", "camera", ""), ("dome", "roof", "")]);
        assert_eq!(config.device_nodes(), ["enclosure", "main"]);
        assert_eq!(names(&config, "enclosure"), ["roof"]);
        assert_eq!(names(&config, "main"), ["mount", "camera"]);
        assert!(config.crowded_enclosure_nodes().is_empty());
    }

    #[test]
    fn a_named_device_leaves_the_others_where_they_are() {
        let config = of(&[("camera", "camera", "node = \"pc\""), ("dome", "roof", ""), ("focuser", "focus", "")]);
        assert_eq!(config.device_nodes(), ["enclosure", "pc", "main"]);
        assert_eq!(names(&config, "enclosure"), ["roof"]);
        assert_eq!(names(&config, "main"), ["focus"]);
    }

    #[test]
    fn a_block_may_put_the_enclosure_next_to_others_and_that_is_reported() {
        let config = of(&[("camera", "camera", ""), ("dome", "roof", "node = \"main\"")]);
        assert_eq!(config.device_nodes(), ["main"]);
        assert_eq!(config.crowded_enclosure_nodes(), ["main"]);
    }
}
