//! The on-delay and the hold of a node's own alerts: an alert is published after the on-delay and gone after the hold.

use std::collections::BTreeMap;
use std::time::Duration;

use bus::MachineTime;
use contract::observatory::{Alert, AlertKind, Alerts};

/// What has been raised. Pure: time comes in.
#[derive(Debug, Default)]
pub(crate) struct AlertStates {
    raised: BTreeMap<String, Raised>,
}

/// ```text
///          on-delay            cleared            hold
///  waiting ───────▶ active ───────────▶ holding ───────▶ gone
///     └── cleared: gone ▲──────── raised ──┘
/// ```
#[derive(Debug)]
struct Raised {
    alert: Alert,
    show_at: MachineTime,
    gone_at: Option<MachineTime>,
}

impl AlertStates {
    /// Takes an alert; one that is there keeps its time and takes the new cause. True for a new one.
    pub fn raise(&mut self, on_delay: Duration, mut alert: Alert, now: MachineTime) -> bool {
        let known = self.raised.get(&alert.id);
        let is_new = known.is_none();
        let show_at = match known {
            Some(known) => {
                alert.raised_utc = known.alert.raised_utc;
                known.show_at
            }
            None => now.plus(on_delay),
        };
        self.raised.insert(alert.id.clone(), Raised { alert, show_at, gone_at: None });
        is_new
    }

    /// Its cause is gone. True when it had one.
    pub fn clear(&mut self, kind: AlertKind, id: &str, now: MachineTime) -> bool {
        let Some(raised) = self.raised.get_mut(id) else { return false };
        let had_cause = raised.gone_at.is_none();
        if raised.show_at > now {
            // Nobody has seen it.
            self.raised.remove(id);
        } else if had_cause {
            raised.gone_at = Some(now.plus(seconds(kind.entry().hold_s)));
        }
        had_cause
    }

    /// The alerts that are active now, the most urgent first.
    pub fn published(&mut self, now: MachineTime) -> Alerts {
        self.raised.retain(|_, raised| raised.gone_at.is_none_or(|at| at > now));
        let published = self.raised.values().filter(|raised| raised.show_at <= now);
        let mut alerts: Vec<Alert> = published.map(|raised| raised.alert.clone()).collect();
        alerts.sort_by_key(|alert| (alert.priority, alert.raised_utc));
        Alerts { alerts, notifications: Vec::new() }
    }

    /// How long until time alone changes the active alerts.
    pub fn next_change(&self, now: MachineTime) -> Option<Duration> {
        let times = self.raised.values().filter_map(|raised| raised.gone_at.or(Some(raised.show_at)));
        times.filter(|at| *at > now).map(|at| at.since(now)).min()
    }
}

pub(crate) fn seconds(seconds: u16) -> Duration {
    Duration::from_secs(u64::from(seconds))
}

#[cfg(test)]
mod tests {
    use super::*;

    const DELAYED: AlertKind = AlertKind::NodeSilent;
    const HELD: AlertKind = AlertKind::DomeUncommandedOpen;

    /// Plays `+` (raise) and `-` (clear) at machine seconds, and returns whether it is active at `at_s`.
    fn stands(kind: AlertKind, scenario: &[(u64, char)], at_s: u64) -> bool {
        let at = |s| MachineTime::from_boot(Duration::from_secs(1000 + s));
        let mut states = AlertStates::default();
        for (time, what) in scenario {
            if *what == '+' {
                states.raise(seconds(kind.entry().on_delay_s), kind.alert("x", units::Utc::EPOCH, "c"), at(*time));
            } else {
                states.clear(kind, &kind.id("x"), at(*time));
            }
            states.published(at(*time));
        }
        !states.published(at(at_s)).alerts.is_empty()
    }

    /// Name, kind, what happens at which second, when it is looked at, whether it is active then.
    type Scenario<'a> = (&'a str, AlertKind, &'a [(u64, char)], u64, bool);

