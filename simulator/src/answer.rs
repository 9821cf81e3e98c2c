//! The answer of a device: a value, or one of ASCOM's refusals.

use serde_json::Value;

/// The answer to one request; `Value::Null` where a method returns nothing.
pub type Answer = Result<Value, Refusal>;

/// Why a request was not executed.
#[derive(Debug, Clone, PartialEq)]
pub enum Refusal {
    /// An ASCOM error, reported with HTTP 200 in `ErrorNumber` and `ErrorMessage`.
    Ascom {
        /// ASCOM error number, 0x400 to 0xFFF.
        code: i32,
        /// For a person.
        message: String,
    },
    /// The request itself is wrong: HTTP 400 with a text.
    BadRequest(String),
    /// The device has no such member: HTTP 400 too.
    UnknownMember,
}

impl Refusal {
    fn ascom(code: i32, message: impl Into<String>) -> Self {
        Self::Ascom { code, message: message.into() }
    }

    /// 0x400: this device cannot do that.
    pub fn not_implemented(member: &str) -> Self {
        Self::ascom(0x400, format!("{member} is not implemented"))
    }

    /// 0x401: a value out of its range.
    pub fn invalid_value(message: impl Into<String>) -> Self {
        Self::ascom(0x401, message)
    }

    /// 0x402: a value that must be set first.
    pub fn value_not_set(member: &str) -> Self {
        Self::ascom(0x402, format!("{member} has not been set"))
    }

    /// 0x407: the device is not connected.
    pub fn not_connected() -> Self {
        Self::ascom(0x407, "device is not connected")
    }

    /// 0x408: not while parked.
    pub fn parked() -> Self {
        Self::ascom(0x408, "not possible while parked")
    }

    /// 0x409: not while slaved.
    pub fn slaved() -> Self {
        Self::ascom(0x409, "not possible while slaved")
    }

    /// 0x40B: not now.
    pub fn invalid_operation(message: impl Into<String>) -> Self {
        Self::ascom(0x40B, message)
    }

    /// 0x40C: `Action` knows no such action.
    pub fn action_not_implemented(action: &str) -> Self {
        Self::ascom(0x40C, format!("action {action} is not implemented"))
    }

    /// An error that a fault asked for.
    pub fn asked_for(code: i32) -> Self {
        Self::ascom(code, format!("simulated error 0x{code:X}"))
    }
}

/// Success with nothing to report.
pub const DONE: Answer = Ok(Value::Null);

/// Checks that a number lies in a closed range.
pub fn within(name: &str, value: f64, low: f64, high: f64) -> Result<f64, Refusal> {
    if (low..=high).contains(&value) {
        Ok(value)
    } else {
        Err(Refusal::invalid_value(format!("{name} {value} is not within {low} and {high}")))
    }
}
