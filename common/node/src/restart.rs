//! How long a supervisor waits before it starts a process again that ended without being asked to.

use std::time::Duration;

/// A process that lived so long had a good run: it is started again at once.
pub const GOOD_RUN: Duration = Duration::from_secs(10);
/// The pause after an end without a good run before it; each one after that is twice as long.
const FIRST: Duration = Duration::from_secs(1);

/// The pauses of one process, which grow while it ends again and again. Pure: times come in.
#[derive(Debug, Default)]
pub struct Pauses(Duration);

impl Pauses {
    /// The pause before the next start of a process that lived for `uptime`; `most` is the longest one.
    pub fn after(&mut self, uptime: Duration, most: Duration) -> Duration {
        self.0 = if uptime >= GOOD_RUN { Duration::ZERO } else { (self.0 * 2).max(FIRST).min(most) };
        self.0
    }
}

/// When the next start is, for people: `at once`, or `in 2 s`.
pub fn words(pause: Duration) -> String {
    if pause.is_zero() { "at once".to_owned() } else { format!("in {} s", pause.as_secs_f64()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_start_after_a_good_run_is_at_once_and_the_pause_grows_while_a_process_ends_again_and_again() {
        let (s, mut pauses) = (Duration::from_secs, Pauses::default());
        let lived_s = [0, 1, 9, 0, 10, 0, 3600, 3600, 2];
        let waited = lived_s.map(|lived_s| pauses.after(s(lived_s), s(5)));
        assert_eq!(waited, [1, 2, 4, 5, 0, 1, 0, 0, 1].map(s));
        assert_eq!([words(s(0)), words(s(60))], ["at once", "in 60 s"]);
    }

    #[test]
    fn the_units_of_systemd_start_a_node_again_soon_and_never_give_up() {
        for unit in [
            include_str!("../../../deploy/systemd/starmesh@.service"),
            include_str!("../../../deploy/systemd/starmesh-device@.service"),
        ] {
            let value = |key: &str| unit.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix('='));
            let pause_ms = value("RestartSec").and_then(|pause| pause.strip_suffix("ms")?.parse::<u64>().ok());
            assert!(pause_ms.is_some_and(|ms| (100..=1000).contains(&ms)), "{unit}");
            assert_eq!((value("Restart"), value("StartLimitIntervalSec")), (Some("always"), Some("0")), "{unit}");
        }
    }
}