    #[test]
    fn an_alert_follows_its_row() {
        let (delay, hold) = (u64::from(DELAYED.entry().on_delay_s), u64::from(HELD.entry().hold_s));
        assert!(delay > 1 && hold > 1);
        let scenarios: &[Scenario] = &[
            ("it waits for its on-delay", DELAYED, &[(0, '+')], delay - 1, false),
            ("it is shown after it", DELAYED, &[(0, '+')], delay, true),
            ("raising it again does not put it off", DELAYED, &[(0, '+'), (delay - 1, '+')], delay, true),
            ("a short one is never shown", DELAYED, &[(0, '+'), (1, '-')], delay, false),
            ("a gap begins the delay anew", DELAYED, &[(0, '+'), (1, '-'), (2, '+')], delay, false),
            ("it stands at once without an on-delay", HELD, &[(0, '+')], 0, true),
            ("it is held", HELD, &[(0, '+'), (5, '-')], 5 + hold - 1, true),
            ("and then gone", HELD, &[(0, '+'), (5, '-')], 5 + hold, false),
            ("clearing again does not hold it longer", HELD, &[(0, '+'), (5, '-'), (9, '-')], 5 + hold, false),
            ("what comes again while held stands on", HELD, &[(0, '+'), (5, '-'), (6, '+')], 999, true),
        ];
        for (name, kind, scenario, at_s, wanted) in scenarios {
            assert_eq!(stands(*kind, scenario, *at_s), *wanted, "{name}");
        }
    }

    #[test]
    fn what_comes_back_while_held_keeps_its_time() {
        let now = MachineTime::from_boot(Duration::from_secs(9));
        let at = |s| units::Utc::from_seconds(s);
        let mut states = AlertStates::default();
        assert!(states.raise(seconds(HELD.entry().on_delay_s), HELD.alert("x", at(1.0), "first"), now));
        assert!(states.clear(HELD, &HELD.id("x"), now));
        assert!(!states.raise(seconds(HELD.entry().on_delay_s), HELD.alert("x", at(2.0), "second"), now));
        let published = states.published(now).alerts;
        assert_eq!((published[0].raised_utc, published[0].cause.as_str()), (at(1.0), "second"));
    }

    #[test]
    fn the_next_change_is_the_end_of_a_delay_or_a_hold() {
        let now = MachineTime::from_boot(Duration::from_secs(9));
        let mut states = AlertStates::default();
        assert_eq!(states.next_change(now), None);
        states.raise(seconds(DELAYED.entry().on_delay_s), DELAYED.alert("x", units::Utc::EPOCH, "c"), now);
        assert_eq!(states.next_change(now), Some(seconds(DELAYED.entry().on_delay_s)));
    }

    #[test]
    fn the_most_urgent_comes_first_and_of_equally_urgent_ones_the_oldest() {
        let now = MachineTime::from_boot(Duration::from_secs(9));
        let mut states = AlertStates::default();
        let raised = [(AlertKind::Disk, "a", 1.0), (HELD, "younger", 3.0), (HELD, "older", 2.0)];
        for (kind, instance, raised_s) in raised {
            states.raise(
                seconds(kind.entry().on_delay_s),
                kind.alert(instance, units::Utc::from_seconds(raised_s), "c"),
                now,
            );
        }
        let ids: Vec<String> = states.published(now).alerts.into_iter().map(|alert| alert.id).collect();
        assert_eq!(ids, [HELD.id("older"), HELD.id("younger"), AlertKind::Disk.id("a")]);
    }

    #[test]
    fn a_held_alert_changes_next_when_its_hold_ends_and_never_after_that() {
        let now = MachineTime::from_boot(Duration::from_secs(9));
        let hold = seconds(HELD.entry().hold_s);
        let mut states = AlertStates::default();
        states.raise(seconds(HELD.entry().on_delay_s), HELD.alert("x", units::Utc::EPOCH, "c"), now);
        assert_eq!(states.next_change(now), None, "time alone changes no active alert");
        states.clear(HELD, &HELD.id("x"), now);
        assert_eq!(states.next_change(now), Some(hold));
        states.published(now.plus(hold));
        assert_eq!(states.next_change(now.plus(hold)), None);
    }
}
