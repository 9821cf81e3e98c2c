//! The on-delay and the hold of a node's own alerts: an alert is published after the on-delay and gone after the hold.

use std::collections::BTreeMap;
use std::time::Duration;

use contract::observatory::{Alert, AlertKind, Alerts};

use crate::MachineTime;

/// What has been raised. Pure: time comes in.
#[derive(Debug, Default)]
pub(crate) struct AlertLife {
    raised: BTreeMap<String, Raised>,
}

/// ```text
///          on-delay            cleared            hold
///  waiting ───────▶ standing ─────────▶ holding ───────▶ gone
///     └── cleared: gone  ▲─────── raised ──┘
/// ```
#[derive(Debug)]
struct Raised {
    alert: Alert,
    show_at: MachineTime,
    gone_at: Option<MachineTime>,
}

impl AlertLife {
    /// Takes an alert; one that is there keeps its time and takes the new cause. True for a new one.
    pub fn raise(&mut self, kind: AlertKind, mut alert: Alert, now: MachineTime) -> bool {
        let known = self.raised.get(&alert.id);
        let is_new = known.is_none();
        let show_at = match known {
            Some(known) => {
                alert.raised_utc = known.alert.raised_utc;
                known.show_at
            }
            None => now.plus(seconds(kind.entry().on_delay_s)),
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
    pub fn shown(&mut self, now: MachineTime) -> Alerts {
        self.raised.retain(|_, raised| raised.gone_at.is_none_or(|at| at > now));
        let shown = self.raised.values().filter(|raised| raised.show_at <= now);
        let mut alerts: Vec<Alert> = shown.map(|raised| raised.alert.clone()).collect();
        alerts.sort_by_key(|alert| (alert.priority, alert.raised_utc));
        Alerts { alerts, told: Vec::new() }
    }

    /// How long until time alone changes the active alerts.
    pub fn next_change(&self, now: MachineTime) -> Option<Duration> {
        let times = self.raised.values().filter_map(|raised| raised.gone_at.or(Some(raised.show_at)));
        times.filter(|at| *at > now).map(|at| at.since(now)).min()
    }
}

fn seconds(seconds: u16) -> Duration {
    Duration::from_secs(u64::from(seconds))
}

#[cfg(test)]
mod tests {
    use super::*;

    const DELAYED: AlertKind = AlertKind::NodeSilent;
    const HELD: AlertKind = AlertKind::DomeUncommandedOpen;

    /// Plays `+` (raise) and `-` (clear) at machine seconds, and returns whether it is active at `at_s`.
    fn stands(kind: AlertKind, story: &[(u64, char)], at_s: u64) -> bool {
        let at = |s| MachineTime::from_boot(Duration::from_secs(1000 + s));
        let mut life = AlertLife::default();
        for (time, what) in story {
            if *what == '+' {
                life.raise(kind, kind.alert("x", units::Utc::EPOCH, "c"), at(*time));
            } else {
                life.clear(kind, &kind.id("x"), at(*time));
            }
            life.shown(at(*time));
        }
        !life.shown(at(at_s)).alerts.is_empty()
    }

    /// Name, kind, what happens at which second, when it is looked at, whether it is active then.
    type Story<'a> = (&'a str, AlertKind, &'a [(u64, char)], u64, bool);

    #[test]
    fn an_alert_lives_as_its_row_says() {
        let (delay, hold) = (u64::from(DELAYED.entry().on_delay_s), u64::from(HELD.entry().hold_s));
        assert!(delay > 1 && hold > 1);
        let stories: &[Story] = &[
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
        for (name, kind, story, at_s, wanted) in stories {
            assert_eq!(stands(*kind, story, *at_s), *wanted, "{name}");
        }
    }

    #[test]
    fn what_comes_back_while_held_keeps_its_time() {
        let now = MachineTime::from_boot(Duration::from_secs(9));
        let at = |s| units::Utc::from_seconds(s);
        let mut life = AlertLife::default();
        assert!(life.raise(HELD, HELD.alert("x", at(1.0), "first"), now));
        assert!(life.clear(HELD, &HELD.id("x"), now));
        assert!(!life.raise(HELD, HELD.alert("x", at(2.0), "second"), now));
        let shown = life.shown(now).alerts;
        assert_eq!((shown[0].raised_utc, shown[0].cause.as_str()), (at(1.0), "second"));
    }

    #[test]
    fn the_next_change_is_the_end_of_a_delay_or_a_hold() {
        let now = MachineTime::from_boot(Duration::from_secs(9));
        let mut life = AlertLife::default();
        assert_eq!(life.next_change(now), None);
        life.raise(DELAYED, DELAYED.alert("x", units::Utc::EPOCH, "c"), now);
        assert_eq!(life.next_change(now), Some(seconds(DELAYED.entry().on_delay_s)));
    }
}
