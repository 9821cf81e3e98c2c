//! The alerts of one telescope, from every node that raised one.

use std::collections::BTreeMap;

use bus::MachineTime;
use contract::node::{self, NodeState, fallen_silent};
use contract::observatory::{Alert, AlertKind, Alerts, Priority, Standing};
use contract::{Key, Name, NodeTopic, Part, Role};
use schemars::JsonSchema;
use serde::{Deserialize as _, Serialize};
use serde_json::Value;
use units::Utc;

use crate::freshness::Quality;
use crate::model::{Entry, Telescope, short};
use crate::stopped::{StoppedTelescope, has_ended_well, is_over};

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
/// about what the site shares that count here as well. What a silent node of a telescope that was stopped and closed in good
/// order reported last needs nobody any more.
pub fn active(telescope: &Telescope, shared: Vec<Alert>, now: MachineTime) -> Vec<Alert> {
    if is_over(telescope) {
        return sorted(shared.into_iter());
    }
    let stopped = StoppedTelescope::of(telescope);
    let closed_utc = stopped.as_ref().filter(|stopped| stopped.is_closed()).map(|stopped| stopped.ended_utc);
    let mut found: BTreeMap<String, Alert> = BTreeMap::new();
    // The observatory node's own list contains what people did about each. An end in good order takes it back.
    let list = telescope.states.values().find(|entry| matches!(entry.key, Key::Observatory(_, Part::Alerts)));
    let list = list.filter(|_| stopped.is_none_or(|stopped| stopped.closed == Some(false)));
    for alert in list.map(published).unwrap_or_default() {
        found.entry(alert.id.clone()).or_insert(alert);
    }
    for LastWord { mut alert, silent } in last_words(telescope, now) {
        // The observatory node merges the alerts of the other nodes: the same alert may come twice.
        let is_same = |known: &Alert| {
            known.id == alert.id || (known.cause == alert.cause && known.raised_utc == alert.raised_utc)
        };
        let known = found.values().find(|known| is_same(known)).map(|known| (known.id.clone(), known.standing()));
        if let Some(silent) = silent {
            // It also merges those of the nodes that are silent, with what people did about them: if it has received them.
            if list.is_some_and(|list| has_heard(telescope, list, silent.arrived, now)) {
                continue;
            }
            match known {
                // One that began later takes what no node publishes to it for gone.
                Some((id, Standing::Gone)) => drop(found.remove(&id)),
                Some(_) => continue,
                None => {}
            }
            // What happened after all was closed, and before that node fell silent, stands.
            if closed_utc.is_some_and(|closed| alert.raised_utc < closed) {
                alert.returned_utc = alert.returned_utc.or(Some(silent.since));
            }
            alert.cause += &silent.words;
        } else if known.is_some() {
            continue;
        }
        found.entry(alert.id.clone()).or_insert(alert);
    }
    // After all lists: who published that a node is silent may know who sees to it.
    for entry in telescope.states.values() {
        let Key::Node(_, role, id, NodeTopic::State) = &entry.key else { continue };
        if entry.quality(now) == Quality::Lost && !has_ended_well(entry) {
            let host = entry.body.get("host").and_then(Value::as_str).unwrap_or_default();
            let cause = fallen_silent(&format!("the {role} node {id}"), host);
            let alert = AlertKind::NodeSilent.alert(node::name(*role, id), entry.at_utc, &cause);
            if found.get(&alert.id).is_none_or(|known| known.standing() == Standing::Gone) {
                found.insert(alert.id.clone(), alert);
            }
        }
    }
    for alert in shared {
        found.entry(alert.id.clone()).or_insert(alert);
    }
    sorted(found.into_values())
}

/// Does the node that publishes the observatory node's list go on, and has it received what a node published that is silent
/// since `last`?
fn has_heard(telescope: &Telescope, list: &Entry, last: MachineTime, now: MachineTime) -> bool {
    let is_its_own = |state: &&Entry| {
        matches!(state.key, Key::Node(_, Role::Observatory, _, NodeTopic::State)) && state.is_beside(list)
    };
    let state = telescope.states.values().find(is_its_own);
    let heard = state.and_then(|state| {
        let its = NodeState::deserialize(state.body.as_ref()).ok()?;
        Some(its.has_heard(state.age(now), now.since(last)))
    });
    list.quality(now) == Quality::Fresh && heard == Some(true)
}

