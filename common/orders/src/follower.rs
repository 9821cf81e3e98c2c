//! Follows one telescope while an order is given: what its observatory node and the guards of its domes show.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use bus::{Bus, BusError, Catch, Clock, MachineTime, Received, Subscriber};
use contract::device::dome::Guard;
use contract::observatory::{NightState, OrderTaken, Permit, Posture};
use contract::{Address, CommandId, Device, Key, Name, Order, OrderKind, Part, Topic};
use units::Utc;

use crate::{TakenBy, domes, replaced_by_words};

/// An observatory node publishes each second which order it took last.
const SHOWN_WITHIN: Duration = Duration::from_secs(10);
/// A guard publishes each second: what it said so long ago says nothing of its dome now.
const YOUNG: Duration = Duration::from_secs(3);

/// Who goes on where no observatory node does, and until when.
const GUARDS_GO_ON: &str = "without a permit the guard of each dome goes on to ask it to close until that is verified, as \
                            long as the dome's device node runs. Look at the dome, and close it at its own controls";

/// Why a telescope is not verified closed after an order that closes.
#[derive(Debug, thiserror::Error)]
pub enum NotClosed {
    /// Somebody accepted the order, and it is not the observatory node.
    #[error(
        "NOT VERIFIED: somebody answered \"accepted\", but the observatory node of {address} does not show the order after {} s. \
         Look at the dome, and close it at its own controls",
        SHOWN_WITHIN.as_secs()
    )]
    NotShown {
        /// The telescope.
        address: Address,
    },
    /// The time is over.
    #[error(
        "NOT verified closed within {} s: {address} is {}{}. {}",
        within.as_secs(),
        posture.unwrap_or(Posture::Unknown).word(),
        if open.is_empty() { String::new() } else { format!("; not verified closed: {}", open.join(", ")) },
        goes_on(*has_ended)
    )]
    Late {
        /// The telescope.
        address: Address,
        /// The time that was given.
        within: Duration,
        /// What the observatory node reports.
        posture: Option<Posture>,
        /// The domes that no guard reports closed now, for people; among them those that are only not known to be.
        open: Vec<String>,
        /// The observatory node has fallen silent since it took the order.
        has_ended: bool,
    },
    /// The time is over, and no observatory node has taken the order.
    #[error(
        "NOT verified closed within {} s: {}. {}",
        within.as_secs(),
        domes::names(open),
        not_taken(replaced.as_deref())
    )]
    DomesLate {
        /// The domes whose guards do not report them closed.
        open: Vec<Device>,
        /// The time that was given.
        within: Duration,
        /// The observatory node has taken this one about the same thing instead: ours is not to be given any more.
        replaced: Option<Box<OrderTaken>>,
    },
}

fn not_taken(replaced: Option<&OrderTaken>) -> String {
    match replaced {
        Some(newer) => format!("It was replaced: {}. Look at the dome", replaced_by_words(newer)),
        None => format!("No observatory node answers: {GUARDS_GO_ON}"),
    }
}

fn goes_on(has_ended: bool) -> String {
    match has_ended {
        true => format!("The observatory node took the order and has fallen silent: {GUARDS_GO_ON}"),
        false => "The closing goes on; look at the alerts and at the dome".to_owned(),
    }
}

/// The states of one telescope while an order is given; open it before the order, so that no effect is missed.
pub struct Follower {
    pub(crate) address: Address,
    clock: Clock,
    opened: MachineTime,
    nights: Subscriber<NightState>,
    guards: Subscriber<Guard>,
    permits: Subscriber<Permit>,
    /// The newer order about the same thing, once it was seen.
    replaced: Mutex<Option<OrderTaken>>,
}

impl Follower {
    /// Subscribes to what shows the effect.
    ///
    /// # Errors
    /// Where the bus refuses the subscriptions.
    pub async fn open(bus: &Bus, address: &Address) -> Result<Self, BusError> {
        let nights = Topic::Observatory(Part::Night).at(address);
        Ok(Self {
            address: address.clone(),
            clock: bus.clock().clone(),
            opened: bus.clock().machine(),
            nights: bus.subscribe(nights, Catch::Newest, 64).await?,
            guards: bus.subscribe(Topic::Guard.on_site(&address.site), Catch::Newest, 64).await?,
            permits: bus.subscribe(Topic::Permit.at(address), Catch::Newest, 64).await?,
            replaced: Mutex::default(),
        })
    }

