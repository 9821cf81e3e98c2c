//! People's answers to alerts: acknowledged, shelved, and those that returned before anybody looked.
//!
//! ```text
//!            ┌────────── acknowledge ──────────▶ acknowledged ── cause gone ──▶ cleared
//!  raised ───┤
//!            └─ cause gone, critical or high ──▶ returned ────── acknowledge ─▶ cleared
//! ```
//! Shelved alerts are kept apart: nobody is notified of one until its shelving expires or somebody takes it back. The
//! verdict and the guards use nothing of this. The state survives a restart of the node.

use std::collections::{BTreeMap, BTreeSet};

use contract::observatory::{self as published, Alert, Alerts, LAST_WORD, Notification, Priority};
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::ordered_by::OrderedBy;

/// The longest that an alert can be shelved, sky s.
pub const LONGEST_SHELF_S: f64 = 24.0 * 3600.0;

/// The alerts with what people did about them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Annunciator {
    /// By id: as they were received, with acknowledgement and return.
    #[serde(default)]
    alerts: BTreeMap<String, Alert>,
    /// By id of the alert; what is shelved may come and go meanwhile.
    #[serde(default)]
    shelved: BTreeMap<String, Shelved>,
    /// The notifications that people got of these alerts, from this incarnation or another: the notifier goes on where
    /// that ended.
    #[serde(default)]
    notifications: Vec<Notification>,
    /// Ids from the incarnation before that this one has not received: their nodes may not have published yet, or are
    /// silent.
    #[serde(skip)]
    awaited: BTreeSet<String>,
}

/// One shelved alert.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Shelved {
    #[serde(flatten)]
    ordered_by: OrderedBy,
    until_utc: Utc,
}

impl Annunciator {
    /// Takes the alerts that all nodes publish now. `heard` are the nodes (`ROLE/NODE`) that this incarnation has received
    /// from, once every node had time to publish: what the incarnation before knew from these, and none publishes, is
    /// gone. What it knew from another node stands, since nobody was told that it ended.
    pub fn observe(&mut self, active: &Alerts, heard: Option<&BTreeSet<String>>, now: Utc) {
        self.shelved.retain(|_, shelved| holds(shelved, now));
        if let Some(heard) = heard {
            let alerts = &mut self.alerts;
            self.awaited.retain(|id| alerts.get_mut(id).is_some_and(|alert| is_last_word(alert, heard, now)));
        }
        for alert in &active.alerts {
            self.awaited.remove(&alert.id);
            let known = self.alerts.get(&alert.id);
            let mut alert = alert.clone();
            if let Some(known) = known {
                alert.acknowledged_by.clone_from(&known.acknowledged_by);
                alert.acknowledged_utc = known.acknowledged_utc;
                // One alert of several nodes is active since the first of them raised it.
                alert.raised_utc = known.raised_utc;
            }
            self.alerts.insert(alert.id.clone(), alert);
        }
        let (shelved, awaited) = (&self.shelved, &self.awaited);
        self.alerts.retain(|id, alert| {
            if awaited.contains(id) || active.alerts.iter().any(|alert| alert.id == *id) {
                return true;
            }
            let urgent = alert.priority <= Priority::High;
            let waits = urgent && alert.acknowledged_by.is_none() && !shelved.contains_key(id);
            if waits && alert.returned_utc.is_none() {
                alert.returned_utc = Some(now);
            }
            waits
        });
        let list =
            |notifications: &[Notification]| Alerts { alerts: Vec::new(), notifications: notifications.to_vec() };
        self.notifications =
            published::merge([list(&self.notifications), list(&active.notifications)].into_iter()).notifications;
        let alerts = &self.alerts;
        self.notifications.retain(|notification| alerts.contains_key(&notification.id));
    }

