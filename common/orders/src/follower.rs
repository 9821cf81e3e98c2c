//! Follows one telescope while an order is given: what its observatory node and the guards of its domes show.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use bus::{Bus, BusError, Catch, Clock, MachineTime, Received, Subscriber};
use contract::device::dome::Guard;
use contract::observatory::{NightState, OrderTaken, Permit, Posture};
use contract::{Address, Device, Key, Order, OrderKind, Part, Topic};
use units::Utc;

use crate::effects::{Effects, Reading, SHOWN_WITHIN, still_open};
use crate::{TakenBy, domes, replaced_by_words};

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
                // What guards have said counts before the night is believed.
                biased;
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
                        seen.see_permit(dome, received.sample.body.guard_boot_id, received.arrived);
                    }
                }
                received = self.nights.recv() => {
                    self.see_replaced(order, &received);
                    seen.see_night(&received.sample.body, &order.id, given_utc, received.arrived);
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
    use contract::{CommandId, Stamped};

    use super::*;

    fn dome(name: &str) -> Device {
        Address::new("paranal", "callisto").unwrap().device(contract::Kind::Dome, &name.parse().unwrap())
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