/// An alert as its node published it last.
struct LastWord {
    alert: Alert,
    /// Where that node publishes no more.
    silent: Option<Silent>,
}

#[derive(Clone)]
struct Silent {
    since: Utc,
    /// When its last alerts arrived here.
    arrived: MachineTime,
    /// What is added to its causes.
    words: String,
}

/// What the nodes of a telescope published last of their alerts. An end in good order takes them back. Silence does not: the
/// shutter that a dead node could not close is still open.
fn last_words(telescope: &Telescope, now: MachineTime) -> impl Iterator<Item = LastWord> {
    let of = move |entry: &Entry| {
        let Key::Node(address, role, id, NodeTopic::Alerts) = &entry.key else { return Vec::new() };
        let state = short(&Key::Node(address.clone(), *role, id.clone(), NodeTopic::State));
        if telescope.states.get(&state).is_some_and(has_ended_well) {
            return Vec::new();
        }
        let silent = (entry.quality(now) == Quality::Lost).then(|| Silent {
            since: entry.at_utc,
            arrived: entry.arrived,
            words: format!("; last known, from the {role} node {id}, silent since {}", entry.at_utc.to_second()),
        });
        let last_word = |alert| LastWord { alert, silent: silent.clone() };
        published(entry).into_iter().map(last_word).collect()
    };
    telescope.states.values().flat_map(of)
}

fn published(entry: &Entry) -> Vec<Alert> {
    Alerts::deserialize(entry.body.as_ref()).unwrap_or_default().alerts
}

fn sorted(alerts: impl Iterator<Item = Alert>) -> Vec<Alert> {
    let mut alerts: Vec<Alert> = alerts.collect();
    Alert::sort_for_people(&mut alerts);
    alerts
}

