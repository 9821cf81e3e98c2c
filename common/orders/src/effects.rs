//! What is seen of an order that closes: the observatory node shows it, and the guards say whether their domes are closed.

use std::collections::BTreeMap;
use std::time::Duration;

use bus::MachineTime;
use contract::observatory::{NightState, Posture};
use contract::{BootId, CommandId, Device, Name};
use units::Utc;

use crate::TakenBy;

/// An observatory node publishes each second which order it took last.
pub(crate) const SHOWN_WITHIN: Duration = Duration::from_secs(10);
/// A guard publishes each second: what it said so long ago says nothing of its dome now.
const YOUNG: Duration = Duration::from_secs(3);

/// What a guard said last of its dome.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reading {
    pub(crate) arrived: MachineTime,
    pub(crate) closed: Option<bool>,
}

impl Reading {
    /// Does it say that the dome is closed now?
    fn is_closed(&self, now: MachineTime) -> bool {
        self.closed == Some(true) && now.since(self.arrived) < YOUNG
    }
}

/// Those of these domes that no guard reports closed now.
pub(crate) fn still_open(domes: &[Device], guards: &BTreeMap<Device, Reading>, now: MachineTime) -> Vec<Device> {
    let is_closed = |dome: &Device| guards.get(dome).is_some_and(|reading| reading.is_closed(now));
    domes.iter().filter(|dome| !is_closed(dome)).cloned().collect()
}

/// What was seen of an order that closes since it was given. Pure: time comes in.
#[derive(Default)]
pub(crate) struct Effects {
    /// When the observatory node showed the order last.
    pub(crate) shown: Option<MachineTime>,
    /// When it showed it first.
    first_shown: Option<MachineTime>,
    pub(crate) posture: Option<Posture>,
    /// What the guards of its domes said last.
    pub(crate) guards: BTreeMap<Device, Reading>,
    /// The domes that the observatory node names in permits, also those whose device nodes are gone since: the names of all
    /// whose guards it has heard, with the incarnations of these. An own and a shared dome may have one name.
    permitted: BTreeMap<Name, Vec<(BootId, MachineTime)>>,
}

impl Effects {
    pub(crate) fn see_night(&mut self, night: &NightState, order: &CommandId, given_utc: Utc, arrived: MachineTime) {
        if shows(night, order, given_utc) {
            (self.shown, self.posture) = (Some(arrived), Some(night.posture));
            self.first_shown.get_or_insert(arrived);
        }
    }

    pub(crate) fn see_permit(&mut self, dome: Name, guard: BootId, arrived: MachineTime) {
        let guards = self.permitted.entry(dome).or_default();
        // Of a guard that was restarted only the newest incarnation goes on being answered.
        guards.retain(|(known, at)| *known != guard && arrived.since(*at) < YOUNG);
        guards.push((guard, arrived));
    }

    /// Has the observatory node fallen silent since it showed the order? It publishes each second.
    pub(crate) fn has_ended(&self, now: MachineTime) -> bool {
        self.shown.is_some_and(|at| now.since(at) > SHOWN_WITHIN)
    }

    /// Who has closed, once all is verified closed.
    pub(crate) fn closed(&self, now: MachineTime) -> Option<TakenBy> {
        let first_shown = self.first_shown?;
        if self.posture == Some(Posture::Closed) && !self.has_ended(now) {
            // The observatory node may not have noticed yet that a guard has died, which said that its dome is open, nor that
            // a dome had begun to open when it took the order: a guard says so after that.
            let agrees = |reading: &Reading| reading.closed != Some(false) && reading.arrived >= first_shown;
            return self.guards.values().all(agrees).then_some(TakenBy::Observatory);
        }
        // A dome that the observatory node never heard is in no permit, and makes its posture unknown. Whatever a guard
        // says 10 s after the order was shown, and is young, it said after the order.
        let are_known = self.posture != Some(Posture::Unknown);
        let by_guards = self.has_ended(now) && are_known && self.open(now).is_empty();
        by_guards.then(|| TakenBy::Ended(self.guards.keys().cloned().collect()))
    }

