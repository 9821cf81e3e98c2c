//! What a node says of itself.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::time::Duration;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Payload, Role, Scalar, printable};

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
    /// Only in the last state of a node that ended because it was asked to: it will be silent, and that is no fault.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stopped: Option<Stopped>,
}

/// From its start until it receives all that others publish, a node needs so long at most, s.
const LISTENS_AFTER_S: f64 = 10.0;

/// The end in good order of a node.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct Stopped {
    /// What asked for it, and where, such as `starmesh up on callisto-pc`.
    pub by: String,
    /// Whether what it closes was verified closed when it ended; absent for a node that closes nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub closed: Option<bool>,
}

impl NodeState {
    /// Is the silence that follows this state no fault? A node that left something open is to be noticed.
    pub fn ended_well(&self) -> bool {
        self.stopped.as_ref().is_some_and(|stopped| stopped.closed != Some(false))
    }

    /// Has the node of this state, which arrived `age` ago, received what another node published last that has been silent
    /// for `silent` since? One that began later cannot know it.
    pub fn has_heard(&self, age: Duration, silent: Duration) -> bool {
        self.uptime_s + age.as_secs_f64() > silent.as_secs_f64() + LISTENS_AFTER_S
    }
}

impl Display for Stopped {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let closed = match self.closed {
            Some(true) => ", closed",
            Some(false) => ", NOT verified closed",
            None => "",
        };
        write!(f, "stopped by {}{closed}", self.by)
    }
}

/// The cause of the alert about a node that publishes no more, the same from whoever notices it: `node` is that node in words,
/// such as `the device node main`; an empty `host` is not known.
pub fn fallen_silent(node: &str, host: &str) -> String {
    let host = if host.is_empty() { String::new() } else { format!(" on host \"{}\"", printable(host)) };
    format!("{node}{host} has fallen silent")
}

/// A node of a telescope as `ROLE/NODE`: so logs, lists and the alerts about it name it, the same from whoever notices it.
pub fn name(role: Role, id: impl Display) -> String {
    format!("{role}/{id}")
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

impl DiaryLine {
    /// What it says, with its fields, as one line.
    pub fn text(&self) -> String {
        let fields: String = self.fields.iter().map(|(name, value)| format!(" {name}={value}")).collect();
        // From any sender: lines are read one by one.
        printable(&format!("{}{fields}", self.message)).into_owned()
    }
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
