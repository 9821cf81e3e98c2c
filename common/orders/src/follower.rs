//! Follows one telescope while an order is given: what its observatory node and the guards of its domes show.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use bus::{Bus, BusError, Catch, MachineTime, Received, Subscriber};
use contract::device::dome::Guard;
use contract::observatory::{NightState, OrderTaken, Posture};
use contract::{Address, CommandId, Device, Key, Order, OrderKind, Part, Topic};
use units::Utc;

use crate::domes;

/// An observatory node publishes each second which order it took last.
const SHOWN_WITHIN: Duration = Duration::from_secs(10);

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
        "NOT verified closed within {} s: {address} is {}{}. The closing goes on; look at the alerts and at the dome",
        within.as_secs(),
        posture.unwrap_or(Posture::Unknown).word(),
        if open.is_empty() { String::new() } else { format!("; not closed: {}", open.join(", ")) }
    )]
    Late {
        /// The telescope.
        address: Address,
        /// The time that was given.
        within: Duration,
        /// What the observatory node reports.
        posture: Option<Posture>,
        /// The domes whose guards do not see them closed.
        open: Vec<String>,
    },
    /// The time is over, and no observatory node answers.
    #[error(
        "NOT verified closed within {} s: {}. No observatory node answers; the guard of each dome goes on closing. Look at the dome, \
         and close it at its own controls",
        within.as_secs(),
        domes::names(open)
    )]
    DomesLate {
        /// The domes whose guards do not report them closed.
        open: Vec<Device>,
        /// The time that was given.
        within: Duration,
    },
}

/// The states of one telescope while an order is given; open it before the order, so that no effect is missed.
pub struct Follower {
    pub(crate) address: Address,
    opened: MachineTime,
    nights: Subscriber<NightState>,
    guards: Subscriber<Guard>,
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
            opened: bus.clock().machine(),
            nights: bus.subscribe(nights, Catch::Newest, 64).await?,
            guards: bus.subscribe(Topic::Guard.on_site(&address.site), Catch::Newest, 64).await?,
        })
    }

    /// Waits until the observatory node shows the order, which was given at a sky time, or one that it took after it;
    /// until it reports that all is closed, and no guard of its domes contradicts it.
    ///
    /// # Errors
    /// Where it does not show the order in 10 s, or the time is over.
    pub async fn until_closed(&self, order: &CommandId, given_utc: Utc, within: Duration) -> Result<(), NotClosed> {
        let began = Instant::now();
        let (mut is_shown, mut posture) = (false, None);
        let mut domes: BTreeMap<String, bool> = BTreeMap::new();
        while began.elapsed() < within {
            let left = within.saturating_sub(began.elapsed()).min(Duration::from_secs(1));
            tokio::select! {
                received = self.nights.recv() => {
                    let night = received.sample.body;
                    if shows(&night, order, given_utc) {
                        (is_shown, posture) = (true, Some(night.posture));
                    }
                }
                received = self.guards.recv() => {
                    if let Key::Guard(dome) = &received.key && self.is_over(dome, &received.sample.body) {
                        domes.insert(dome.to_string(), received.sample.body.verified_closed != Some(false));
                    }
                }
                () = tokio::time::sleep(left) => {}
            }
            if is_shown && posture == Some(Posture::Closed) && domes.values().all(|closed| *closed) {
                return Ok(());
            }
            if !is_shown && began.elapsed() > SHOWN_WITHIN {
                return Err(NotClosed::NotShown { address: self.address.clone() });
            }
        }
        let open = domes.into_iter().filter(|(_, closed)| !closed).map(|(dome, _)| dome).collect();
        Err(NotClosed::Late { address: self.address.clone(), within, posture, open })
    }

    /// Waits until the observatory node shows an order about the same thing that it took after this was opened.
    pub(crate) async fn until_replaced(&self, order: &Order) -> OrderTaken {
        loop {
            if let Some(newer) = replaced_by(order, self.opened, &self.nights.recv().await) {
                return newer;
            }
        }
    }

    /// Waits until the guard of each of these domes reports it closed, by a sample that arrived after the command.
    pub(crate) async fn until_domes_closed(
        &self,
        domes: &[Device],
        commanded: MachineTime,
        within: Duration,
    ) -> Result<(), NotClosed> {
        let mut open: BTreeSet<Device> = domes.iter().cloned().collect();
        let closing = async {
            while !open.is_empty() {
                let received = self.guards.recv().await;
                let Key::Guard(dome) = received.key else { continue };
                if received.arrived < commanded || !domes.contains(&dome) {
                    continue;
                }
                match received.sample.body.verified_closed {
                    Some(true) => open.remove(&dome),
                    Some(false) | None => open.insert(dome),
                };
            }
        };
        let closed = tokio::time::timeout(within, closing).await;
        closed.map_err(|_| NotClosed::DomesLate { open: open.into_iter().collect(), within })
    }

    /// Is this the guard of a dome over the telescope?
    fn is_over(&self, dome: &Device, guard: &Guard) -> bool {
        let telescope = self.address.telescope.as_str();
        dome.address == self.address
            || guard.granted.iter().any(|granted| granted.telescope == telescope)
            || guard.permits.iter().any(|permit| permit.telescope == telescope)
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
            assert_eq!(replaced_by(&order, given, &of_ours), None, "it is this very order");
            replaced_by(&order, given, &of_another).is_some()
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
