//! How long to wait for things that happen in sky time.

use std::time::Duration;

use bus::Clock;

/// Machine time after which something that should take `sky` of sky time has failed.
///
/// At 1000 x speed a shutter needs 30 ms, but HTTP and polls still take as long as ever: hence the floor.
pub fn command_timeout(clock: &Clock, sky: Duration) -> Duration {
    let machine = clock.machine_duration(sky);
    if clock.is_simulated() { machine.max(Duration::from_secs(20)) } else { machine }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fast_sky_does_not_shorten_the_timeout_below_20_s() {
        let fast = Clock::simulated("2026-11-21T03:00:00Z".parse().unwrap(), 1000.0);
        assert_eq!(command_timeout(&fast, Duration::from_secs(90)), Duration::from_secs(20));
        assert_eq!(command_timeout(&fast, Duration::from_secs(90_000)), Duration::from_secs(90));
        assert_eq!(command_timeout(&Clock::machine_clock(), Duration::from_secs(9)), Duration::from_secs(9));
    }
}
