//! What a device node reports of its domes to the guard process.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use units::MachineTime;

/// How the guard of one dome is.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct DomeReport {
    /// When the guard's loop sent this, by the boot-time clock, ns.
    pub at_ns: u64,
    /// The dome may stay open for this time from then on, ms.
    pub may_be_open_ms: u64,
    /// The shutter was read within the last seconds.
    pub sees: bool,
    /// And it was closed.
    pub is_closed: bool,
    /// It must close, and waits for a mount that nobody is known to have parked.
    #[serde(default)]
    pub waits_for_mounts: bool,
}

/// All domes of a node, by name, and the highest tokens.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Report {
    /// By name.
    pub domes: BTreeMap<String, DomeReport>,
    /// By telescope.
    pub tokens: BTreeMap<String, u64>,
}

impl DomeReport {
    /// Until when the dome may be open. `shares_clock`: the processes of this machine share one boot-time clock.
    pub fn open_until(&self, now: MachineTime, shares_clock: bool) -> MachineTime {
        let stated = MachineTime::from_boot(Duration::from_nanos(self.at_ns));
        // A stamp of the future is of another clock.
        let from = if shares_clock && stated <= now { stated } else { now };
        from.plus(Duration::from_millis(self.may_be_open_ms.min(60_000)))
    }
}

/// The boot-time clock's reading in nanoseconds.
pub fn nanos(at: MachineTime) -> u64 {
    u64::try_from(at.since(MachineTime::from_boot(Duration::ZERO)).as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_that_was_read_late_grants_nothing_anew() {
        let at = |ms| MachineTime::from_boot(Duration::from_millis(ms));
        let report = DomeReport {
            at_ns: 5_000_000_000,
            may_be_open_ms: 8_000,
            sees: true,
            is_closed: false,
            waits_for_mounts: false,
        };
        assert_eq!(report.open_until(at(5_100), true), at(13_000));
        assert_eq!(report.open_until(at(30_000), true), at(13_000));
        assert_eq!(report.open_until(at(1_000), true), at(9_000), "a stamp of another clock counts from its arrival");
        assert_eq!(report.open_until(at(30_000), false), at(38_000), "where each process has a clock of its own");
        let endless = DomeReport { may_be_open_ms: u64::MAX, ..report };
        assert_eq!(endless.open_until(at(1_000), true), at(61_000), "no permit lasts longer than 30 s");
    }
}
