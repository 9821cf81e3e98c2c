//! Gives a person's order to an observatory node and follows it: what the command line and the web node both do.
//!
//! An order that closes is done when the observatory node shows it, reports that all is closed, and no guard of its domes
//! contradicts. Where no observatory node answers, the device nodes of the domes close ([`close()`]), and their guards
//! verify it. An order that does more than to close is refused where it comes too late ([`RecentStates`]).

pub mod domes;
mod recent_states;

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use bus::{AskError, Bus, BusError, Catch, MachineTime, Subscriber};
use contract::command::Seen;
use contract::device::dome::Guard;
use contract::observatory::{NightState, Posture};
use contract::{Address, CommandId, Device, Key, Order, Part, Refusal, Reply, Topic};
use tokio::sync::watch;
use units::Utc;

pub use self::recent_states::RecentStates;

/// The time for the answer to an order; after it the outcome is unknown.
pub const ANSWER_WITHIN: Duration = Duration::from_secs(3);
/// An observatory node publishes each second which order it took last.
const SHOWN_WITHIN: Duration = Duration::from_secs(10);

/// Why an order was not accepted.
#[derive(Debug, thiserror::Error)]
pub enum NotAccepted {
    /// It will not be done, and why.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// Nobody answered, or nothing that can be read: whether it was done is unknown, except where nobody is there.
    #[error(transparent)]
    Unanswered(#[from] AskError),
    /// Nobody is there to execute it.
    #[error("no observatory node publishes for {address}, so the order was not sent; see `starmesh status`")]
    NotSent {
        /// The telescope.
        address: Address,
    },
    /// Somebody answered for another order.
    #[error("{key} answered for another order; whether this one was done is unknown, see `starmesh status`")]
    OfAnother {
        /// The key that was asked.
        key: Box<Key>,
    },
}

impl NotAccepted {
    /// Did nobody answer? Then the order may be given again, under the same id.
    pub fn is_silence(&self) -> bool {
        matches!(self, Self::NotSent { .. } | Self::Unanswered(AskError::Unknown { .. }))
    }
}

/// Gives an order once. A repeat with the same id is answered again and not done again.
///
/// An order that loosens names the newest state of the night, and is not sent where there is none: nobody would answer,
/// and it would wait in a buffer for a node that hangs.
///
/// # Errors
/// Where it is refused, or its outcome is unknown.
pub async fn give(bus: &Bus, address: &Address, order: &Order) -> Result<(), NotAccepted> {
    let key = Key::Order(address.clone());
    let seen = match order.kind.only_tightens() {
        true => None,
        false => Some(newest_state(bus, address).await?),
    };
    let order = Order { seen, ..order.clone() };
    match bus.ask::<_, Reply>(&key, &order, ANSWER_WITHIN).await? {
        Reply::Accepted(accepted) if accepted.id == order.id => Ok(()),
        Reply::Accepted(_) => Err(NotAccepted::OfAnother { key: Box::new(key) }),
        Reply::Refusal(refusal) => Err(refusal.into()),
    }
}

/// The newest state of the night that the observatory node publishes now.
async fn newest_state(bus: &Bus, address: &Address) -> Result<Seen, NotAccepted> {
    let key = Key::Observatory(address.clone(), Part::Night);
    let states = bus.subscribe::<NightState>(&key, Catch::Newest, 4).await;
    let states = states.map_err(|error| AskError::Unreadable { key: key.to_string(), detail: error.to_string() })?;
    let received = tokio::time::timeout(ANSWER_WITHIN, states.recv()).await;
    let received = received.map_err(|_| NotAccepted::NotSent { address: address.clone() })?;
    Ok(Seen { boot_id: received.sample.boot_id, seq: received.sample.seq })
}

/// An order that closes is given to an observatory node so often before its silence counts: a session that has just
/// opened does not know all its peers.
const TRIES: u32 = 3;
/// The pause before an order that nobody answered is given again.
const PAUSE: Duration = Duration::from_secs(1);

/// The node that took an order that closes, or the nodes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TakenBy {
    /// The observatory node.
    Observatory,
    /// No observatory node answered: the device nodes of these domes took it, and close.
    Domes(Vec<Device>),
}

impl TakenBy {
    /// What has closed, for people, once it is verified.
    pub fn closed_words(&self) -> String {
        match self {
            Self::Observatory => "verified closed".to_owned(),
            Self::Domes(domes) => {
                format!("verified closed by the guard of {}, at the command to its device node", names(domes))
            }
        }
    }