    /// Somebody knows of it. A returned one is thereby done with.
    pub fn acknowledge(&mut self, id: &str, ordered_by: &OrderedBy) -> Result<(), String> {
        let Some(alert) = self.alerts.get_mut(id) else { return Err(self.unknown(id)) };
        if alert.returned_utc.is_some() {
            self.alerts.remove(id);
        } else if alert.acknowledged_by.is_none() {
            alert.acknowledged_by = Some(ordered_by.from.clone());
            alert.acknowledged_utc = Some(ordered_by.at_utc);
        }
        Ok(())
    }

    /// Silence takes nothing back: the shutter that a dead node could not close is still open. Of the last alerts of a
    /// node that is silent, those that a person has acknowledged are dropped when nobody remembers them any more.
    pub fn stand_on(&self, last: &mut Alerts, now: Utc) {
        let is_acknowledged = |id: &str| self.alerts.get(id).is_some_and(|alert| alert.acknowledged_by.is_some());
        last.alerts.retain_mut(|alert| !(is_long_missed(alert, now) && is_acknowledged(&alert.id)));
    }

    /// Suppresses notifications of it for so many sky seconds.
    pub fn shelve(&mut self, id: &str, for_s: f64, ordered_by: OrderedBy) -> Result<(), String> {
        if !self.alerts.contains_key(id) {
            return Err(self.unknown(id));
        }
        if ordered_by.reason.trim().is_empty() {
            return Err("shelving needs a reason".to_owned());
        }
        if !(for_s > 0.0 && for_s <= LONGEST_SHELF_S) {
            return Err(format!("for_s = {for_s}: expected more than 0 and at most {LONGEST_SHELF_S} s"));
        }
        let until_utc = ordered_by.at_utc.plus_seconds(for_s);
        self.shelved.insert(id.to_owned(), Shelved { ordered_by, until_utc });
        Ok(())
    }

    /// Ends its shelving.
    pub fn unshelve(&mut self, id: &str) -> Result<(), String> {
        match self.shelved.remove(id) {
            Some(_) => Ok(()),
            None => Err(format!("\"{id}\" is not shelved; {}", listed("shelved", self.shelved.keys()))),
        }
    }

    /// The alerts to publish, the most urgent first, with the notifications that people got of them.
    pub fn published(&self, now: Utc) -> Alerts {
        let mut alerts: Vec<Alert> = self.alerts.values().cloned().collect();
        for alert in &mut alerts {
            if let Some(shelved) = self.shelved.get(&alert.id).filter(|shelved| holds(shelved, now)) {
                alert.shelved_by = Some(shelved.ordered_by.from.clone());
                alert.shelved_until_utc = Some(shelved.until_utc);
                alert.shelved_reason = Some(shelved.ordered_by.reason.clone());
            }
        }
        alerts.sort_by(|a, b| (a.priority, a.raised_utc, &a.id).cmp(&(b.priority, b.raised_utc, &b.id)));
        Alerts { alerts, notifications: self.notifications.clone() }
    }

    fn unknown(&self, id: &str) -> String {
        format!("no alert \"{id}\" is active; {}", listed("active", self.alerts.keys()))
    }

    /// The last state of a commander on another host: its alerts as people received them, and the shelved ones.
    pub fn from_published(alerts: &Alerts, shelf: &[published::Shelved]) -> Self {
        let notifications = alerts.notifications.clone();
        let alerts = alerts.alerts.iter().cloned().map(|mut alert| {
            // The published list of shelved alerts holds this.
            (alert.shelved_by, alert.shelved_until_utc, alert.shelved_reason) = (None, None, None);
            (alert.id.clone(), alert)
        });
        let shelved = shelf.iter().map(|shelved| {
            let ordered_by = OrderedBy::from(shelved.ordered.clone());
            (shelved.alert.clone(), Shelved { ordered_by, until_utc: shelved.until_utc })
        });
        Self { alerts: alerts.collect(), shelved: shelved.collect(), notifications, ..Self::default() }
            .of_the_boot_before()
    }

