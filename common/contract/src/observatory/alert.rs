//! What needs a person.

use std::time::Duration;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::Payload;

/// So long a page remembers the alerts of a node that fell silent: what people answered to them is kept as long.
pub const LAST_WORD: Duration = Duration::from_secs(14 * 24 * 3600);

/// How urgent an alert is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Priority {
    /// Act now: people or hardware are in danger.
    Critical,
    /// Act within minutes: the night is being lost.
    High,
    /// Act tonight.
    Medium,
    /// For information; nothing is urgent.
    Advisory,
}

impl Priority {
    /// Its word, the same in payloads, in messages, at the command line and on the page.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Critical => "critical",
            Self::High => "high",
            Self::Medium => "medium",
            Self::Advisory => "advisory",
        }
    }
}

/// The alerts that stand, at each change and every 10 s.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
pub struct Alerts {
    /// Active alerts, the most urgent first.
    pub alerts: Vec<Alert>,
    /// The notifications that were sent, so that a node which sends from now on does not send them again.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notifications: Vec<Notification>,
}

/// The last notification of an active alert to a receiver.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Notification {
    /// The receiver's name in the configuration.
    pub receiver: String,
    /// Which alert.
    pub id: String,
    /// Sky time when that alert was raised: one raised later under this id is another.
    pub raised_utc: Utc,
    /// The text of the message.
    pub event: AlertEvent,
    /// Sky time when it arrived there.
    pub sent_utc: Utc,
}

/// What happened to an alert.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AlertEvent {
    /// It stands and nobody has acknowledged it.
    Raised,
    /// Somebody sees to it.
    Acknowledged,
    /// Its cause is gone, and nobody had acknowledged it.
    Returned,
    /// It is over.
    Cleared,
}

impl AlertEvent {
    /// The event as a word of the messages.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Raised => "raised",
            Self::Acknowledged => "acknowledged",
            Self::Returned => "returned",
            Self::Cleared => "cleared",
        }
    }
}

impl Payload for Alerts {
    const NAME: &'static str = "alerts";
}

/// One alert.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Alert {
    /// Names the cause, such as `dome-not-closed/dome_1`; the same cause is one alert.
    pub id: String,
    /// How urgent.
    pub priority: Priority,
    /// Sky time when it was raised.
    pub raised_utc: Utc,
    /// What happened.
    pub cause: String,
    /// What follows from it.
    pub consequence: String,
    /// What a person should do.
    pub action: String,
    /// Sky time when its cause went, of one that nobody has acknowledged yet; absent while the cause is there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub returned_utc: Option<Utc>,
    /// The person who knows of it and sees to it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acknowledged_by: Option<String>,
    /// Sky time since when somebody does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acknowledged_utc: Option<Utc>,
    /// The person who shelved it, so that it is sent to nobody for a while.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shelved_by: Option<String>,
    /// Sky time until which it lies there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shelved_until_utc: Option<Utc>,
    /// Why.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shelved_reason: Option<String>,
    /// In the observatory node's list: the node that reported it, as `ROLE/NODE`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node: Option<String>,
    /// Sky time since when that node is missed: the alert is the last that is known from it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub missed_since_utc: Option<Utc>,
}

/// Whom an alert needs, in the order in which people should see them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Standing {
    /// Its cause is there, and nobody sees to it.
    Active,
    /// Its cause is there, and somebody sees to it or has shelved it.
    SeenTo,
    /// Its cause is gone; it stays until somebody acknowledges it.
    Gone,
}

impl Alert {
    /// Whether it needs somebody now.
    pub fn standing(&self) -> Standing {
        if self.returned_utc.is_some() {
            Standing::Gone
        } else if self.acknowledged_by.is_some() || self.shelved_by.is_some() {
            Standing::SeenTo
        } else {
            Standing::Active
        }
    }

    /// Sorts alerts for people: those that need somebody first and those whose cause is gone last; of each the most urgent
    /// first, then the oldest.
    pub fn sort_for_people(alerts: &mut [Self]) {
        alerts.sort_by(|a, b| {
            (a.standing(), a.priority, a.raised_utc, &a.id).cmp(&(b.standing(), b.priority, b.raised_utc, &b.id))
        });
    }
}

