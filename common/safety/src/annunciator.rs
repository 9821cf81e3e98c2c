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

use contract::observatory::{self as standing, Alert, Alerts, Priority, Told};
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::said::Said;

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
    told: Vec<Told>,
    /// Ids from the incarnation before that this one has not received: their nodes may not have published yet.
    #[serde(skip)]
    awaited: BTreeSet<String>,
}

/// One shelved alert.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Shelved {
    #[serde(flatten)]
    said: Said,
    until_utc: Utc,
}

impl Annunciator {
    /// Takes the alerts that all nodes publish now. With `settled`, every node had time to publish, so that an alert
    /// that the incarnation before knew and no node publishes is gone.
    pub fn hear(&mut self, standing: &Alerts, settled: bool, now: Utc) {
        self.shelved.retain(|_, shelved| holds(shelved, now));
        if settled {
            self.awaited.clear();
        }
        for alert in &standing.alerts {
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
            if awaited.contains(id) || standing.alerts.iter().any(|standing| standing.id == *id) {
                return true;
            }
            let urgent = alert.priority <= Priority::High;
            let waits = urgent && alert.acknowledged_by.is_none() && !shelved.contains_key(id);
            if waits && alert.returned_utc.is_none() {
                alert.returned_utc = Some(now);
            }
            waits
        });
        let told = |told: &[Told]| Alerts { alerts: Vec::new(), told: told.to_vec() };
        self.told = standing::merge([told(&self.told), told(&standing.told)].into_iter()).told;
        let alerts = &self.alerts;
        self.told.retain(|told| alerts.contains_key(&told.id));
    }

    /// Somebody knows of it. A returned one is thereby done with.
    pub fn acknowledge(&mut self, id: &str, said: &Said) -> Result<(), String> {
        let Some(alert) = self.alerts.get_mut(id) else { return Err(self.unknown(id)) };
        if alert.returned_utc.is_some() {
            self.alerts.remove(id);
        } else if alert.acknowledged_by.is_none() {
            alert.acknowledged_by = Some(said.from.clone());
            alert.acknowledged_utc = Some(said.at_utc);
        }
        Ok(())
    }

    /// Silence takes nothing back: the shutter that a dead node could not close is still open. Of the last alerts of a
    /// node that is away, only those that a person has acknowledged are dropped.
    pub fn stand_on(&self, said_last: &mut Alerts) {
        said_last.alerts.retain(|alert| !self.is_acknowledged(&alert.id));
    }

    fn is_acknowledged(&self, id: &str) -> bool {
        self.alerts.get(id).is_some_and(|alert| alert.acknowledged_by.is_some())
    }

    /// Suppresses notifications of it for so many sky seconds.
    pub fn shelve(&mut self, id: &str, for_s: f64, said: Said) -> Result<(), String> {
        if !self.alerts.contains_key(id) {
            return Err(self.unknown(id));
        }
        if said.reason.trim().is_empty() {
            return Err("shelving needs a reason".to_owned());
        }
        if !(for_s > 0.0 && for_s <= LONGEST_SHELF_S) {
            return Err(format!("for_s = {for_s}: expected more than 0 and at most {LONGEST_SHELF_S} s"));
        }
        let until_utc = said.at_utc.plus_seconds(for_s);
        self.shelved.insert(id.to_owned(), Shelved { said, until_utc });
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
    pub fn shown(&self, now: Utc) -> Alerts {
        let mut alerts: Vec<Alert> = self.alerts.values().cloned().collect();
        for alert in &mut alerts {
            if let Some(shelved) = self.shelved.get(&alert.id).filter(|shelved| holds(shelved, now)) {
                alert.shelved_by = Some(shelved.said.from.clone());
                alert.shelved_until_utc = Some(shelved.until_utc);
                alert.shelved_reason = Some(shelved.said.reason.clone());
            }
        }
        alerts.sort_by(|a, b| (a.priority, a.raised_utc, &a.id).cmp(&(b.priority, b.raised_utc, &b.id)));
        Alerts { alerts, told: self.told.clone() }
    }

    fn unknown(&self, id: &str) -> String {
        format!("no alert \"{id}\" stands; {}", listed("standing", self.alerts.keys()))
    }

    /// The last state of a commander on another host: its alerts as people received them, and the shelved ones.
    pub fn heard(alerts: &Alerts, shelf: &[standing::Shelved]) -> Self {
        let told = alerts.told.clone();
        let alerts = alerts.alerts.iter().cloned().map(|mut alert| {
            // The published list of shelved alerts holds this.
            (alert.shelved_by, alert.shelved_until_utc, alert.shelved_reason) = (None, None, None);
            (alert.id.clone(), alert)
        });
        let shelved = shelf.iter().map(|shelved| {
            let said = Said::from(shelved.ordered.clone());
            (shelved.alert.clone(), Shelved { said, until_utc: shelved.until_utc })
        });
        Self { alerts: alerts.collect(), shelved: shelved.collect(), told, ..Self::default() }.of_the_life_before()
    }

    /// The shelved alerts, as they are published.
    pub fn shelf(&self) -> Vec<standing::Shelved> {
        let shelf = self.shelved.iter().map(|(id, shelved)| {
            let (alert, ordered) = (id.clone(), shelved.said.clone().into());
            standing::Shelved { alert, until_utc: shelved.until_utc, ordered }
        });
        shelf.collect()
    }

    /// The persisted state of an earlier incarnation, for the one that goes on with it: until every node had time to
    /// publish, nothing is gone.
    pub fn of_the_life_before(self) -> Self {
        Self { awaited: self.alerts.keys().cloned().collect(), ..self }
    }
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

    fn at(seconds: f64) -> Utc {
        Utc::from_seconds(seconds)
    }

    fn said(seconds: f64) -> Said {
        Said { from: "web/ana".to_owned(), reason: "known".to_owned(), at_utc: at(seconds) }
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
    fn tell(story: Vec<Step>) -> String {
        let (mut desk, mut now, mut standing) = (Annunciator::default(), 0.0, Alerts::default());
        for step in story {
            now += 1.0;
            match step {
                Up(kind) => standing.alerts = vec![kind.alert("x", at(now), "c")],
                Down => standing.alerts.clear(),
                Restart => {
                    let text = serde_json::to_vec(&desk).unwrap();
                    desk = serde_json::from_slice::<Annunciator>(&text).unwrap().of_the_life_before();
                    desk.hear(&Alerts::default(), false, at(now));
                }
                Ack(kind) => desk.acknowledge(&kind.id("x"), &said(now)).unwrap(),
                Shelve(kind, for_s) => desk.shelve(&kind.id("x"), for_s, said(now)).unwrap(),
                Unshelve(kind) => desk.unshelve(&kind.id("x")).unwrap(),
                Wait(seconds) => now += seconds,
            }
            desk.hear(&standing, false, at(now));
        }
        let shown = desk.shown(at(now)).alerts;
        let Some(alert) = shown.first() else { return "-".to_owned() };
        let marks = [
            ("acknowledged", alert.acknowledged_by.is_some()),
            ("shelved", alert.shelved_until_utc.is_some()),
            ("returned", alert.returned_utc.is_some()),
        ];
        let marks: Vec<&str> = marks.iter().filter(|(_, is)| *is).map(|(word, _)| *word).collect();
        if marks.is_empty() { "raised".to_owned() } else { marks.join(" ") }
    }

    #[test]
    fn alerts_live_as_the_stories_say() {
        let stories: Vec<(&str, Vec<Step>, &str)> = vec![
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
        for (name, story, wanted) in stories {
            assert_eq!(tell(story), wanted, "{name}");
        }
    }

    #[test]
    fn what_the_life_before_knew_is_gone_once_every_node_had_time_to_speak() {
        let mut desk = Annunciator::default();
        desk.hear(&Alerts { alerts: vec![MILD.alert("x", at(0.0), "c")], ..Alerts::default() }, true, at(0.0));
        let mut desk = desk.of_the_life_before();
        desk.hear(&Alerts::default(), false, at(1.0));
        assert_eq!(desk.shown(at(1.0)).alerts.len(), 1);
        desk.hear(&Alerts::default(), true, at(60.0));
        assert_eq!(desk.shown(at(60.0)).alerts.len(), 0);
    }

    #[test]
    fn what_people_were_told_outlives_the_life_that_told_it_and_ends_with_the_alert() {
        let told = |event, second| Told {
            receiver: "chat".to_owned(),
            id: URGENT.id("d"),
            raised_utc: at(0.0),
            event,
            told_utc: at(second),
        };
        let alerts = vec![URGENT.alert("d", at(0.0), "c")];
        let mut desk = Annunciator::default();
        desk.hear(&Alerts { alerts: alerts.clone(), told: vec![told(AlertEvent::Raised, 1.0)] }, true, at(1.0));
        let text = serde_json::to_vec(&desk).unwrap();
        let mut next = serde_json::from_slice::<Annunciator>(&text).unwrap().of_the_life_before();
        // Its own nodes have not published yet.
        next.hear(&Alerts::default(), false, at(2.0));
        assert_eq!(next.shown(at(2.0)).told, [told(AlertEvent::Raised, 1.0)]);
        let standby = Annunciator::heard(&desk.shown(at(2.0)), &[]);
        assert_eq!(standby.shown(at(2.0)), desk.shown(at(2.0)));
        // A later notification takes the place of it, and an older one does not.
        next.hear(&Alerts { alerts: alerts.clone(), told: vec![told(AlertEvent::Acknowledged, 3.0)] }, true, at(3.0));
        next.hear(&Alerts { alerts, told: vec![told(AlertEvent::Raised, 1.0)] }, true, at(4.0));
        assert_eq!(next.shown(at(4.0)).told, [told(AlertEvent::Acknowledged, 3.0)]);
        next.acknowledge(&URGENT.id("d"), &said(5.0)).unwrap();
        next.hear(&Alerts { alerts: Vec::new(), told: vec![told(AlertEvent::Acknowledged, 3.0)] }, true, at(6.0));
        assert_eq!(next.shown(at(6.0)), Alerts::default(), "an alert that is over was told of for the last time");
    }

    #[test]
    fn what_another_host_said_last_goes_on_as_it_stood() {
        let mut desk = Annunciator::default();
        desk.hear(
            &Alerts {
                alerts: vec![URGENT.alert("d", at(0.0), "c"), MILD.alert("x", at(0.0), "c")],
                ..Alerts::default()
            },
            true,
            at(0.0),
        );
        desk.acknowledge("dome-not-closed/d", &said(1.0)).unwrap();
        desk.shelve("cooling-failed/x", 60.0, said(1.0)).unwrap();
        let mut next = Annunciator::heard(&desk.shown(at(2.0)), &desk.shelf());
        assert_eq!(next.shown(at(2.0)), desk.shown(at(2.0)));
        // Its own nodes have not published yet.
        next.hear(&Alerts::default(), false, at(3.0));
        assert_eq!(next.shown(at(3.0)), desk.shown(at(3.0)));
        assert_eq!(next.shelf(), desk.shelf());
    }

    #[test]
    fn orders_about_what_does_not_stand_are_refused_with_what_does() {
        let mut desk = Annunciator::default();
        desk.hear(&Alerts { alerts: vec![MILD.alert("cam", at(0.0), "c")], ..Alerts::default() }, true, at(0.0));
        let errors =
            [desk.acknowledge("twin", &said(1.0)).unwrap_err(), desk.shelve("twin", 60.0, said(1.0)).unwrap_err()];
        for error in errors {
            assert_eq!(error, "no alert \"twin\" stands; standing: cooling-failed/cam");
        }
        assert!(desk.unshelve("cooling-failed/cam").unwrap_err().contains("none is shelved"));
        let silent = Said { reason: " ".to_owned(), ..said(1.0) };
        assert!(desk.shelve("cooling-failed/cam", 60.0, silent).unwrap_err().contains("reason"));
        for for_s in [0.0, -1.0, f64::NAN, LONGEST_SHELF_S + 1.0] {
            assert!(desk.shelve("cooling-failed/cam", for_s, said(1.0)).unwrap_err().contains("expected more than 0"));
        }
    }

    #[test]
    fn silence_takes_nothing_back_but_what_a_person_knows_of() {
        let now = at(0.0);
        let alert = URGENT.alert("dome", now, "the shutter sticks");
        let mut alerts = Alerts { alerts: vec![alert.clone()], ..Alerts::default() };
        let mut known = Annunciator::default();
        known.hear(&alerts, true, now);
        known.stand_on(&mut alerts);
        assert_eq!(alerts.alerts.len(), 1);
        known.acknowledge(&alert.id, &said(0.0)).unwrap();
        known.stand_on(&mut alerts);
        known.hear(&alerts, true, now);
        assert_eq!((alerts.alerts.len(), known.shown(now).alerts.len()), (0, 0));
    }
}