    /// The shelved alerts, as they are published.
    pub fn shelf(&self) -> Vec<published::Shelved> {
        let shelf = self.shelved.iter().map(|(id, shelved)| {
            let (alert, ordered) = (id.clone(), shelved.ordered_by.clone().into());
            published::Shelved { alert, until_utc: shelved.until_utc, ordered }
        });
        shelf.collect()
    }

    /// The persisted state of an earlier incarnation, for the one that goes on with it: until every node had time to
    /// publish, nothing is gone.
    pub fn of_the_boot_before(self) -> Self {
        Self { awaited: self.alerts.keys().cloned().collect(), ..self }
    }
}

/// Does it stand because nothing was received from its node? An acknowledged one does as long as pages and nodes that
/// stand in remember it: without the acknowledgement it would be new to them.
fn is_last_word(alert: &mut Alert, heard: &BTreeSet<String>, now: Utc) -> bool {
    if alert.returned_utc.is_some() || alert.node.as_ref().is_none_or(|node| heard.contains(node)) {
        return false;
    }
    !(is_long_missed(alert, now) && alert.acknowledged_by.is_some())
}

/// Is the node of this alert, which is silent, missed for longer than others remember it?
fn is_long_missed(alert: &mut Alert, now: Utc) -> bool {
    now.seconds_since(*alert.missed_since_utc.get_or_insert(now)) > LAST_WORD.as_secs_f64()
}

/// A clock that was set back cannot make a shelving last longer than an order may.
fn holds(shelved: &Shelved, now: Utc) -> bool {
    let left_s = shelved.until_utc.seconds_since(now);
    left_s > 0.0 && left_s <= LONGEST_SHELF_S
}

fn listed<'a>(what: &str, ids: impl Iterator<Item = &'a String>) -> String {
    let ids: Vec<&str> = ids.map(String::as_str).collect();
    if ids.is_empty() { format!("none is {what}") } else { format!("{what}: {}", ids.join(", ")) }
}

#[cfg(test)]
mod tests {
    use contract::observatory::{AlertEvent, AlertKind};

    use super::*;

    const URGENT: AlertKind = AlertKind::DomeNotClosed;
    const MILD: AlertKind = AlertKind::CoolingFailed;
    /// Every node had time to publish, and none has.
    static NO_NODE: BTreeSet<String> = BTreeSet::new();

    fn at(seconds: f64) -> Utc {
        Utc::from_seconds(seconds)
    }

    fn ordered_by(seconds: f64) -> OrderedBy {
        OrderedBy { from: "web/ana".to_owned(), reason: "known".to_owned(), at_utc: at(seconds) }
    }

    /// The steps of a scenario, one each sky second.
    enum Step {
        Up(AlertKind),
        Down,
        Restart,
        Ack(AlertKind),
        Shelve(AlertKind, f64),
        Unshelve(AlertKind),
        Wait(f64),
    }
    use Step::*;

    /// The state of the first published alert after the scenario: letters for acknowledged, shelved, returned; `-` for
    /// none.
    fn play(scenario: Vec<Step>) -> String {
        let (mut annunciator, mut now, mut active) = (Annunciator::default(), 0.0, Alerts::default());
        for step in scenario {
            now += 1.0;
            match step {
                Up(kind) => active.alerts = vec![kind.alert("x", at(now), "c")],
                Down => active.alerts.clear(),
                Restart => {
                    let text = serde_json::to_vec(&annunciator).unwrap();
                    annunciator = serde_json::from_slice::<Annunciator>(&text).unwrap().of_the_boot_before();
                    annunciator.observe(&Alerts::default(), None, at(now));
                }
                Ack(kind) => annunciator.acknowledge(&kind.id("x"), &ordered_by(now)).unwrap(),
                Shelve(kind, for_s) => annunciator.shelve(&kind.id("x"), for_s, ordered_by(now)).unwrap(),
                Unshelve(kind) => annunciator.unshelve(&kind.id("x")).unwrap(),
                Wait(seconds) => now += seconds,
            }
            annunciator.observe(&active, None, at(now));
        }
        let published = annunciator.published(at(now)).alerts;
        let Some(alert) = published.first() else { return "-".to_owned() };
        let marks = [
            ("acknowledged", alert.acknowledged_by.is_some()),
            ("shelved", alert.shelved_until_utc.is_some()),
            ("returned", alert.returned_utc.is_some()),
        ];
        let marks: Vec<&str> = marks.iter().filter(|(_, is)| *is).map(|(word, _)| *word).collect();
        if marks.is_empty() { "raised".to_owned() } else { marks.join(" ") }
    }

