//! A request to close that a guard sends to its dome, and what it came to.

use units::MachineTime;

use crate::guard::Guard;

/// A request to close.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Request {
    /// Close the shutter.
    Close,
    /// Stop all movement, then close the shutter.
    AbortThenClose,
}

impl Request {
    /// Its name in logs and in the audit log.
    pub fn name(self) -> &'static str {
        match self {
            Self::Close => "close_shutter",
            Self::AbortThenClose => "abort_then_close_shutter",
        }
    }
}

/// What a request to close came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Answer {
    /// The device took it.
    Accepted,
    /// The device refused it.
    Refused,
    /// There was no answer: it may have arrived all the same.
    Unknown,
}

impl Answer {
    /// What the guard concludes from it.
    pub(crate) fn apply(self, guard: &mut Guard, now: MachineTime) {
        match self {
            Self::Accepted => guard.close_answered(true, now),
            Self::Refused => guard.close_answered(false, now),
            Self::Unknown => {}
        }
    }
}
