//! The alerts of one telescope, from every node that raised one.

use std::collections::BTreeMap;

use bus::MachineTime;
use contract::node::Stopped;
use contract::observatory::{Alert, AlertKind, Alerts, Priority, Standing};
use contract::{Key, Name, NodeTopic, Part};
use schemars::JsonSchema;
use serde::{Deserialize as _, Serialize};

use crate::freshness::Quality;
use crate::model::{Entry, Telescope};

/// Alerts whose cause is there, by priority.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, JsonSchema, Serialize)]
#[allow(missing_docs, reason = "the words of the priorities")]
pub struct Counts {
    pub critical: usize,
    pub high: usize,
    pub medium: usize,
    pub advisory: usize,
}

impl Counts {
    /// Counts them.
    pub fn of(alerts: &[Alert]) -> Self {
        let stands = |alert: &&Alert| alert.standing() != Standing::Gone;
        let of = |priority| alerts.iter().filter(stands).filter(|alert| alert.priority == priority).count();
        Self {
            critical: of(Priority::Critical),
            high: of(Priority::High),
            medium: of(Priority::Medium),
            advisory: of(Priority::Advisory),
        }
    }
}

/// Alerts of the observatory node and of each node itself, and one for each node that fell silent. `shared` are the alerts
/// about what the site shares that count here as well.
pub fn active(telescope: &Telescope, shared: Vec<Alert>, now: MachineTime) -> Vec<Alert> {
    let mut found: BTreeMap<String, Alert> = BTreeMap::new();
    // The observatory node's own list contains what people did about each.
    let (first, then): (Vec<_>, Vec<_>) =
        telescope.states.values().partition(|entry| matches!(entry.key, Key::Observatory(..)));
    for entry in first.into_iter().chain(then) {
        match &entry.key {
            Key::Observatory(_, Part::Alerts) | Key::Node(_, _, _, NodeTopic::Alerts) => {
                let list = Alerts::deserialize(entry.body.as_ref()).unwrap_or_default();
                for alert in list.alerts {
                    // The observatory node merges the alerts of the other nodes: the same alert may come twice.
                    let known = found.values().any(|a| a.cause == alert.cause && a.raised_utc == alert.raised_utc);
                    if !known {
                        found.entry(alert.id.clone()).or_insert(alert);
                    }
                }
            }
            // A node that was stopped in good order has reported that it would be silent.
            Key::Node(_, role, id, NodeTopic::State)
                if entry.quality(now) == Quality::Lost
                    && stopped(entry).is_none_or(|stopped| stopped.closed == Some(false)) =>
            {
                let cause = format!("the {role} node {id} has fallen silent");
                let alert = AlertKind::NodeSilent.alert(format_args!("{role}/{id}"), entry.at_utc, &cause);
                // The observatory node notices it too, and knows who sees to it.
                if found.get(&alert.id).is_none_or(|known| known.standing() == Standing::Gone) {
                    found.insert(alert.id.clone(), alert);
                }
            }
            _ => {}
        }
    }
    for alert in shared {
        found.entry(alert.id.clone()).or_insert(alert);
    }
    sorted(found.into_values())
}

fn sorted(alerts: impl Iterator<Item = Alert>) -> Vec<Alert> {
    let mut alerts: Vec<Alert> = alerts.collect();
    Alert::sort_for_people(&mut alerts);
    alerts
}

/// How a node ended, where this is the last state of one that was asked to end.
pub fn stopped(entry: &Entry) -> Option<Stopped> {
    Stopped::deserialize(entry.body.get("stopped")?).ok()
}

