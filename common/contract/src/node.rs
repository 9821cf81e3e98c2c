//! What a node says of itself.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Payload, Role, Scalar};

/// Health of a node, every 5 s.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct NodeState {
    /// Its role.
    pub role: Role,
    /// Program version.
    pub version: String,
    /// Host name.
    pub host: String,
    /// Process id.
    pub pid: u32,
    /// Machine seconds since it started.
    pub uptime_s: f64,
    /// Speed of its sky time.
    pub speed: f64,
    /// What only this role reports, under names that end in their unit.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub figures: BTreeMap<String, Scalar>,
}

/// Figures of a device node end so: by how much the clock of the mount of that name is ahead of the node's, s.
pub const MOUNT_CLOCK_OFFSET_S: &str = "_clock_offset_s";

impl Payload for NodeState {
    const NAME: &'static str = "node.state";
}

/// One line of a node's log, at level info and above.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct DiaryLine {
    /// `error`, `warn` or `info`.
    pub level: Level,
    /// Module that wrote it.
    pub target: String,
    /// What it says.
    pub message: String,
    /// Its fields.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub fields: BTreeMap<String, String>,
}

impl Payload for DiaryLine {
    const NAME: &'static str = "node.diary";
}

/// How much a log line matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// A person acts.
    Error,
    /// Handled, worth knowing.
    Warn,
    /// The night's diary.
    Info,
}