    /// What an order that nobody but the domes took leaves undone.
    pub fn warning(&self) -> Option<&'static str> {
        match self {
            Self::Observatory => None,
            Self::Domes(_) => Some(
                "the observatory node did not answer and does not know of this order: when it is back, it may open again by its \
                 schedule; order again then",
            ),
        }
    }
}

fn names(domes: &[Device]) -> String {
    let names: Vec<String> = domes.iter().map(ToString::to_string).collect();
    names.join(", ")
}

/// Why an order that closes did not come to its end.
#[derive(Debug, thiserror::Error)]
pub enum NotDone {
    /// Nobody took it.
    #[error(transparent)]
    NotAccepted(#[from] NotAccepted),
    /// It was taken, and the telescope is not verified closed.
    #[error(transparent)]
    NotClosed(#[from] NotClosed),
}

/// Gives an order that closes, and waits until the telescope is verified closed; not at all where `within` is zero.
///
/// The first that answers closes: the observatory node, or where it is silent the device nodes of the domes, by their
/// guards. The observatory node is asked on meanwhile, and closes in its own way as soon as it answers. `taken` is called
/// with each that took the order.
///
/// # Errors
/// Nobody took the order, the observatory node refuses it, or not everything is verified closed in time.
pub async fn close(
    bus: &Bus,
    follower: &Follower,
    order: &Order,
    within: Duration,
    mut taken: impl FnMut(&TakenBy),
) -> Result<TakenBy, NotDone> {
    let (address, given_utc) = (&follower.address, bus.clock().utc());
    let (tries, mut tried) = watch::channel(0);
    let over = loop {
        match give(bus, address, order).await {
            Ok(()) => {
                taken(&TakenBy::Observatory);
                return follower.closed_by_observatory(order, given_utc, within).await;
            }
            Err(error) if !error.is_silence() => return Err(error.into()),
            Err(error) => {
                tries.send_modify(|tries| *tries += 1);
                let over = domes::over(bus, address).await;
                if !over.is_empty() && domes::close(bus, &over, order).await {
                    break over;
                }
                if *tries.borrow() >= TRIES {
                    return Err(error.into());
                }
            }
        }
        tokio::time::sleep(PAUSE).await;
    };
    let closing = TakenBy::Domes(over.clone());
    taken(&closing);
    let commanded = bus.clock().machine();
    let answers = async {
        loop {
            tokio::time::sleep(PAUSE).await;
            match give(bus, address, order).await {
                Err(error) if error.is_silence() => tries.send_modify(|tries| *tries += 1),
                answer => return answer,
            }
        }
    };
    let closed = async {
        let closed = match within.is_zero() {
            true => Ok(()),
            false => follower.until_domes_closed(&over, commanded, within).await,
        };
        // The sender lives as long as this function.
        let _ = tried.wait_for(|tries| *tries >= TRIES).await;
        closed
    };
    tokio::select! {
        answer = answers => {
            answer?;
            taken(&TakenBy::Observatory);
            follower.closed_by_observatory(order, given_utc, within).await
        }
        closed = closed => {
            closed?;
            Ok(closing)
        }
    }
}

/// So long an order that closes and that only the domes took is given on, machine time: an observatory node that hangs is
/// started again within half a minute, and would open again by its schedule.
pub const GIVEN_ON: Duration = Duration::from_secs(120);
/// How the observatory node heard of such an order.
pub const HEARD_LATER: &str = "the observatory node is back, and has taken the order";

/// Gives an order that only the domes took to the observatory node, until that answers or the time is over.
///
/// # Errors
/// It did not answer, or refuses.
pub async fn give_on(bus: &Bus, address: &Address, order: &Order, within: Duration) -> Result<(), NotAccepted> {
    let began = Instant::now();
    loop {
        match give(bus, address, order).await {
            Err(error) if error.is_silence() && began.elapsed() < within => tokio::time::sleep(PAUSE).await,
            answer => return answer,
        }
    }
}

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
        names(open)
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
    address: Address,
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

    async fn closed_by_observatory(&self, order: &Order, given: Utc, within: Duration) -> Result<TakenBy, NotDone> {
        if !within.is_zero() {
            self.until_closed(&order.id, given, within).await?;
        }
        Ok(TakenBy::Observatory)
    }

    /// Waits until the guard of each of these domes reports it closed, by a sample that arrived after the command.
    async fn until_domes_closed(
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

#[cfg(test)]
mod tests {
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
}
