//! The content of the file of the operator orders, and what holds by it.

use units::Utc;

use crate::active_orders::ActiveOrders;
use crate::ordered_by::OrderedBy;

/// The content of the file of the operator orders.
#[derive(Debug, Clone, PartialEq)]
pub enum OnDisk {
    /// There is no file.
    Absent,
    /// It cannot be read, and why.
    Unreadable(String),
    /// What was ordered before.
    Found(ActiveOrders),
}

impl OnDisk {
    /// The orders that hold by it; a file that cannot be read keeps the dome closed until a person decides anew.
    pub fn orders(self, now: Utc) -> ActiveOrders {
        match self {
            Self::Absent => ActiveOrders::default(),
            Self::Unreadable(why) => {
                ActiveOrders { stay_closed: Some(OrderedBy::by_node(why, now)), ..ActiveOrders::default() }
            }
            Self::Found(active) => active,
        }
    }
}