/// One list of several, the most urgent first; of two with one id the more urgent, then the older. Of the notifications
/// of one alert to one receiver the last one counts.
pub fn merge(lists: impl Iterator<Item = Alerts>) -> Alerts {
    let (mut all, mut notifications) = (Vec::new(), Vec::new());
    for list in lists {
        all.extend(list.alerts);
        notifications.extend(list.notifications);
    }
    all.sort_by(|a, b| (a.priority, a.raised_utc, &a.id).cmp(&(b.priority, b.raised_utc, &b.id)));
    let mut seen = std::collections::BTreeSet::new();
    all.retain(|alert: &Alert| seen.insert(alert.id.clone()));
    notifications.sort_by(|a: &Notification, b: &Notification| {
        (&a.receiver, &a.id, b.sent_utc).cmp(&(&b.receiver, &b.id, a.sent_utc))
    });
    notifications.dedup_by(|later, first| (&later.receiver, &later.id) == (&first.receiver, &first.id));
    Alerts { alerts: all, notifications }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observatory::AlertKind;

    #[test]
    fn one_cause_is_one_alert_and_the_most_urgent_comes_first() {
        let alert = |kind: AlertKind, at_s| kind.alert("a", Utc::from_seconds(at_s), "c");
        let notification = |receiver: &str, event, sent_s| Notification {
            receiver: receiver.to_owned(),
            id: "dome-held/a".to_owned(),
            raised_utc: Utc::from_seconds(3.0),
            event,
            sent_utc: Utc::from_seconds(sent_s),
        };
        let ours = Alerts {
            alerts: vec![alert(AlertKind::CoolingFailed, 1.0), alert(AlertKind::DomeHeld, 3.0)],
            notifications: vec![
                notification("chat", AlertEvent::Raised, 4.0),
                notification("ana", AlertEvent::Raised, 4.0),
            ],
        };
        let theirs = Alerts {
            alerts: vec![alert(AlertKind::DomeHeld, 2.0), alert(AlertKind::DomeNotClosed, 9.0)],
            notifications: vec![notification("chat", AlertEvent::Acknowledged, 5.0)],
        };
        let merged = merge([ours, theirs].into_iter());
        let last = [notification("ana", AlertEvent::Raised, 4.0), notification("chat", AlertEvent::Acknowledged, 5.0)];
        assert_eq!(merged.notifications, last);
        let found: Vec<_> =
            merged.alerts.iter().map(|a| (a.id.as_str(), a.raised_utc.seconds_since(Utc::EPOCH))).collect();
        assert_eq!(found, [("dome-not-closed/a", 9.0), ("dome-held/a", 2.0), ("cooling-failed/a", 1.0)]);
    }

    #[test]
    fn people_see_first_what_needs_somebody_and_last_what_is_over() {
        let at = Utc::from_seconds;
        let alert = |kind: AlertKind, name: &str, at_s| kind.alert(name, at(at_s), "c");
        let gone = Alert { returned_utc: Some(at(9.0)), ..alert(AlertKind::DomeNotClosed, "gone", 1.0) };
        let over = Alert { acknowledged_by: Some("ana".to_owned()), ..gone.clone() };
        let seen = Alert { acknowledged_by: Some("ana".to_owned()), ..alert(AlertKind::DomeNotClosed, "seen", 2.0) };
        let shelved = Alert { shelved_by: Some("ben".to_owned()), ..alert(AlertKind::DomeHeld, "shelved", 1.0) };
        assert_eq!(
            [&gone, &over, &seen, &shelved].map(Alert::standing),
            [Standing::Gone, Standing::Gone, Standing::SeenTo, Standing::SeenTo]
        );
        let mild = alert(AlertKind::CoolingFailed, "mild", 1.0);
        let held = |name, at_s| alert(AlertKind::DomeHeld, name, at_s);
        let mut alerts = vec![gone, shelved, seen, mild, held("b", 4.0), held("a", 3.0)];
        Alert::sort_for_people(&mut alerts);
        let ids: Vec<&str> = alerts.iter().map(|alert| alert.id.as_str()).collect();
        let (active, others) = ids.split_at(3);
        assert_eq!(active, ["dome-held/a", "dome-held/b", "cooling-failed/mild"]);
        assert_eq!(others, ["dome-not-closed/seen", "dome-held/shelved", "dome-not-closed/gone"]);
    }
}
