//! The mount's own clock compared with this node's: one witness of the time for those who judge by the Sun.

use std::time::Duration;

use alpaca::{Alpaca, value};
use bus::MachineTime;
use contract::node::MOUNT_CLOCK_OFFSET_S;
use contract::{Name, Scalar};
use node::Node;
use units::Utc;

use crate::simulated::is_simulated;

/// Asked so often, machine time.
const PERIOD: Duration = Duration::from_secs(20);
/// In a faster sky the way of an answer is longer than what is measured.
const FASTEST: f64 = 10.0;
/// A clock that goes wrong by more from one question to the next is none.
const UNEVEN_S: f64 = 5.0;

/// A mount's clock, as it was read last.
#[derive(Default)]
struct MountClock {
    before: Option<(Utc, MachineTime)>,
}

impl MountClock {
    /// By how much the mount's clock is ahead of ours, s; `None` of one that does not go evenly with the boot-time
    /// clock.
    fn offset_s(&mut self, mount_utc: Utc, own: Utc, now: MachineTime, speed: f64) -> Option<f64> {
        let (before, at) = self.before.replace((mount_utc, now))?;
        let passed_s = now.since(at).as_secs_f64() * speed;
        let even = (mount_utc.seconds_since(before) - passed_s).abs() <= UNEVEN_S * speed.max(1.0);
        even.then(|| mount_utc.seconds_since(own))
    }
}

/// Publishes, as a figure of the node's state, by how much `UTCDate` is ahead of this node's clock, s, until the node
/// is stopped.
pub async fn watch(node: Node, mount: Name, server: String, alpaca: Alpaca) -> anyhow::Result<()> {
    let (clock, figure) = (node.bus.clock().clone(), format!("{mount}{MOUNT_CLOCK_OFFSET_S}"));
    let mut known = MountClock::default();
    loop {
        // Under a simulated sky only a simulator knows the time.
        let knows = !clock.is_simulated() || is_simulated(&server).await.unwrap_or(false);
        let mut offset_s = None;
        if knows && clock.speed() <= FASTEST {
            let before = clock.utc();
            let answer = alpaca.get("utcdate").await.ok().and_then(|answer| value::text(&answer).ok());
            let half_way = before.plus_seconds(clock.utc().seconds_since(before) / 2.0);
            let mount_utc = answer.and_then(|text| text.parse::<Utc>().ok());
            offset_s =
                mount_utc.and_then(|mount_utc| known.offset_s(mount_utc, half_way, clock.machine(), clock.speed()));
        }
        let value =
            offset_s.map_or_else(|| Scalar::Text("not known".to_owned()), |s| Scalar::Float((s * 10.0).round() / 10.0));
        node.figure(&figure, value);
        if node.stop.or(clock.tick(PERIOD)).await.is_none() {
            return Ok(());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mount_whose_clock_stands_still_has_none() {
        let (at, utc) = (|s| MachineTime::from_boot(Duration::from_secs(s)), Utc::from_seconds);
        let mut clock = MountClock::default();
        assert_eq!(clock.offset_s(utc(1000.0), utc(5000.0), at(0), 1.0), None, "nobody knows yet whether it goes");
        assert_eq!(clock.offset_s(utc(1020.5), utc(5020.0), at(20), 1.0), Some(-3999.5));
        assert_eq!(clock.offset_s(utc(1020.5), utc(5040.0), at(40), 1.0), None);
        // Our wall clock was set, and the mount's was not.
        assert_eq!(clock.offset_s(utc(1040.5), utc(1460.5), at(60), 1.0), Some(-420.0));
    }
}