    #[test]
    fn alerts_follow_the_scenarios() {
        let scenarios: Vec<(&str, Vec<Step>, &str)> = vec![
            ("a mild one clears at once", vec![Up(MILD), Down], "-"),
            ("an urgent one that nobody saw stays as returned", vec![Up(URGENT), Down], "returned"),
            ("until it is acknowledged", vec![Up(URGENT), Down, Ack(URGENT)], "-"),
            ("acknowledged first, it clears with its cause", vec![Up(URGENT), Ack(URGENT), Down], "-"),
            ("and stands until then", vec![Up(URGENT), Ack(URGENT)], "acknowledged"),
            ("what came back is raised", vec![Up(URGENT), Down, Up(URGENT)], "raised"),
            ("a new one needs a new acknowledgement", vec![Up(URGENT), Ack(URGENT), Down, Up(URGENT)], "raised"),
            ("an acknowledgement outlives a restart", vec![Up(URGENT), Ack(URGENT), Restart], "acknowledged"),
            ("so does a return", vec![Up(URGENT), Down, Restart, Wait(9.0)], "returned"),
            ("a shelved one says so", vec![Up(URGENT), Shelve(URGENT, 60.0)], "shelved"),
            ("also after a restart", vec![Up(URGENT), Shelve(URGENT, 60.0), Restart], "shelved"),
            ("a shelf ends", vec![Up(URGENT), Shelve(URGENT, 60.0), Wait(60.0)], "raised"),
            ("or is ended", vec![Up(URGENT), Shelve(URGENT, 60.0), Unshelve(URGENT)], "raised"),
            ("a shelved one clears with its cause", vec![Up(URGENT), Shelve(URGENT, 60.0), Down], "-"),
            ("and is on the shelf when it comes again", vec![Up(MILD), Shelve(MILD, 60.0), Down, Up(MILD)], "shelved"),
        ];
        for (name, scenario, wanted) in scenarios {
            assert_eq!(play(scenario), wanted, "{name}");
        }
    }

    #[test]
    fn what_the_earlier_incarnation_knew_is_gone_once_every_node_had_time_to_publish() {
        let mut annunciator = Annunciator::default();
        annunciator.observe(
            &Alerts { alerts: vec![MILD.alert("x", at(0.0), "c")], ..Alerts::default() },
            Some(&NO_NODE),
            at(0.0),
        );
        let mut annunciator = annunciator.of_the_boot_before();
        annunciator.observe(&Alerts::default(), None, at(1.0));
        assert_eq!(annunciator.published(at(1.0)).alerts.len(), 1);
        annunciator.observe(&Alerts::default(), Some(&NO_NODE), at(60.0));
        assert_eq!(annunciator.published(at(60.0)).alerts.len(), 0);
    }

