//! What is added to a header.

use crate::card::Card;

/// What is added to a header once the telemetry is there.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Plan {
    /// Keywords to set.
    pub cards: Vec<Card>,
    /// Lines for the history: what is missing.
    pub history: Vec<String>,
}
