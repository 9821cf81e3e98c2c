//! A mount controller of its maker's own: it latches errors, does not move until they are acknowledged, and reports
//! when it is ready. Its commands and errors are requested from outside; without a request, the mount has no such
//! commands.

use std::collections::BTreeSet;

use serde::Deserialize;
use serde_json::Value;

use crate::answer::{Answer, Refusal};

/// The controller, as it was requested.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vendor {
    /// CommandString that lists the latched errors, joined by commas.
    status: String,
    /// CommandString that acknowledges: followed by a blank and the sum of the distinct levels of what is latched. Any
    /// other sum acknowledges nothing.
    clear: String,
    /// CommandString that returns the state: 1 ready, 0 not yet, -1 in error.
    ready: String,
    /// The latched errors.
    #[serde(default)]
    errors: Vec<Latched>,
    /// Unparked and without errors for so long it is ready, sky s.
    #[serde(default)]
    ready_after_s: f64,
    /// Errors that come when those of the start are acknowledged.
    #[serde(default)]
    then: Vec<Latched>,
    #[serde(skip)]
    well_s: f64,
}

/// A latched error.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Latched {
    /// Its entry of the list.
    entry: String,
    /// Its level.
    level: i64,
}

impl Vendor {
    /// Answers a CommandString.
    pub fn command_string(&mut self, command: &str) -> Answer {
        if command == self.status {
            let entries: Vec<&str> = self.errors.iter().map(|error| error.entry.as_str()).collect();
            return Ok(Value::from(entries.join(",")));
        }
        if command == self.ready {
            let ready = if self.is_in_error() {
                "-1"
            } else if self.well_s >= self.ready_after_s {
                "1"
            } else {
                "0"
            };
            return Ok(Value::from(ready));
        }
        let sum = command.strip_prefix(&self.clear).and_then(|rest| rest.trim().parse::<i64>().ok());
        let Some(sum) = sum else { return Err(Refusal::invalid_value(format!("{command} is no command"))) };
        let levels: BTreeSet<i64> = self.errors.iter().map(|error| error.level).collect();
        if sum == levels.iter().sum::<i64>() {
            self.errors = std::mem::take(&mut self.then);
        }
        Ok(Value::from(""))
    }

    /// Errors are latched.
    pub fn is_in_error(&self) -> bool {
        !self.errors.is_empty()
    }

    /// Lets sky time pass.
    pub fn advance(&mut self, dt: f64, parked: bool) {
        self.well_s = if parked || self.is_in_error() { 0.0 } else { self.well_s + dt };
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn only_the_sum_of_the_distinct_levels_acknowledges() {
        let order = json!({"status": "LIST", "clear": "CLEAR", "ready": "READY", "ready_after_s": 2.0, "errors": [
            {"entry": "a|4", "level": 4}, {"entry": "b|4", "level": 4}, {"entry": "c|2", "level": 2}]});
        let mut vendor: Vendor = serde_json::from_value(order).unwrap();
        assert_eq!(vendor.command_string("LIST").unwrap(), "a|4,b|4,c|2");
        assert_eq!(vendor.command_string("READY").unwrap(), "-1");
        vendor.command_string("CLEAR 10").unwrap();
        assert!(vendor.is_in_error());
        vendor.command_string("CLEAR 6").unwrap();
        assert_eq!(vendor.command_string("LIST").unwrap(), "");
        vendor.advance(3.0, true);
        assert_eq!(vendor.command_string("READY").unwrap(), "0", "parked");
        vendor.advance(3.0, false);
        assert_eq!(vendor.command_string("READY").unwrap(), "1");
        assert!(vendor.command_string("OPEN").is_err());
    }
}
