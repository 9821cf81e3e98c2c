//! States that were missed and are not known.

use serde::{Deserialize, Serialize};
use units::Utc;

use super::history::{Ago, Now};

/// Where states of a device are missing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hole {
    /// When the newest state before it was published, sky time; none where nothing was received before.
    pub from_utc: Option<Utc>,
    /// When the next one was published, sky time.
    pub until_utc: Utc,
}

/// A hole about which a device node answered what cannot be taken.
#[derive(Debug, Clone)]
pub(crate) struct Refusal {
    pub(crate) hole: Hole,
    pub(crate) why: String,
    /// What was missed was missed before.
    pub(crate) at: Now,
}

/// The same as it survives a restart of this node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct StoredRefusal {
    hole: Hole,
    why: String,
    ago: Ago,
}

impl Refusal {
    pub(crate) fn store(&self, now: Now) -> StoredRefusal {
        StoredRefusal { hole: self.hole.clone(), why: self.why.clone(), ago: Ago::of(self.at, now) }
    }

    /// What was written `then`.
    pub(crate) fn of_stored(stored: &StoredRefusal, then: Now) -> Self {
        Self { hole: stored.hole.clone(), why: stored.why.clone(), at: stored.ago.before(then) }
    }
}

impl std::fmt::Display for Hole {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.from_utc {
            Some(from) => write!(f, "between {} and {}", from.strftime("%H:%M:%S"), self.until_utc.time_of_day()),
            None => write!(f, "before {}", self.until_utc.time_of_day()),
        }
    }
}
