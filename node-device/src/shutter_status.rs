//! ASCOM ShutterStatus: the number that a dome answers, and what it means.

use alpaca::{AlpacaError, value};
use contract::device::dome::Shutter;

/// ASCOM ShutterStatus by number.
pub const SHUTTER: [(i64, Shutter); 5] =
    [(0, Shutter::Open), (1, Shutter::Closed), (2, Shutter::Opening), (3, Shutter::Closing), (4, Shutter::Error)];

/// The shutter, from the answer to `shutterstatus`.
pub fn shutter_status(answer: &serde_json::Value) -> Result<Shutter, AlpacaError> {
    let number = value::whole(answer).map_err(AlpacaError::Value)?;
    let found = SHUTTER.iter().find(|(n, _)| *n == number).map(|(_, shutter)| *shutter);
    found.ok_or_else(|| AlpacaError::Protocol(format!("ShutterStatus is {number}")))
}
