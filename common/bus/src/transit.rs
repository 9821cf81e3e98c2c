//! How long payloads were held by their sender and on their way, without comparing two machines' clocks.
//!
//! Each payload carries the sender's boot-time clock. The smallest difference between the receiver's and the sender's
//! clock that payloads of one boot have shown is that of the fastest one; whatever came later than that was on its
//! way, in a full buffer or before a receiver that stood still, for so much longer. A burst of old states after a
//! stall is therefore as old as it is.

use std::collections::VecDeque;
use std::time::Duration;

use contract::{BootId, Stamped};

use crate::MachineTime;

/// Senders that are remembered.
const REMEMBERED: usize = 256;
/// The fastest payload counts for one to two such times, so that the drift of two clocks does not add up.
const WINDOW: Duration = Duration::from_secs(600);

/// Boot-time clock in seconds, as payloads carry it.
pub(crate) fn sent_s(now: MachineTime) -> f64 {
    // Whole microseconds: shorter, and more exact than any transport.
    (seconds(now) * 1e6).round() / 1e6
}

fn seconds(at: MachineTime) -> f64 {
    at.since(MachineTime::from_boot(Duration::ZERO)).as_secs_f64()
}

/// A published payload, with the time for which it was held.
pub(crate) fn held(mut bytes: Vec<u8>, held: Duration) -> Vec<u8> {
    if bytes.last() == Some(&b'}') {
        bytes.pop();
        bytes.extend_from_slice(format!(",\"held_s\":{:.3}}}", held.as_secs_f64()).as_bytes());
    }
    bytes
}

/// What is known of the ways from the senders to here.
#[derive(Debug, Default)]
pub(crate) struct Transit {
    senders: VecDeque<(BootId, Fastest)>,
}

/// Smallest differences between the clocks, s, of the window before and of this one.
#[derive(Debug, Clone, Copy)]
struct Fastest {
    before_s: f64,
    now_s: f64,
    since: MachineTime,
}

impl Transit {
    /// When a payload that is here `now` would have been here, had it been neither held nor delayed.
    pub(crate) fn arrived<T>(&mut self, sample: &Stamped<T>, now: MachineTime) -> MachineTime {
        let held_s = sample.held_s.filter(|s| s.is_finite()).unwrap_or(0.0).max(0.0);
        let late_s = match sample.sent_s.filter(|sent_s| sent_s.is_finite()) {
            // Without its sender's clock only what the sender reports of itself is known.
            None => held_s,
            Some(sent_s) => {
                let difference_s = seconds(now) - sent_s - held_s;
                held_s + self.slower_s(&sample.boot_id, difference_s, now)
            }
        };
        now.minus(Duration::try_from_secs_f64(late_s).unwrap_or(Duration::MAX))
    }

    /// By how much a payload took longer than the fastest one, s.
    fn slower_s(&mut self, boot_id: &BootId, difference_s: f64, now: MachineTime) -> f64 {
        let Some((_, fastest)) = self.senders.iter_mut().find(|(known, _)| known == boot_id) else {
            if self.senders.len() >= REMEMBERED {
                self.senders.pop_front();
            }
            let fastest = Fastest { before_s: f64::INFINITY, now_s: difference_s, since: now };
            self.senders.push_back((boot_id.clone(), fastest));
            return 0.0;
        };
        if now.since(fastest.since) > WINDOW {
            *fastest = Fastest { before_s: fastest.now_s, now_s: f64::INFINITY, since: now };
        }
        fastest.now_s = fastest.now_s.min(difference_s);
        difference_s - fastest.now_s.min(fastest.before_s)
    }
}

#[cfg(test)]
mod tests {
    use units::Utc;

    use super::*;

    fn at(seconds: f64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs_f64(seconds))
    }

    fn sample(boot_id: &BootId, sent_s: Option<f64>, held_s: Option<f64>) -> Stamped<()> {
        Stamped { boot_id: boot_id.clone(), seq: 0, at_utc: Utc::EPOCH, sent_s, held_s, body: () }
    }

    /// By how much a payload is older than its arrival, ms.
    fn late_ms(transit: &mut Transit, sample: &Stamped<()>, now_s: f64) -> u128 {
        at(now_s).since(transit.arrived(sample, at(now_s))).as_millis()
    }

    #[test]
    fn a_burst_after_a_stall_is_as_old_as_it_is() {
        let (mut transit, boot) = (Transit::default(), BootId::fresh());
        // The sender was booted 500 s later than this machine.
        assert_eq!(late_ms(&mut transit, &sample(&boot, Some(100.0), None), 600.005), 0);
        assert_eq!(late_ms(&mut transit, &sample(&boot, Some(101.0), None), 601.001), 0);
        // This machine stood still for 12 s, and what came meanwhile is read at once.
        assert_eq!(late_ms(&mut transit, &sample(&boot, Some(102.0), None), 614.001), 12_000);
        assert_eq!(late_ms(&mut transit, &sample(&boot, Some(110.0), None), 614.001), 4000);
        assert_eq!(late_ms(&mut transit, &sample(&boot, Some(114.0), None), 614.001), 0);
    }

    #[test]
    fn what_a_sender_held_counts_also_of_one_from_which_nothing_was_received() {
        let (mut transit, boot) = (Transit::default(), BootId::fresh());
        assert_eq!(late_ms(&mut transit, &sample(&boot, Some(100.0), Some(12.0)), 112.0), 12_000);
        assert_eq!(late_ms(&mut transit, &sample(&boot, Some(112.5), None), 112.5), 0);
        assert_eq!(late_ms(&mut transit, &sample(&boot, None, Some(3.0)), 113.0), 3000, "a version without clock");
        assert_eq!(late_ms(&mut transit, &sample(&boot, Some(f64::NAN), None), 113.0), 0);
        assert_eq!(late_ms(&mut transit, &sample(&boot, Some(113.0), Some(-5.0)), 113.0), 0);
    }

    #[test]
    fn clocks_that_drift_apart_do_not_age_what_they_carry() {
        let (mut transit, boot) = (Transit::default(), BootId::fresh());
        let mut worst = 0;
        for second in 0..36_000 {
            // The sender's clock loses 50 parts in a million.
            let sent_s = f64::from(second) * (1.0 - 50e-6);
            worst = worst.max(late_ms(&mut transit, &sample(&boot, Some(sent_s), None), f64::from(second)));
        }
        assert!(worst < 100, "{worst} ms");
    }

    #[test]
    fn a_held_payload_contains_how_long_it_was_held() {
        let bytes = serde_json::to_vec(&sample(&BootId::fresh(), Some(1.5), None)).unwrap();
        let again: Stamped<()> = serde_json::from_slice(&held(bytes, Duration::from_millis(2250))).unwrap();
        assert_eq!((again.held_s, again.sent_s), (Some(2.25), Some(1.5)));
    }
}