/// Of the alerts that the nodes of a site's shared devices publish, those about these devices.
pub fn about<'a>(shared: &Telescope, devices: impl Iterator<Item = &'a Name> + Clone, now: MachineTime) -> Vec<Alert> {
    let is_about = |alert: &Alert| devices.clone().any(|name| alert.id.split('/').any(|part| part == name.as_str()));
    let told = last_words(shared, now).map(|LastWord { mut alert, silent }| {
        alert.cause += silent.as_ref().map_or("", |silent| silent.words.as_str());
        alert
    });
    sorted(told.filter(is_about))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use bus::Clock;
    use contract::Address;
    use serde_json::json;

    use super::*;
    use crate::model::tests::received;
    use crate::network::Network;

    fn ids(samples: &[(&str, Value)], now_s: u64) -> Vec<String> {
        shown(samples, now_s).into_iter().map(|alert| alert.id).collect()
    }

    fn shown(samples: &[(&str, Value)], now_s: u64) -> Vec<Alert> {
        shown_at(&samples.iter().map(|(key, body)| (*key, 100, body.clone())).collect::<Vec<_>>(), now_s)
    }

    /// With the second in which each sample came.
    fn shown_at(samples: &[(&str, u64, Value)], now_s: u64) -> Vec<Alert> {
        let address = Address::new("paranal", "callisto").unwrap();
        let network = Network::new(Clock::machine_clock(), address.clone());
        for (key, at_s, body) in samples {
            let boot = format!("b{at_s}");
            network.accept(received(&format!("paranal/callisto/{key}"), &boot, 0, *at_s, body.clone()));
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

    /// The alert of a device node of another account, which the observatory node does not hold; what became of that node.
    #[test]
    fn an_alert_ends_with_its_node_and_of_one_that_is_silent_it_is_the_last_that_is_known() {
        let alerts = "node/device/guest/alerts";
        let raised = || json!({ "alerts": [alert("dome-not-closed/dome", "critical")] });
        let told = |state: Value, more: &[(&str, u64, Value)], now_s| {
            let own = [("node/device/guest/state", 100, state), (alerts, 100, raised())];
            let shown = shown_at(&[&own[..], more].concat(), now_s);
            let found = shown.into_iter().find(|alert| alert.id == "dome-not-closed/dome");
            found.map(|alert| (alert.standing(), alert.cause))
        };
        let stopped = |closed: bool| json!({ "stopped": { "by": "a signal on pc", "closed": closed } });
        let own = |cause: &str| Some((Standing::Active, cause.to_owned()));
        assert_eq!(told(json!({}), &[], 101), own("c"));
        let last = "c; last known, from the device node guest, silent since 2027-01-15 08:01:40 UTC";
        assert_eq!(told(json!({}), &[], 9000), own(last), "silence takes nothing back");
        let list = ("observatory/alerts/state", 190, raised());
        let over = [list, ("node/observatory/main/state", 200, stopped(true))];
        let gone = Some((Standing::Gone, last.to_owned()));
        assert_eq!(told(json!({}), &over, 9000), gone, "all that closes was closed in good order since");
        let mut after = alert("dome-not-closed/dome", "critical");
        after["raised_utc"] = json!("2027-01-15T09:00:00Z");
        let after = [(alerts, 150, json!({ "alerts": [after] })), ("node/observatory/main/state", 120, stopped(true))];
        assert!(
            told(json!({}), &after, 9000).is_some_and(|(standing, _)| standing == Standing::Active),
            "raised since"
        );
        assert_eq!(told(stopped(true), &[], 101), None, "it ended in good order");
        assert_eq!(told(stopped(false), &[], 9000), own(last), "it left something open");
        let merged = |list: &Value, uptime_s: f64| {
            let (alerts, state) = ("observatory/alerts/state", "node/observatory/main/state");
            let its = json!({ "role": "observatory", "version": "", "host": "pc", "pid": 1, "uptime_s": uptime_s,
                "speed": 1.0 });
            [(alerts, 9000, json!({ "alerts": list })), (state, 9000, its)]
        };
        let (empty, mut returned) = (json!([]), alert("dome-not-closed/dome", "critical"));
        let heard = merged(&empty, 8911.0);
        assert_eq!(told(json!({}), &heard, 9000), None, "it knows that it is over");
        assert_eq!(told(json!({}), &heard, 9100), own(last), "nobody holds it any more");
        returned["returned_utc"] = json!("2027-01-15T10:20:00Z");
        for (list, why) in [(empty, "has never heard it"), (json!([returned]), "takes it for gone")] {
            let began_later = merged(&list, 8909.0);
            assert_eq!(told(json!({}), &began_later, 9000), own(last), "the observatory node {why}");
        }
        let mut answered = alert("dome-not-closed/dome", "critical");
        answered["acknowledged_by"] = json!("web/ana");
        let restarted = merged(&json!([answered]), 5.0);
        let seen_to = Some((Standing::SeenTo, "c".to_owned()));
        assert_eq!(told(json!({}), &restarted, 9000), seen_to, "its answer outlives a restart of the observatory node");
        let again = [(alerts, 9000, json!({ "alerts": [] }))];
        assert_eq!(told(json!({}), &again, 9000), None, "it was started again");
    }

    #[test]
    fn a_silent_node_has_the_text_of_the_node_that_published_its_silence() {
        let cause = "the device node main on host \"dome-pc\" has fallen silent";
        let state = || ("node/device/main/state", 100, json!({ "host": "dome-pc" }));
        let found = |more: &[(&str, u64, Value)]| {
            let shown = shown_at(&[&[state()][..], more].concat(), 130);
            shown.into_iter().map(|alert| (alert.id, alert.cause)).collect::<Vec<_>>()
        };
        let wanted = [("node-silent/device/main".to_owned(), cause.to_owned())];
        assert_eq!(found(&[]), wanted);
        let mut published = alert("node-silent/device/main", "high");
        published["cause"] = json!("as it was published");
        let list = ("node/web/main/alerts", 129, json!({ "alerts": [published] }));
        assert_eq!(found(&[list])[0].1, "as it was published");
    }
}
