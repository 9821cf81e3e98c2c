//! The additions to a header.

use crate::card::Card;

/// The additions to a header once the telemetry has arrived.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Plan {
    /// Keywords to set.
    pub cards: Vec<Card>,
    /// Lines for the history: which values are missing.
    pub history: Vec<String>,
    /// How lines of history begin that an earlier completion may have written: they stay where they are said again.
    pub own_history: Vec<&'static str>,
    /// Keywords that an earlier completion may have set: they stay where they are set again.
    pub own_keywords: Vec<&'static str>,
}

impl Plan {
    /// Adds those of another part.
    pub fn extend(&mut self, other: Self) {
        self.cards.extend(other.cards);
        self.history.extend(other.history);
        self.own_history.extend(other.own_history);
        self.own_keywords.extend(other.own_keywords);
    }
}