    /// Waits until the observatory node shows the order, which was given at a sky time, or one that it took after it;
    /// until it reports that all is closed, and no guard of its domes contradicts it. Where it falls silent after that,
    /// until the guards of all its domes report them closed. Returns who closed.
    ///
    /// # Errors
    /// Where it does not show the order in 10 s, or the time is over.
    pub async fn until_closed(&self, order: &Order, given_utc: Utc, within: Duration) -> Result<TakenBy, NotClosed> {
        let began = Instant::now();
        let mut seen = Effects::default();
        while began.elapsed() < within {
            let left = within.saturating_sub(began.elapsed()).min(Duration::from_secs(1));
            tokio::select! {
                received = self.nights.recv() => {
                    self.see_replaced(order, &received);
                    seen.see_night(&received.sample.body, &order.id, given_utc, received.arrived);
                }
                received = self.guards.recv() => {
                    let guard = &received.sample.body;
                    // A guard that was restarted names nobody at first.
                    if let Key::Guard(dome) = &received.key
                        && (seen.guards.contains_key(dome) || self.is_over(dome, guard))
                    {
                        let reading = Reading { arrived: received.arrived, closed: guard.verified_closed };
                        seen.guards.insert(dome.clone(), reading);
                    }
                }
                received = self.permits.recv() => {
                    if let Key::Permit(_, dome) = received.key {
                        seen.permitted.insert(dome);
                    }
                }
                () = tokio::time::sleep(left) => {}
            }
            if let Some(closed) = seen.closed(self.clock.machine()) {
                return Ok(closed);
            }
            if seen.shown.is_none() && began.elapsed() > SHOWN_WITHIN {
                return Err(NotClosed::NotShown { address: self.address.clone() });
            }
        }
        let now = self.clock.machine();
        let (open, has_ended) = (seen.open(now), seen.has_ended(now));
        Err(NotClosed::Late { address: self.address.clone(), within, posture: seen.posture, open, has_ended })
    }

    /// The order about the same thing that replaced ours, as far as it was seen.
    pub(crate) fn replaced(&self) -> Option<OrderTaken> {
        self.replaced.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn see_replaced(&self, order: &Order, received: &Received<NightState>) {
        let mut replaced = self.replaced.lock().unwrap_or_else(PoisonError::into_inner);
        *replaced = replaced_after(replaced.take(), order, self.opened, received);
    }

    /// Waits until the observatory node shows an order about the same thing that it took after this was opened.
    pub(crate) async fn until_replaced(&self, order: &Order) -> OrderTaken {
        loop {
            if let Some(newer) = self.replaced() {
                return newer;
            }
            self.see_replaced(order, &self.nights.recv().await);
        }
    }

    /// Waits until the guards of these domes report all of them closed, by samples that arrived after the command. Returns
    /// those that are not where the time is over.
    pub(crate) async fn until_domes_closed(
        &self,
        domes: &[Device],
        commanded: MachineTime,
        within: Duration,
    ) -> Result<(), Vec<Device>> {
        let mut guards: BTreeMap<Device, Reading> = BTreeMap::new();
        let closing = async {
            loop {
                let received = self.guards.recv().await;
                let Key::Guard(dome) = received.key else { continue };
                if received.arrived >= commanded {
                    let reading = Reading { arrived: received.arrived, closed: received.sample.body.verified_closed };
                    guards.insert(dome, reading);
                }
                if still_open(domes, &guards, self.clock.machine()).is_empty() {
                    return;
                }
            }
        };
        let closed = tokio::time::timeout(within, closing).await;
        closed.map_err(|_| still_open(domes, &guards, self.clock.machine()))
    }

    /// Is this the guard of a dome over the telescope?
    fn is_over(&self, dome: &Device, guard: &Guard) -> bool {
        let telescope = self.address.telescope.as_str();
        dome.address == self.address
            || guard.granted.iter().any(|granted| granted.telescope == telescope)
            || guard.permits.iter().any(|permit| permit.telescope == telescope)
    }
}

/// What a guard said last of its dome.
#[derive(Debug, Clone, Copy)]
struct Reading {
    arrived: MachineTime,
    closed: Option<bool>,
}

impl Reading {
    /// Does it say that the dome is closed now?
    fn is_closed(&self, now: MachineTime) -> bool {
        self.closed == Some(true) && now.since(self.arrived) < YOUNG
    }
}

/// Those of these domes that no guard reports closed now.
fn still_open(domes: &[Device], guards: &BTreeMap<Device, Reading>, now: MachineTime) -> Vec<Device> {
    let is_closed = |dome: &Device| guards.get(dome).is_some_and(|reading| reading.is_closed(now));
    domes.iter().filter(|dome| !is_closed(dome)).cloned().collect()
}

/// What was seen of an order that closes since it was given. Pure: time comes in.
#[derive(Default)]
struct Effects {
    /// When the observatory node showed the order last.
    shown: Option<MachineTime>,
    posture: Option<Posture>,
    /// What the guards of its domes said last.
    guards: BTreeMap<Device, Reading>,
    /// The domes that the observatory node names in permits, also those whose device nodes are gone since: the names of all
    /// whose guards it has heard.
    permitted: BTreeSet<Name>,
}

impl Effects {
    fn see_night(&mut self, night: &NightState, order: &CommandId, given_utc: Utc, arrived: MachineTime) {
        if shows(night, order, given_utc) {
            (self.shown, self.posture) = (Some(arrived), Some(night.posture));
        }
    }

