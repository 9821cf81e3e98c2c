//! Faults: how a device's answers are spoiled on their way to the client.
//!
//! Faults of the world itself (a stuck shutter, a false park flag, rain) are part of the device or the weather that
//! they concern.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::answer::Answer;

/// The fault of one device; the default is none.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Fault {
    /// GETs repeat what was true when the fault began.
    pub stale: bool,
    /// Every number that is not whole by nature is NaN.
    pub nan: bool,
    /// Requests are accepted and never answered.
    pub hang: bool,
    /// The connection ends without an answer.
    pub refuse: bool,
    /// Requests are executed, and the connection ends without an answer.
    pub mute: bool,
    /// Answers are HTTP 500 with a page of HTML.
    pub html: bool,
    /// Answers are held back, milliseconds of machine time.
    pub slow_ms: u64,
    /// Every request is answered with this ASCOM error number.
    pub error: Option<i32>,
    /// Only these members (lower case) are affected; all where empty.
    pub only: Vec<String>,
}

impl Fault {
    /// A fault that only makes answers late.
    pub fn slow(milliseconds: u64) -> Self {
        Self { slow_ms: milliseconds, ..Self::default() }
    }

    /// A fault that answers everything with one ASCOM error.
    pub fn error(code: i32) -> Self {
        Self { error: Some(code), ..Self::default() }
    }

    /// A device that answers with old values.
    pub fn stale() -> Self {
        Self { stale: true, ..Self::default() }
    }

    /// A device whose numbers are NaN.
    pub fn nan() -> Self {
        Self { nan: true, ..Self::default() }
    }

    /// A device that never answers.
    pub fn hang() -> Self {
        Self { hang: true, ..Self::default() }
    }

    /// A device that drops connections.
    pub fn refuse() -> Self {
        Self { refuse: true, ..Self::default() }
    }

    /// A device whose answers are lost.
    pub fn mute() -> Self {
        Self { mute: true, ..Self::default() }
    }

    /// A device behind a broken web server.
    pub fn html() -> Self {
        Self { html: true, ..Self::default() }
    }

    /// The same fault for some members only.
    pub fn only(mut self, members: &[&str]) -> Self {
        self.only = members.iter().map(|member| member.to_ascii_lowercase()).collect();
        self
    }

    /// Whether a member is affected at all.
    pub fn concerns(&self, member: &str) -> bool {
        self.only.is_empty() || self.only.iter().any(|only| only == member)
    }
}

/// A fault in force, with the answers that a stale device repeats.
#[derive(Debug, Default)]
pub struct InForce {
    /// The fault.
    pub fault: Fault,
    frozen: HashMap<String, Answer>,
}

impl InForce {
    /// A fault that begins now, with the answers of this moment.
    pub fn new(fault: Fault, frozen: HashMap<String, Answer>) -> Self {
        Self { fault, frozen }
    }

    /// The answer of the moment the fault began; the first one given afterwards where that is not known.
    pub fn frozen(&mut self, question: String, answer: Answer) -> Answer {
        self.frozen.entry(question).or_insert(answer).clone()
    }
}

/// Stands for NaN in a JSON value, which cannot hold it; [`spell_nan`] writes it.
const NAN: &str = "\u{1}NaN";

/// Every floating-point number of a value becomes NaN.
pub fn with_nan(value: Value) -> Value {
    match value {
        Value::Number(number) if number.is_f64() => Value::from(NAN),
        Value::Array(items) => items.into_iter().map(with_nan).collect(),
        Value::Object(fields) => fields.into_iter().map(|(name, field)| (name, with_nan(field))).collect(),
        other => other,
    }
}

/// Writes the NaNs of a serialised value as some faulty servers do, without quotes.
pub fn spell_nan(json: String) -> String {
    if json.contains("\\u0001NaN") { json.replace("\"\\u0001NaN\"", "NaN") } else { json }
}
