//! What a telescope's schedule may ask for: its actions, with the schema of their parameters.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::Payload;

/// Asks for the actions that a telescope knows.
#[derive(Debug, Clone, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct ActionQuestion {
    /// `action_type` of the only one that is wanted; all where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<String>,
}

impl Payload for ActionQuestion {
    const NAME: &'static str = "actions.question";
}

/// The actions; none where nobody knows the one that was asked for.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct ActionAnswer {
    /// In the order of the operator's page.
    pub actions: Vec<ActionKind>,
}

impl Payload for ActionAnswer {
    const NAME: &'static str = "actions.answer";
}

/// One sort of action.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct ActionKind {
    /// `action_type` in the schedule.
    pub name: String,
    /// What it does.
    pub help: String,
    /// The example needs a safe sky.
    pub needs_safe_sky: bool,
    /// The example moves the mount or the roof.
    pub moves_mount: bool,
    /// An `action_value`.
    pub example: Value,
    /// What `action_value` may be: JSON Schema (draft 2020-12) of an object. Each property has a `description`, a number
    /// its `minimum` and `maximum` and, in addition to the words of JSON Schema, its `unit`.
    pub schema: Value,
}
