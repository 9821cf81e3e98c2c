//! A process of this machine; its start distinguishes it from a later one of the same number.

use std::time::Duration;

use serde::{Deserialize, Serialize};
use sysinfo::{Pid, ProcessesToUpdate, System};
use units::Utc;

/// A process; its start distinguishes it from a later one of the same number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Process {
    /// Its number.
    pub pid: u32,
    /// Seconds since 1970.
    started_s: u64,
}

impl Process {
    /// The process that has this number now.
    pub fn of(pid: u32) -> Option<Self> {
        let pid = Pid::from_u32(pid);
        let mut system = System::new().ok()?;
        system.refresh_processes(ProcessesToUpdate::Some(&[pid]), true);
        system.process(pid).map(|found| Self { pid: pid.as_u32(), started_s: found.start_time() })
    }

    /// When it was started, by the clock of this host, for people.
    pub fn since(self) -> String {
        Utc::EPOCH.plus(Duration::from_secs(self.started_s)).to_second()
    }

    /// Does it still run?
    pub fn is_alive(self) -> bool {
        // The start is rounded to seconds and depends on the wall clock, which may have been set.
        Self::of(self.pid).is_some_and(|found| found.started_s.abs_diff(self.started_s) <= 2)
    }
}
