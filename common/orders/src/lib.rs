//! Gives a person's order to an observatory node and follows it: what the command line and the web node both do.
//!
//! An order that closes is done when the observatory node shows it, reports that all is closed, and no guard of its domes
//! contradicts. An order that does more than to close is refused where it comes too late ([`RecentStates`]).

mod recent_states;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use bus::{AskError, Bus, BusError, Catch, Subscriber};
use contract::command::Seen;
use contract::device::dome::Guard;
use contract::observatory::{NightState, Posture};
use contract::{Address, CommandId, Device, Key, Order, Part, Refusal, Reply, Topic};
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
        posture_word(*posture),
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
}

fn posture_word(posture: Option<Posture>) -> String {
    posture.map_or_else(|| "unknown".to_owned(), |posture| format!("{posture:?}").to_lowercase())
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
