//! Reads the boot-time clock of this machine.

use std::time::Duration;

use units::MachineTime;

/// Reads the clock.
pub(crate) fn now() -> MachineTime {
    MachineTime::from_boot(boot_time())
}

#[cfg(target_os = "linux")]
fn boot_time() -> Duration {
    // CLOCK_BOOTTIME counts suspend, unlike the clock behind std::time::Instant.
    let time = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    let nanos = u32::try_from(time.tv_nsec).unwrap_or(0);
    Duration::new(u64::try_from(time.tv_sec).unwrap_or(0), nanos)
}

#[cfg(not(target_os = "linux"))]
fn boot_time() -> Duration {
    // On Windows std's Instant (QueryPerformanceCounter) counts suspend; its zero is this process's first reading.
    use std::sync::OnceLock;
    use std::time::Instant;
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed()
}