    /// The domes that no guard reports closed now, for people.
    pub(crate) fn open(&self, now: MachineTime) -> Vec<String> {
        let silent = |dome: String| format!("{dome} (its guard does not report how it is)");
        let unnamed = self.permitted.is_empty().then(|| "its domes, which are not known".to_owned());
        let heard = self.guards.iter().filter(|(_, reading)| !reading.is_closed(now));
        let heard = heard.map(|(dome, reading)| match reading.closed {
            Some(false) => dome.to_string(),
            Some(true) | None => silent(dome.to_string()),
        });
        let heard_of = |name: &Name| self.guards.keys().filter(|dome| dome.name == *name).count();
        let unheard = self.permitted.iter().filter(|(name, guards)| heard_of(name) < guards.len());
        let unheard = unheard.map(|(name, _)| silent(name.to_string()));
        unnamed.into_iter().chain(heard).chain(unheard).collect()
    }
}

/// Does the observatory node show the order? Somebody else may publish in its name: only a sample that contains the order
/// counts, or one that was taken later and so is shown in its place.
fn shows(night: &NightState, order: &CommandId, given_utc: Utc) -> bool {
    night.last_order.as_ref().is_some_and(|last| last.id == *order || last.at_utc >= given_utc)
}

#[cfg(test)]
mod tests {
    use contract::Address;
    use contract::observatory::OrderTaken;

    use super::*;

    #[test]
    fn an_order_is_shown_by_itself_or_by_one_that_was_taken_after_it() {
        let sample = include_str!("../../contract/golden/v1/observatory.night.json");
        let mut night: NightState = serde_json::from_str(sample).unwrap();
        let given = Utc::from_seconds(1_000.0);
        let [ours, another] = [CommandId::fresh(), CommandId::fresh()];
        let mut shown = |last: Option<(&CommandId, f64)>| {
            night.last_order = last.map(|(id, at_s)| OrderTaken {
                id: id.clone(),
                from: "web/olga".to_owned(),
                verb: "close".to_owned(),
                at_utc: Utc::from_seconds(at_s),
                night: None,
            });
            shows(&night, &ours, given)
        };
        assert!(!shown(None));
        assert!(!shown(Some((&another, 999.0))), "from before");
        assert!(shown(Some((&ours, 1_001.0))));
        assert!(shown(Some((&another, 1_002.0))), "it came after ours");
    }