/// Of the alerts that the nodes of a site's shared devices publish, those about these devices.
pub fn about<'a>(shared: &Telescope, devices: impl Iterator<Item = &'a Name> + Clone) -> Vec<Alert> {
    let is_about = |alert: &Alert| devices.clone().any(|name| alert.id.split('/').any(|part| part == name.as_str()));
    let of = |entry: &Entry| match &entry.key {
        Key::Node(_, _, _, NodeTopic::Alerts) => Alerts::deserialize(entry.body.as_ref()).unwrap_or_default().alerts,
        _ => Vec::new(),
    };
    sorted(shared.states.values().flat_map(of).filter(is_about))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use bus::Clock;
    use contract::Address;
    use serde_json::{Value, json};

    use super::*;
    use crate::model::tests::received;
    use crate::network::Network;

    fn ids(samples: &[(&str, Value)], now_s: u64) -> Vec<String> {
        shown(samples, now_s).into_iter().map(|alert| alert.id).collect()
    }

    fn shown(samples: &[(&str, Value)], now_s: u64) -> Vec<Alert> {
        let address = Address::new("paranal", "callisto").unwrap();
        let network = Network::new(Clock::machine_clock(), address.clone());
        for (key, body) in samples {
            network.accept(received(&format!("paranal/callisto/{key}"), "b", 0, 100, body.clone()));
        }
        let now = MachineTime::from_boot(Duration::from_secs(now_s));
        active(&network.read().telescopes[&address], Vec::new(), now)
    }

    fn alert(id: &str, priority: &str) -> Value {
        let raised = "2026-11-21T03:12:45Z";
        json!({"id": id, "priority": priority, "raised_utc": raised, "cause": "c", "consequence": "", "action": ""})
    }

    #[test]
    fn an_alert_that_the_observatory_repeats_for_another_node_stands_once() {
        let own = json!({ "alerts": [alert("spool-full/andor", "medium")] });
        let merged = json!({ "alerts": [alert("device/main/spool-full/andor", "medium")] });
        let samples = [("node/device/main/alerts", own), ("observatory/alerts/state", merged)];
        assert_eq!(ids(&samples, 101).len(), 1);
    }

    #[test]
    fn the_most_urgent_stands_first_and_silence_does_not_clear_it() {
        let mut low = alert("low", "advisory");
        low["cause"] = json!("another");
        let samples = [("observatory/alerts/state", json!({ "alerts": [low, alert("high", "critical")] }))];
        assert_eq!(ids(&samples, 100_000), ["high", "low"]);
    }

    #[test]
    fn what_is_over_stands_last_and_is_not_counted() {
        let mut over = alert("over", "critical");
        (over["returned_utc"], over["cause"]) = (json!("2026-11-21T03:20:00Z"), json!("another"));
        let list = json!({ "alerts": [over, alert("now", "medium")] });
        let alerts = shown(&[("observatory/alerts/state", list)], 100);
        assert_eq!(alerts.iter().map(|alert| alert.id.as_str()).collect::<Vec<_>>(), ["now", "over"]);
        assert_eq!(Counts::of(&alerts), Counts { medium: 1, ..Counts::default() });
    }

    #[test]
    fn a_silent_node_that_somebody_sees_to_calls_nobody_else() {
        let of = |key: &str, value: &str| {
            let mut silent = alert("node-silent/archive/main", "high");
            silent[key] = json!(value);
            let list = json!({ "alerts": [silent] });
            let samples = [("node/archive/main/state", json!({})), ("observatory/alerts/state", list)];
            shown(&samples, 130).into_iter().map(|alert| alert.standing()).collect::<Vec<_>>()
        };
        assert_eq!(of("acknowledged_by", "web/ana"), [Standing::SeenTo]);
        assert_eq!(of("returned_utc", "2026-11-21T03:20:00Z"), [Standing::Active]);
    }

    #[test]
    fn a_node_that_falls_silent_is_an_alert() {
        let samples = [("node/archive/main/state", json!({}))];
        assert!(ids(&samples, 110).is_empty());
        assert_eq!(ids(&samples, 130), ["node-silent/archive/main"]);
    }

    #[test]
    fn a_node_that_was_stopped_in_good_order_is_no_alert_unless_it_left_something_open() {
        let of = |stopped: Value| ids(&[("node/device/enclosure/state", json!({ "stopped": stopped }))], 9000);
        assert!(of(json!({ "by": "starmesh up on dome-pc", "closed": true })).is_empty());
        assert!(of(json!({ "by": "starmesh up on dome-pc" })).is_empty());
        assert_eq!(of(json!({ "by": "a signal on dome-pc", "closed": false })), ["node-silent/device/enclosure"]);
    }
}
