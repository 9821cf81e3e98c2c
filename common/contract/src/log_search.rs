//! Which lines of the log are wanted.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::node::Level;

/// Conditions on lines of the log; a line is found when it meets all that are given.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
pub struct LogSearch {
    /// A part of what it says; upper and lower case of ASCII letters are the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
    /// At least so urgent: `warn` also finds errors.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub level: Option<Level>,
    /// Role and id of the node, such as `device/enclosure`; a role alone is each node of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node: Option<String>,
    /// Half of the lines before this sky time, and half of them from it on, instead of the newest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub around_utc: Option<Utc>,
    /// The oldest lines instead of the newest, where they are more than the limit: to read on from a moment. Without
    /// meaning beside `around_utc`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub oldest: bool,
}