    #[test]
    fn notifications_outlive_the_incarnation_that_sent_them_and_end_with_the_alert() {
        let notification = |event, second| Notification {
            receiver: "chat".to_owned(),
            id: URGENT.id("d"),
            raised_utc: at(0.0),
            event,
            sent_utc: at(second),
        };
        let alerts = vec![URGENT.alert("d", at(0.0), "c")];
        let mut annunciator = Annunciator::default();
        annunciator.observe(
            &Alerts { alerts: alerts.clone(), notifications: vec![notification(AlertEvent::Raised, 1.0)] },
            Some(&NO_NODE),
            at(1.0),
        );
        let text = serde_json::to_vec(&annunciator).unwrap();
        let mut next = serde_json::from_slice::<Annunciator>(&text).unwrap().of_the_boot_before();
        // Its own nodes have not published yet.
        next.observe(&Alerts::default(), None, at(2.0));
        assert_eq!(next.published(at(2.0)).notifications, [notification(AlertEvent::Raised, 1.0)]);
        let standby = Annunciator::from_published(&annunciator.published(at(2.0)), &[]);
        assert_eq!(standby.published(at(2.0)), annunciator.published(at(2.0)));
        // A later notification takes the place of it, and an older one does not.
        next.observe(
            &Alerts { alerts: alerts.clone(), notifications: vec![notification(AlertEvent::Acknowledged, 3.0)] },
            Some(&NO_NODE),
            at(3.0),
        );
        let older = vec![notification(AlertEvent::Raised, 1.0)];
        next.observe(&Alerts { alerts, notifications: older }, Some(&NO_NODE), at(4.0));
        assert_eq!(next.published(at(4.0)).notifications, [notification(AlertEvent::Acknowledged, 3.0)]);
        next.acknowledge(&URGENT.id("d"), &ordered_by(5.0)).unwrap();
        next.observe(
            &Alerts { alerts: Vec::new(), notifications: vec![notification(AlertEvent::Acknowledged, 3.0)] },
            Some(&NO_NODE),
            at(6.0),
        );
        assert_eq!(next.published(at(6.0)), Alerts::default(), "an alert that is over was sent for the last time");
    }

    #[test]
    fn what_another_host_published_last_goes_on_unchanged() {
        let mut annunciator = Annunciator::default();
        annunciator.observe(
            &Alerts {
                alerts: vec![URGENT.alert("d", at(0.0), "c"), MILD.alert("x", at(0.0), "c")],
                ..Alerts::default()
            },
            Some(&NO_NODE),
            at(0.0),
        );
        annunciator.acknowledge("dome-not-closed/d", &ordered_by(1.0)).unwrap();
        annunciator.shelve("cooling-failed/x", 60.0, ordered_by(1.0)).unwrap();
        let mut next = Annunciator::from_published(&annunciator.published(at(2.0)), &annunciator.shelf());
        assert_eq!(next.published(at(2.0)), annunciator.published(at(2.0)));
        // Its own nodes have not published yet.
        next.observe(&Alerts::default(), None, at(3.0));
        assert_eq!(next.published(at(3.0)), annunciator.published(at(3.0)));
        assert_eq!(next.shelf(), annunciator.shelf());
    }

    #[test]
    fn orders_about_what_does_not_stand_are_refused_with_what_does() {
        let mut annunciator = Annunciator::default();
        annunciator.observe(
            &Alerts { alerts: vec![MILD.alert("cam", at(0.0), "c")], ..Alerts::default() },
            Some(&NO_NODE),
            at(0.0),
        );
        let errors = [
            annunciator.acknowledge("twin", &ordered_by(1.0)).unwrap_err(),
            annunciator.shelve("twin", 60.0, ordered_by(1.0)).unwrap_err(),
        ];
        for error in errors {
            assert_eq!(error, "no alert \"twin\" is active; active: cooling-failed/cam");
        }
        assert!(annunciator.unshelve("cooling-failed/cam").unwrap_err().contains("none is shelved"));
        let silent = OrderedBy { reason: " ".to_owned(), ..ordered_by(1.0) };
        assert!(annunciator.shelve("cooling-failed/cam", 60.0, silent).unwrap_err().contains("reason"));
        for for_s in [0.0, -1.0, f64::NAN, LONGEST_SHELF_S + 1.0] {
            assert!(
                annunciator
                    .shelve("cooling-failed/cam", for_s, ordered_by(1.0))
                    .unwrap_err()
                    .contains("expected more than 0")
            );
        }
    }