    /// Has the observatory node fallen silent since it showed the order? It publishes each second.
    fn has_ended(&self, now: MachineTime) -> bool {
        self.shown.is_some_and(|at| now.since(at) > SHOWN_WITHIN)
    }

    /// Who has closed, once all is verified closed.
    fn closed(&self, now: MachineTime) -> Option<TakenBy> {
        self.shown?;
        if self.posture == Some(Posture::Closed) {
            let is_contradicted = self.guards.values().any(|reading| reading.closed == Some(false));
            return (!is_contradicted).then_some(TakenBy::Observatory);
        }
        // A dome that the observatory node never heard is in no permit, and makes its posture unknown. Whatever a guard
        // says 10 s after the order was shown, and is young, it said after the order.
        let are_known = self.posture != Some(Posture::Unknown);
        let by_guards = self.has_ended(now) && are_known && self.open(now).is_empty();
        by_guards.then(|| TakenBy::Ended(self.guards.keys().cloned().collect()))
    }

    /// The domes that no guard reports closed now, for people.
    fn open(&self, now: MachineTime) -> Vec<String> {
        let silent = |dome: String| format!("{dome} (its guard does not report how it is)");
        let unnamed = self.permitted.is_empty().then(|| "its domes, which are not known".to_owned());
        let heard = self.guards.iter().filter(|(_, reading)| !reading.is_closed(now));
        let heard = heard.map(|(dome, reading)| match reading.closed {
            Some(false) => dome.to_string(),
            Some(true) | None => silent(dome.to_string()),
        });
        let is_heard = |name: &Name| self.guards.keys().any(|dome| dome.name == *name);
        let unheard = self.permitted.iter().filter(|name| !is_heard(name)).map(|name| silent(name.to_string()));
        unnamed.into_iter().chain(heard).chain(unheard).collect()
    }
}

/// Does the observatory node show the order? Somebody else may publish in its name: only a sample that contains the order
/// counts, or one that was taken later and so is shown in its place.
fn shows(night: &NightState, order: &CommandId, given_utc: Utc) -> bool {
    night.last_order.as_ref().is_some_and(|last| last.id == *order || last.at_utc >= given_utc)
}

/// The order about the same thing that the observatory node took after ours was given, by the clock of that node: the
/// giver's sky may be another one, as at a simulated site.
fn replaced_by(order: &Order, given: MachineTime, received: &Received<NightState>) -> Option<OrderTaken> {
    let night = &received.sample.body;
    let last = night.last_order.as_ref().filter(|last| last.id != order.id)?;
    let is_about_the_same = match last.verb.as_str() {
        "robotic" | "stay_closed" => true,
        // Whoever closes does not take back that it is to stay closed.
        "close" => order.kind != OrderKind::StayClosed(true),
        _ => false,
    };
    let taken_before_s = received.sample.at_utc.seconds_since(last.at_utc) / night.speed;
    let taken = received.arrived.minus(Duration::try_from_secs_f64(taken_before_s).ok()?);
    (is_about_the_same && taken > given).then(|| last.clone())
}

/// The order that replaces ours, after one more state: one that shows ours took it after what was seen before.
fn replaced_after(
    before: Option<OrderTaken>,
    order: &Order,
    given: MachineTime,
    received: &Received<NightState>,
) -> Option<OrderTaken> {
    let is_ours = received.sample.body.last_order.as_ref().is_some_and(|last| last.id == order.id);
    if is_ours { None } else { replaced_by(order, given, received).or(before) }
}

#[cfg(test)]
mod tests {
    use contract::Stamped;

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
        let mut seen = Effects { permitted: [dome("dome_1").name].into(), ..Effects::default() };
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
    }

