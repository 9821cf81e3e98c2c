//! Until when domes may be open, and what an earlier process has left of that.

use std::collections::BTreeMap;

use units::MachineTime;

/// Until when each dome may be open, by this machine's boot-time clock.
pub type Deadlines = BTreeMap<String, MachineTime>;

/// The countdown as it was found on disk.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Before {
    /// Nothing: no node ever ran here.
    Nothing,
    /// The machine was started since, so that no permit can have lasted.
    OtherBoot,
    /// The deadlines of this boot.
    Deadlines(Deadlines),
}
