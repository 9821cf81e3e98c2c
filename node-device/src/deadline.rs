//! How long to wait on this machine for something that takes sky time.

use std::time::Duration;

use bus::Clock;

/// Machine time after which something that takes `sky` has failed; in a fast simulation at least 20 s, because
/// answers take machine time.
pub fn machine_limit(clock: &Clock, sky: Duration) -> Duration {
    let machine = clock.machine_duration(sky);
    if clock.is_simulated() { machine.max(Duration::from_secs(20)) } else { machine }
}
