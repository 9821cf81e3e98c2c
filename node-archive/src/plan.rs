//! The additions to a header.

use crate::card::Card;

/// The additions to a header once the telemetry has arrived.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Plan {
    /// Keywords to set.
    pub cards: Vec<Card>,
    /// Lines for the history: which values are missing.
    pub history: Vec<String>,
}