    fn at(seconds: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(seconds))
    }

    fn dome(name: &str) -> Device {
        Address::new("paranal", "callisto").unwrap().device(contract::Kind::Dome, &name.parse().unwrap())
    }

    fn reading(closed: Option<bool>, arrived_s: u64) -> Reading {
        Reading { arrived: at(arrived_s), closed }
    }

    /// The observatory node has shown the order at 100 s, with this posture, and permits one dome.
    fn shown(posture: Posture) -> Effects {
        let sample = include_str!("../../contract/golden/v1/observatory.night.json");
        let mut night: NightState = serde_json::from_str(sample).unwrap();
        let ours = CommandId::fresh();
        night.posture = posture;
        if let Some(last) = &mut night.last_order {
            last.id = ours.clone();
        }
        let mut seen = Effects::default();
        seen.see_permit(dome("dome_1").name, BootId::fresh(), at(100));
        seen.see_night(&night, &ours, Utc::from_seconds(1_000.0), at(100));
        seen
    }

    #[test]
    fn an_order_whose_observatory_node_ends_is_closed_by_the_guards_of_its_domes_or_not_closed_and_never_forgotten() {
        let mut seen = Effects::default();
        seen.guards.insert(dome("dome_1"), reading(Some(true), 160));
        assert_eq!(seen.closed(at(160)), None, "nobody has shown the order");
        // It was asked to end, or killed, while it closed.
        let mut seen = shown(Posture::Closing);
        for (name, closed, arrived_s, now_s, wanted) in [
            ("it may still say that covers or the mount are open", Some(true), 110, 110, None),
            ("its guard goes on, and has closed", Some(true), 111, 111, Some(TakenBy::Ended(vec![dome("dome_1")]))),
            ("its guard has not closed yet", Some(false), 111, 111, None),
            ("its guard does not report it", None, 111, 111, None),
            ("its guard said so before the order, and died", Some(true), 99, 111, None),
            ("its guard died since", Some(true), 111, 114, None),
        ] {
            seen.guards.insert(dome("dome_1"), reading(closed, arrived_s));
            assert_eq!(seen.closed(at(now_s)), wanted, "{name}");
        }
        assert!(seen.has_ended(at(111)) && !seen.has_ended(at(110)));
        let mut seen = shown(Posture::Closed);
        for (closed, wanted) in [(None, Some(TakenBy::Observatory)), (Some(false), None)] {
            seen.guards.insert(dome("dome_1"), reading(closed, 101));
            assert_eq!(seen.closed(at(101)), wanted, "{closed:?}");
        }
        assert_eq!(seen.closed(at(109)), None, "its guard is gone, and nobody has said since that it is closed");
        seen.guards.insert(dome("dome_1"), reading(Some(true), 110));
        assert_eq!(seen.closed(at(110)), Some(TakenBy::Observatory));
        assert_eq!(seen.closed(at(113)), None, "both are gone");
    }

    #[test]
    fn what_a_guard_said_before_the_order_was_shown_does_not_verify_it() {
        let mut seen = shown(Posture::Closed);
        for (name, closed, arrived_s, wanted) in [
            ("a dome may have begun to open since", Some(true), 99, None),
            ("it was opening when the order was taken", Some(false), 101, None),
            ("closed after the order", Some(true), 102, Some(TakenBy::Observatory)),
        ] {
            seen.guards.insert(dome("dome_1"), reading(closed, arrived_s));
            assert_eq!(seen.closed(at(102)), wanted, "{name}");
        }
    }

    #[test]
    fn a_telescope_whose_domes_are_not_all_known_to_be_closed_is_not_and_says_which() {
        let mut seen = shown(Posture::Closing);
        seen.guards.insert(dome("dome_1"), reading(Some(true), 111));
        seen.see_permit(dome("dome_2").name, BootId::fresh(), at(100));
        assert_eq!(seen.closed(at(111)), None, "the device node of the second one was dead before");
        assert_eq!(seen.open(at(111)), ["dome_2 (its guard does not report how it is)"]);
        seen.guards.insert(dome("dome_2"), reading(Some(true), 112));
        assert_eq!(seen.closed(at(112)), Some(TakenBy::Ended(vec![dome("dome_1"), dome("dome_2")])));
        seen.guards.insert(dome("dome_1"), reading(Some(false), 112));
        assert_eq!(
            seen.open(at(116)),
            ["paranal/callisto/dome/dome_1", "paranal/callisto/dome/dome_2 (its guard does not report how it is)"]
        );
        for (name, mut seen) in [
            ("the observatory node has never heard one of its domes", shown(Posture::Unknown)),
            ("it has named none", Effects { permitted: BTreeMap::new(), ..shown(Posture::Closing) }),
        ] {
            seen.guards.insert(dome("dome_1"), reading(Some(true), 111));
            assert_eq!(seen.closed(at(111)), None, "{name}");
        }
    }

    #[test]
    fn an_own_and_a_shared_dome_of_one_name_are_closed_once_the_guards_of_both_say_so() {
        let shared = Address::new("paranal", "shared").unwrap().device(contract::Kind::Dome, &dome("dome_1").name);
        let mut seen = shown(Posture::Closing);
        seen.see_permit(shared.name.clone(), BootId::fresh(), at(100));
        seen.guards.insert(dome("dome_1"), reading(Some(true), 111));
        assert_eq!(seen.closed(at(111)), None, "the device node of the shared one was dead before");
        assert_eq!(seen.open(at(111)), ["dome_1 (its guard does not report how it is)"]);
        seen.guards.insert(shared.clone(), reading(Some(true), 111));
        assert_eq!(seen.closed(at(111)), Some(TakenBy::Ended(vec![dome("dome_1"), shared])));
        // The guard of an own one that was restarted is one all the same.
        let mut seen = shown(Posture::Closing);
        seen.see_permit(dome("dome_1").name, BootId::fresh(), at(103));
        seen.guards.insert(dome("dome_1"), reading(Some(true), 114));
        assert_eq!(seen.closed(at(114)), Some(TakenBy::Ended(vec![dome("dome_1")])));
    }

    #[test]
    fn domes_that_were_commanded_are_closed_once_the_guards_of_all_of_them_say_so_now() {
        let domes = [dome("dome_1"), dome("dome_2")];
        let mut guards: BTreeMap<Device, Reading> = [(dome("dome_1"), reading(Some(true), 10))].into();
        assert_eq!(still_open(&domes, &guards, at(10)), [dome("dome_2")]);
        guards.insert(dome("dome_2"), reading(Some(true), 12));
        assert!(still_open(&domes, &guards, at(12)).is_empty());
        guards.insert(dome("dome_2"), reading(Some(true), 13));
        assert_eq!(still_open(&domes, &guards, at(13)), [dome("dome_1")], "its guard has died");
    }
}
