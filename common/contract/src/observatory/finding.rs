//! What is wrong with a schedule, or puts a row of it at risk, and where it stands.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Payload;

/// How much a finding weighs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// The file does not say what is to be done: it is refused as a whole.
    Error,
    /// It is taken; a row of it may not be done, or only in part.
    Warning,
}

/// Which check it comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Check {
    /// The file is no sequence of JSON objects.
    Syntax,
    /// A field is unknown, missing, or no value that it can have.
    Schema,
    /// The row's camera, or what belongs to it.
    Device,
    /// A filter that the camera's wheel does not have.
    Filter,
    /// The row's window of time.
    Time,
    /// Another row holds the mount or the camera.
    Overlap,
    /// The target stands too low, too high, or behind the horizon of the site.
    Visibility,
    /// The Sun is up.
    Sun,
    /// The Moon stands near the target.
    Moon,
    /// The exposures do not fit into the window.
    Duration,
    /// The same is observed twice.
    Twice,
}

/// One finding: where, what is wrong, and what would be right.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct Finding {
    /// How much it weighs.
    pub severity: Severity,
    /// Which check it comes from.
    pub check: Check,
    /// Line of the file, from 1.
    pub line: u32,
    /// Character of that line, from 1.
    pub column: u32,
    /// The field, where one is at fault.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
    /// What is wrong.
    pub what: String,
    /// What would be right, where `what` does not say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub right: Option<String>,
    /// The change of the text that mends it, where there is one that is surely right.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fix: Option<Fix>,
}

/// What stands between two places of the file gives way to another text.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct Fix {
    /// Line on which the old text begins, from 1.
    pub line: u32,
    /// Its first character on that line, from 1.
    pub column: u32,
    /// Line on which it ends, from 1.
    pub end_line: u32,
    /// The character of that line after its last one, from 1.
    pub end_column: u32,
    /// The text in its place; empty where the old one is only taken out.
    pub text: String,
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Error => "error",
            Self::Warning => "warning",
        })
    }
}

impl Finding {
    /// The finding without its place: `field: what is wrong; what would be right`.
    pub fn words(&self) -> String {
        let field = self.field.as_ref().map(|field| format!("{field}: ")).unwrap_or_default();
        let right = self.right.as_ref().map(|right| format!("; {right}")).unwrap_or_default();
        format!("{field}{}{right}", self.what)
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}, column {}: {}", self.line, self.column, self.words())
    }
}

/// A schedule that somebody wants to know about before it is used.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct ScheduleDraft {
    /// The text of the file.
    pub text: String,
}

impl Payload for ScheduleDraft {
    const NAME: &'static str = "schedule.draft";
}

/// What was found in a draft; it was not made the active schedule.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct ScheduleFindings {
    /// Would it be taken?
    pub valid: bool,
    /// Rows that could be read.
    pub rows: u32,
    /// Findings that refuse it, those that were left out included.
    pub errors: u32,
    /// Findings that put rows at risk, those that were left out included.
    pub warnings: u32,
    /// In the order of the file, errors before warnings where there are too many to be listed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub findings: Vec<Finding>,
    /// What could not be checked, in words.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unchecked: Vec<String>,
}

impl Payload for ScheduleFindings {
    const NAME: &'static str = "schedule.findings";
}
