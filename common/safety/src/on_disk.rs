//! The content of the file of the operator orders, and what holds by it.

use units::Utc;

use crate::said::Said;
use crate::standing::Standing;

/// The content of the file of the operator orders.
#[derive(Debug, Clone, PartialEq)]
pub enum OnDisk {
    /// There is no file.
    Absent,
    /// It cannot be read, and why.
    Unreadable(String),
    /// What was ordered before.
    Found(Standing),
}

impl OnDisk {
    /// The orders that hold by it; a file that cannot be read keeps the dome closed until a person decides anew.
    pub fn orders(self, now: Utc) -> Standing {
        match self {
            Self::Absent => Standing::default(),
            Self::Unreadable(why) => Standing { stay_closed: Some(Said::by_node(why, now)), ..Standing::default() },
            Self::Found(standing) => standing,
        }
    }
}
