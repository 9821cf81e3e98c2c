//! The close requests of one closing: how many, when, and whether the shutter followed.

use contract::device::dome::Shutter;
use units::MachineTime;

/// The close requests since it must be closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct ClosingRequests {
    pub since: MachineTime,
    pub tries: u32,
    pub last_try: Option<MachineTime>,
    /// The last request beyond the tries, because the shutter opened again, and their number since the last try.
    pub last_again: Option<MachineTime>,
    pub agains: u32,
    /// Since the last request the shutter was seen to close, or to be closed.
    pub went: bool,
    /// A person or the observatory node asked for it; false where the guard began it.
    pub commanded: bool,
}

impl ClosingRequests {
    pub fn begun(since: MachineTime, commanded: bool) -> Self {
        Self { since, tries: 0, last_try: None, last_again: None, agains: 0, went: false, commanded }
    }

    /// Has the shutter turned round since the last request? By what it was asked for later.
    pub fn opens_again(&mut self, seen: Option<(Shutter, MachineTime)>) -> bool {
        let Some((shutter, asked)) = seen else { return false };
        if self.last_request().is_none_or(|at| asked <= at) {
            return false;
        }
        self.went |= matches!(shutter, Shutter::Closing | Shutter::Closed);
        shutter == Shutter::Opening || (shutter == Shutter::Open && self.went)
    }

    pub fn last_request(&self) -> Option<MachineTime> {
        self.last_try.max(self.last_again)
    }
}