    #[test]
    fn a_telescope_whose_domes_are_not_all_known_to_be_closed_is_not_and_says_which() {
        let mut seen = shown(Posture::Closing);
        seen.guards.insert(dome("dome_1"), reading(Some(true), 111));
        seen.permitted.insert(dome("dome_2").name);
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
            ("it has named none", Effects { permitted: BTreeSet::new(), ..shown(Posture::Closing) }),
        ] {
            seen.guards.insert(dome("dome_1"), reading(Some(true), 111));
            assert_eq!(seen.closed(at(111)), None, "{name}");
        }
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

    #[test]
    fn what_is_not_closed_in_time_is_told_with_who_goes_on_and_until_when() {
        let within = Duration::from_secs(300);
        let domes_late = |replaced| NotClosed::DomesLate { open: vec![dome("dome_1")], within, replaced };
        let newer = OrderTaken {
            id: CommandId::fresh(),
            from: "web/ben@pc".to_owned(),
            verb: "robotic".to_owned(),
            at_utc: Utc::from_seconds(1_000.0),
            night: None,
        };
        let late = |has_ended| NotClosed::Late {
            address: dome("dome_1").address,
            within,
            posture: Some(Posture::Closing),
            open: vec!["dome_1".to_owned()],
            has_ended,
        };
        let guards = "the guard of each dome goes on to ask it to close until that is verified, as long as the dome's \
                      device node runs";
        for (error, goes_on) in [
            (domes_late(None), guards),
            (
                domes_late(Some(Box::new(newer))),
                "It was replaced: the observatory node has taken a newer order of ben at ",
            ),
            (late(true), guards),
            (late(false), "The closing goes on; look at the alerts"),
        ] {
            let words = error.to_string();
            assert!(words.starts_with("NOT verified closed within 300 s") && words.contains("dome_1"), "{words}");
            assert!(words.contains(goes_on), "{words}");
        }
    }

    #[test]
    fn an_order_is_replaced_by_a_newer_one_about_the_same_thing_whatever_the_sky_of_its_giver() {
        let sample = include_str!("../../contract/golden/v1/observatory.night.json");
        let sample: Stamped<NightState> = serde_json::from_str(sample).unwrap();
        let given = MachineTime::from_boot(Duration::from_secs(1_000));
        let replaced = |kind: OrderKind, verb: &str, age_sky_s: f64, speed: f64, arrived_s: u64| {
            let order = Order {
                id: CommandId("ours".to_owned()),
                from: "cli/ana".to_owned(),
                reason: String::new(),
                kind,
                seen: None,
            };
            let mut sample = sample.clone();
            sample.body.speed = speed;
            let last = sample.body.last_order.as_mut().unwrap();
            (last.verb, last.at_utc) = (verb.to_owned(), sample.at_utc.plus_seconds(-age_sky_s));
            let key = Key::Observatory(Address::new("paranal", "callisto").unwrap(), Part::Night);
            let arrived = MachineTime::from_boot(Duration::from_secs(arrived_s));
            let of_another = Received { key, sample, arrived };
            let mut of_ours = of_another.clone();
            if let Some(last) = of_ours.sample.body.last_order.as_mut() {
                last.id = order.id.clone();
            }
            let newer = replaced_by(&order, given, &of_another);
            assert_eq!(replaced_after(newer.clone(), &order, given, &of_ours), None, "it is this very order");
            let mut of_none = of_another.clone();
            of_none.sample.body.last_order = None;
            assert_eq!(replaced_after(newer.clone(), &order, given, &of_none), newer, "the node was started again");
            replaced_after(None, &order, given, &of_another).is_some()
        };
        for (verb, of_close, of_stay_closed) in
            [("robotic", true, true), ("stay_closed", true, true), ("close", true, false), ("skip", false, false)]
        {
            assert_eq!(replaced(OrderKind::Close, verb, 2.0, 1.0, 1_010), of_close, "{verb}");
            assert_eq!(replaced(OrderKind::StayClosed(true), verb, 2.0, 1.0, 1_010), of_stay_closed, "{verb}");
        }
        assert!(!replaced(OrderKind::Close, "robotic", 11.0, 1.0, 1_010), "it was taken before");
        assert!(replaced(OrderKind::Close, "robotic", 60.0, 60.0, 1_010), "sky time runs faster");
        assert!(!replaced(OrderKind::Close, "robotic", -1.0, 1.0, 1_010), "a clock that was put back");
        assert!(!replaced(OrderKind::Close, "robotic", 2.0, f64::NAN, 1_010));
    }
}
