//! What people have ordered and what holds until it is taken back or ends, so that whoever commands next knows it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::Payload;

/// Control that was taken so long ago is nobody's any more, sky s: an operator of last night is asleep.
pub const CONTROL_LAPSES_S: f64 = 18.0 * 3600.0;

/// The operator orders of a telescope, on change and every second.
///
/// Acknowledgements of alerts are published with the alerts themselves, the robotic switch with the night.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
pub struct OperatorOrders {
    /// Fencing token of the commander that says it; absent from a node that speaks because nobody is known to command.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub token: Option<u64>,
    /// Nothing opens while this stands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stay_closed: Option<Ordered>,
    /// The operator who has taken the telescope from the schedule, until somebody starts it again or takes it over.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub control: Option<Ordered>,
    /// Limits that are done without.
    pub overrides: Vec<Override>,
    /// Alerts that are sent to nobody, whether they are active now or not.
    pub shelved: Vec<Shelved>,
}

impl Payload for OperatorOrders {
    const NAME: &'static str = "observatory.operator_orders";
}

/// The person who ordered something, the reason and the time.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Ordered {
    /// Who, such as `web/ana`.
    pub from: String,
    /// Why.
    pub reason: String,
    /// When, sky time.
    pub at_utc: Utc,
}

/// One limit that is done without.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Override {
    /// The input as the verdict names it, such as `wx/Humidity` or `sun`.
    pub input: String,
    /// Until when, sky time.
    pub until_utc: Utc,
    /// By whom.
    pub ordered: Ordered,
}

/// One alert that is sent to nobody.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Shelved {
    /// Its id.
    pub alert: String,
    /// Until when, sky time.
    pub until_utc: Utc,
    /// By whom.
    pub ordered: Ordered,
}
