//! What needs a person.

use serde::{Deserialize, Serialize};
use units::Utc;

use crate::Payload;

/// How urgent an alert is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Priority {
    /// Act now: people or hardware are in danger.
    Critical,
    /// Act within minutes: the night is being lost.
    High,
    /// Act tonight.
    Medium,
    /// Know it.
    Advisory,
}

/// The alerts that stand, at each change and every 10 s.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Alerts {
    /// Standing alerts, the most urgent first.
    pub alerts: Vec<Alert>,
}

impl Payload for Alerts {
    const NAME: &'static str = "alerts";
}

/// One alert.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alert {
    /// Names the cause, such as `dome-not-closed/dome_1`; the same cause is one alert.
    pub id: String,
    /// How urgent.
    pub priority: Priority,
    /// Sky time when it was raised.
    pub raised_utc: Utc,
    /// What happened.
    pub cause: String,
    /// What follows from it.
    pub consequence: String,
    /// What a person should do.
    pub action: String,
}
