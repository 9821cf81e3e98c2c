//! Whether this node has the lease, for all code that commands or publishes.

use units::Utc;

/// Whether this node has the lease.
#[derive(Debug, Clone, PartialEq)]
pub enum Hold {
    /// The arbiter was asked and may yet answer that another node commands: nothing is published or done.
    Asking,
    /// The arbiter does not answer; nobody is known to command.
    Claiming,
    /// Somebody else commands and is alive; this node only watches.
    Standby,
    /// This node commands.
    Holding {
        /// The fencing token.
        token: u64,
        /// Since when.
        since_utc: Utc,
    },
}

impl Hold {
    /// The token, while there is one.
    pub fn token(&self) -> Option<u64> {
        match self {
            Self::Holding { token, .. } => Some(*token),
            Self::Asking | Self::Claiming | Self::Standby => None,
        }
    }

    /// A standby publishes nothing, nor does a node that may turn out to be one: one writer per key.
    pub fn may_publish(&self) -> bool {
        match self {
            Self::Claiming | Self::Holding { .. } => true,
            Self::Asking | Self::Standby => false,
        }
    }
}
