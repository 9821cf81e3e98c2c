//! The guard process: a small process around the device node of an enclosure, which closes when the node cannot.
//!
//! It starts the node, receives a line from its guard each second, and needs neither the configuration nor the bus to
//! close: a copy of what last worked is on disk. Whatever is wrong (the configuration is broken, the node does not
//! start, ends, hangs or never sees its shutter), the dome is closed when its last permit has run out, by Alpaca and
//! verified, for ever, and an alert is raised. The node needs this process as little: without it, it guards on and
//! raises an alert.
//!
//! `interlock::watch` and `interlock::Closer` decide (pure), `closer` does, `leaving` closes what the configuration
//! names no more, `starting` asks the disk, `copy` and `places` remember, `link` is the line between both processes,
//! `complaint` decides when people are told, and `herald` tells them.

pub mod copy;
pub mod link;
pub mod places;

mod closer;
mod complaint;
mod disk;
mod herald;
mod leaving;
mod signals;
mod starting;
mod task;

pub use complaint::RESTART;
pub use places::forget_deleted_site;
pub use task::main;

use std::collections::BTreeMap;
use std::path::Path;

use node::NodeOptions;

use self::copy::Copy;
use self::places::Places;

/// Locked by the guard process.
pub const GUARD_LOCK: &str = "guard-lock";
/// Locked by the device node.
pub const NODE_LOCK: &str = "node-lock";

/// The highest tokens that the guard process of a device node remembers, by telescope; none before the first night.
pub fn remembered_tokens(config: &Path, id: &str) -> BTreeMap<String, u64> {
    Places::of(config, id).copy().map(|(_, copy)| copy.tokens).unwrap_or_default()
}

/// Does this node look after an enclosure, by its configuration or, where that cannot be read, by the last one that
/// worked?
pub fn is_needed(options: &NodeOptions, id: &str) -> bool {
    let before = || Places::of(&options.config, id).copy().map(|(_, copy)| copy.domes);
    match node::configuration::read_observatory(&options.config) {
        Ok(config) if Copy::of(&config, id).is_some() => true,
        // A dome that was taken out of the file may be open; one that another node serves now is that node's.
        Ok(config) => before().is_some_and(|domes| {
            let is_elsewhere = |name: &str| config.dome.iter().any(|dome| dome.common.name.as_str() == name);
            !domes.iter().all(|dome| is_elsewhere(dome.name.as_str()))
        }),
        Err(_) => before().is_some(),
    }
}
