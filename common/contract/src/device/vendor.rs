//! Commands that only the maker of a device knows: ASCOM's CommandString and its kin, and Action.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Longest answer that is passed on, bytes; a longer one is a failure, since half an answer may mean the opposite.
pub const LONGEST_ANSWER: usize = 16 * 1024;

/// A command in the maker's own words; what it answers stands in `last_command.answer` of the device's state.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VendorCommand {
    /// ASCOM CommandString: answers with text.
    CommandString(Words),
    /// ASCOM CommandBool: answers `true` or `false`.
    CommandBool(Words),
    /// ASCOM CommandBlind: answers nothing.
    CommandBlind(Words),
    /// ASCOM Action: answers with text.
    Action {
        /// One of the device's `SupportedActions`.
        name: String,
        /// Its parameters, empty where it has none.
        #[serde(default, skip_serializing_if = "String::is_empty")]
        parameters: String,
    },
}

/// The text of a command.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct Words {
    /// As the device's manual has it.
    pub command: String,
    /// Sent as it is; the driver adds no frame (start, end, checksum) of its own.
    #[serde(default, skip_serializing_if = "is_false")]
    pub raw: bool,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
fn is_false(truth: &bool) -> bool {
    !truth
}

impl VendorCommand {
    /// The word of the method, as the bus and the configuration have it.
    pub const fn method(&self) -> &'static str {
        match self {
            Self::CommandString(_) => "command_string",
            Self::CommandBool(_) => "command_bool",
            Self::CommandBlind(_) => "command_blind",
            Self::Action { .. } => "action",
        }
    }

    /// What is commanded: the text, or the name of the action.
    pub fn text(&self) -> &str {
        match self {
            Self::CommandString(words) | Self::CommandBool(words) | Self::CommandBlind(words) => &words.command,
            Self::Action { name, .. } => name,
        }
    }
}