    #[test]
    fn silence_takes_nothing_back_and_what_a_person_knows_of_stands_as_long_as_others_remember_it() {
        let alert = URGENT.alert("dome", at(0.0), "the shutter sticks");
        let mut last = Alerts { alerts: vec![alert.clone()], ..Alerts::default() };
        let mut known = Annunciator::default();
        let mut stands = |known: &mut Annunciator, now| {
            known.stand_on(&mut last, at(now));
            known.observe(&last, Some(&NO_NODE), at(now));
            known.published(at(now)).alerts.pop().map(|alert| alert.acknowledged_by.is_some())
        };
        let long = LAST_WORD.as_secs_f64();
        assert_eq!([0.0, 1.0 + long].map(|now| stands(&mut known, now)), [Some(false); 2], "nobody knows of it");
        known.acknowledge(&alert.id, &ordered_by(1.0 + long)).unwrap();
        assert_eq!(stands(&mut known, 1.0 + long), None, "it is forgotten elsewhere");

        let mut last = Alerts { alerts: vec![alert.clone()], ..Alerts::default() };
        let mut known = Annunciator::default();
        known.observe(&last, Some(&NO_NODE), at(0.0));
        known.acknowledge(&alert.id, &ordered_by(0.0)).unwrap();
        for (now, wanted) in [(1.0, 1), (1.0 + long, 1), (2.0 + long, 0)] {
            known.stand_on(&mut last, at(now));
            known.observe(&last, Some(&NO_NODE), at(now));
            assert_eq!(known.published(at(now)).alerts.len(), wanted, "{now}");
        }
    }

    #[test]
    fn the_last_word_of_a_node_that_died_before_a_restart_stands_with_its_answer_until_that_node_is_heard() {
        let long = LAST_WORD.as_secs_f64();
        let (x, other) = (BTreeSet::from(["device/x".to_owned()]), BTreeSet::from(["device/other".to_owned()]));
        // At 9 s every node had time to publish.
        let play = |kind: AlertKind, node: Option<&str>, acknowledged: bool, heard: &BTreeSet<String>, until: f64| {
            let alert = Alert { node: node.map(str::to_owned), ..kind.alert("x", at(0.0), "c") };
            let mut before = Annunciator::default();
            before.observe(&Alerts { alerts: vec![alert], ..Alerts::default() }, Some(&NO_NODE), at(0.0));
            if acknowledged {
                before.acknowledge(&kind.id("x"), &ordered_by(1.0)).unwrap();
            }
            let text = serde_json::to_vec(&before).unwrap();
            let mut known = serde_json::from_slice::<Annunciator>(&text).unwrap().of_the_boot_before();
            known.observe(&Alerts::default(), None, at(2.0));
            known.observe(&Alerts::default(), Some(&other), at(9.0));
            known.observe(&Alerts::default(), Some(heard), at(until));
            let published = known.published(at(until)).alerts.pop();
            published.map(|alert| (alert.acknowledged_by.is_some(), alert.returned_utc.is_some()))
        };
        let dead = Some("device/x");
        for (name, result, wanted) in [
            ("nobody knows of it", play(URGENT, dead, false, &other, 10.0), Some((false, false))),
            ("nor ever", play(URGENT, dead, false, &other, 10.0 + long), Some((false, false))),
            ("a mild one, too", play(MILD, dead, false, &other, 10.0), Some((false, false))),
            ("somebody sees to it", play(URGENT, dead, true, &other, 10.0), Some((true, false))),
            ("until all have forgotten it", play(URGENT, dead, true, &other, 10.0 + long), None),
            ("its node is back without it", play(URGENT, dead, true, &x, 10.0), None),
            ("and nobody knew of it", play(URGENT, dead, false, &x, 10.0), Some((false, true))),
            ("a record without a node", play(URGENT, None, false, &other, 10.0), Some((false, true))),
        ] {
            assert_eq!(result, wanted, "{name}");
        }
    }
}
