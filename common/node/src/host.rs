//! The host that a node runs on.

use std::time::{SystemTime, UNIX_EPOCH};

/// What the clock of this host says, s since 1970; not sky time, which runs faster at a simulated site. It is for files that
/// a later run reads: nothing that has to be right may depend on it, since such a clock can be wrong and be set.
pub fn now_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs()
}

/// This host's name, as its shell, Windows or the Linux kernel reports it; empty if none does.
pub fn host_name() -> String {
    let of_the_shell = std::env::var("HOSTNAME").or_else(|_| std::env::var("COMPUTERNAME"));
    let name = of_the_shell.or_else(|_| std::fs::read_to_string("/proc/sys/kernel/hostname")).unwrap_or_default();
    name.trim().to_owned()
}

/// Which start of this host's kernel this is, so that times of the boot-time clock in a file are known to be of the same
/// clock; empty where the system has no such id.
pub fn kernel_boot_id() -> String {
    std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default().trim().to_owned()
}
