//! What needs a person.

use serde::{Deserialize, Serialize};
use units::Utc;

use crate::Payload;

/// How urgent an alert is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Priority {
    /// Act now: people or hardware are in danger.
    Critical,
    /// Act within minutes: the night is being lost.
    High,
    /// Act tonight.
    Medium,
    /// Know it.
    Advisory,
}

impl Priority {
    /// The priority as messages and tables show it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Critical => "CRITICAL",
            Self::High => "high",
            Self::Medium => "medium",
            Self::Advisory => "advisory",
        }
    }
}

/// The alerts that stand, at each change and every 10 s.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Alerts {
    /// Standing alerts, the most urgent first.
    pub alerts: Vec<Alert>,
    /// What was told of them to whom, so that a node which sends from now on does not tell it again.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub told: Vec<Told>,
}

/// What a receiver was told last of an alert that stands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Told {
    /// The receiver's name in the configuration.
    pub receiver: String,
    /// Which alert.
    pub id: String,
    /// Sky time when that alert was raised: one raised later under this id is another.
    pub raised_utc: Utc,
    /// What the message said.
    pub event: AlertEvent,
    /// Sky time when it arrived there.
    pub told_utc: Utc,
}

/// What happened to an alert.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
    /// Who knows of it and sees to it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acknowledged_by: Option<String>,
    /// Sky time since when somebody does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acknowledged_utc: Option<Utc>,
    /// Who put it on the shelf, so that nobody is told of it for a while.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shelved_by: Option<String>,
    /// Sky time until which it lies there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shelved_until_utc: Option<Utc>,
    /// Why.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shelved_reason: Option<String>,
}

/// One list of several, the most urgent first; of two with one id the more urgent, then the older. What one receiver was
/// told of one alert is what it was told last.
pub fn merge(lists: impl Iterator<Item = Alerts>) -> Alerts {
    let (mut all, mut told) = (Vec::new(), Vec::new());
    for list in lists {
        all.extend(list.alerts);
        told.extend(list.told);
    }
    all.sort_by(|a, b| (a.priority, a.raised_utc, &a.id).cmp(&(b.priority, b.raised_utc, &b.id)));
    let mut seen = std::collections::BTreeSet::new();
    all.retain(|alert: &Alert| seen.insert(alert.id.clone()));
    told.sort_by(|a: &Told, b: &Told| (&a.receiver, &a.id, b.told_utc).cmp(&(&b.receiver, &b.id, a.told_utc)));
    told.dedup_by(|later, first| (&later.receiver, &later.id) == (&first.receiver, &first.id));
    Alerts { alerts: all, told }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observatory::AlertKind;

    #[test]
    fn one_cause_is_one_alert_and_the_most_urgent_comes_first() {
        let alert = |kind: AlertKind, at_s| kind.alert("a", Utc::from_seconds(at_s), "c");
        let told = |receiver: &str, event, told_s| Told {
            receiver: receiver.to_owned(),
            id: "dome-held/a".to_owned(),
            raised_utc: Utc::from_seconds(3.0),
            event,
            told_utc: Utc::from_seconds(told_s),
        };
        let ours = Alerts {
            alerts: vec![alert(AlertKind::CoolingFailed, 1.0), alert(AlertKind::DomeHeld, 3.0)],
            told: vec![told("chat", AlertEvent::Raised, 4.0), told("ana", AlertEvent::Raised, 4.0)],
        };
        let theirs = Alerts {
            alerts: vec![alert(AlertKind::DomeHeld, 2.0), alert(AlertKind::DomeNotClosed, 9.0)],
            told: vec![told("chat", AlertEvent::Acknowledged, 5.0)],
        };
        let merged = merge([ours, theirs].into_iter());
        let last = [told("ana", AlertEvent::Raised, 4.0), told("chat", AlertEvent::Acknowledged, 5.0)];
        assert_eq!(merged.told, last);
        let found: Vec<_> =
            merged.alerts.iter().map(|a| (a.id.as_str(), a.raised_utc.seconds_since(Utc::EPOCH))).collect();
        assert_eq!(found, [("dome-not-closed/a", 9.0), ("dome-held/a", 2.0), ("cooling-failed/a", 1.0)]);
    }
}
