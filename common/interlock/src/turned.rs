//! Why a command is not taken.

use contract::Reason;

/// Why a command is not taken: for programs, and for people.
pub type Turned = (Reason, String);
