//! The person who ordered something, the reason, and the time.

use contract::observatory::Ordered;
use serde::{Deserialize, Serialize};
use units::Utc;

/// Who orders what a node does because it cannot know what people want.
const NODE: &str = "observatory node";

/// The person who ordered something, and the reason.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OrderedBy {
    /// The person.
    pub from: String,
    /// Why.
    pub reason: String,
    /// When, sky time.
    pub at_utc: Utc,
}

impl OrderedBy {
    /// An order that this node gives itself, because it cannot know what people want.
    pub fn by_node(reason: String, at_utc: Utc) -> Self {
        Self { from: NODE.to_owned(), reason, at_utc }
    }

    /// This node gave it itself.
    pub fn is_by_node(&self) -> bool {
        self.from == NODE
    }
}

impl From<OrderedBy> for Ordered {
    fn from(OrderedBy { from, reason, at_utc }: OrderedBy) -> Self {
        Self { from, reason, at_utc }
    }
}

impl From<Ordered> for OrderedBy {
    fn from(Ordered { from, reason, at_utc }: Ordered) -> Self {
        Self { from, reason, at_utc }
    }
}
