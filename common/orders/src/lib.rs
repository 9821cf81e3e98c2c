//! Gives a person's order to an observatory node and follows it: what the command line and the web node both do.
//!
//! An order that closes is done when the observatory node shows it, reports that all is closed, and no guard of its domes
//! contradicts. Where no observatory node answers, the device nodes of the domes close ([`close()`]), and their guards
//! verify it. An order that does more than to close is refused where it comes too late ([`RecentStates`]).

pub mod domes;
mod effects;
mod follower;
mod recent_states;

use std::convert::Infallible;
use std::future::{Ready, pending, ready};
use std::ops::ControlFlow;
use std::pin::pin;
use std::time::{Duration, Instant};

use bus::{AskError, Bus, Catch};
use contract::command::{Seen, operator};
use contract::observatory::{NightState, OrderTaken};
use contract::{Accepted, Address, Device, Key, Order, Part, Refusal, Reply};
use tokio::sync::watch;
use units::Utc;

pub use self::follower::{Follower, NotClosed};
pub use self::recent_states::RecentStates;

/// The time for the answer to an order; after it the outcome is unknown.
pub const ANSWER_WITHIN: Duration = Duration::from_secs(3);

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
    /// It was accepted and holds now; the observatory node's disk did not take it.
    #[error(
        "the order holds now and is NOT on disk ({why}): a restart of the observatory node would forget it. It is tried again and \
         again, and an alert stands until it is written: make room on that disk"
    )]
    NotWritten {
        /// The file and the error.
        why: String,
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
/// Where it is refused, its outcome is unknown, or it holds and is not on disk.
pub async fn give(bus: &Bus, address: &Address, order: &Order) -> Result<(), NotAccepted> {
    let key = Key::Order(address.clone());
    let seen = match order.kind.only_tightens() {
        true => None,
        false => Some(newest_state(bus, address).await?),
    };
    let order = Order { seen, ..order.clone() };
    match bus.ask::<_, Reply>(&key, &order, ANSWER_WITHIN).await? {
        Reply::Accepted(accepted) if accepted.id != order.id => Err(NotAccepted::OfAnother { key: Box::new(key) }),
        Reply::Accepted(Accepted { not_written: Some(why), .. }) => Err(NotAccepted::NotWritten { why }),
        Reply::Accepted(_) => Ok(()),
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
/// So long it is given where no dome takes it either.
const CLOSE_WITHIN: Duration = Duration::from_secs(3);
/// The pause before an order that nobody answered is given again.
const PAUSE: Duration = Duration::from_secs(1);

/// Gives an order, and again while nobody answers; for the last time when the time is over. `silent` is called at each
/// silence, and ends it with what it breaks with, which is returned.
///
/// # Errors
/// Where it is refused, nobody has answered in time, or it holds and is not on disk.
pub async fn give_until_answered<B, W: Future<Output = ControlFlow<B>>>(
    bus: &Bus,
    address: &Address,
    order: &Order,
    within: Duration,
    mut silent: impl FnMut() -> W,
) -> Result<Option<B>, NotAccepted> {
    let began = Instant::now();
    loop {
        let is_last = began.elapsed() >= within;
        match give(bus, address, order).await {
            Ok(()) => return Ok(None),
            Err(error) if !error.is_silence() => return Err(error),
            Err(error) => match silent().await {
                ControlFlow::Break(with) => return Ok(Some(with)),
                ControlFlow::Continue(()) if is_last => return Err(error),
                ControlFlow::Continue(()) => {}
            },
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// What [`give_until_answered`] does at a silence where there is nothing to do.
pub fn ask_again() -> Ready<ControlFlow<Infallible>> {
    ready(ControlFlow::Continue(()))
}

/// The node that took an order that closes, or the nodes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TakenBy {
    /// The observatory node.
    Observatory,
    /// The observatory node, which fell silent before all was closed: the guards of these domes closed.
    Ended(Vec<Device>),
    /// No observatory node answered: the device nodes of these domes took it, and close.
    Domes(Vec<Device>),
}

impl TakenBy {
    /// What has closed, for people, once it is verified.
    pub fn closed_words(&self) -> String {
        match self {
            Self::Observatory => "verified closed".to_owned(),
            Self::Ended(domes) => format!(
                "verified closed by the guard of {}: the observatory node took the order and has fallen silent since",
                domes::names(domes)
            ),
            Self::Domes(domes) => {
                format!("verified closed by the guard of {}, at the command to its device node", domes::names(domes))
            }
        }
    }

    /// What an order leaves undone that only guards carried out: it is to be given on ([`give_on`]).
    pub fn warning(&self) -> Option<&'static str> {
        match self {
            Self::Observatory => None,
            Self::Ended(_) => Some(
                "the observatory node may not have written the order down: when it is back, it may open again by its schedule; \
                 order again then",
            ),
            Self::Domes(_) => Some(
                "the observatory node did not answer and does not know of this order: when it is back, it may open again by its \
                 schedule; order again then",
            ),
        }
    }
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
    /// The observatory node has taken this one about the same thing, which is newer; ours was not given any more.
    #[error("{}", replaced_by_words(.0))]
    Replaced(Box<OrderTaken>),
    /// It was taken, and the observatory node's disk did not take it.
    #[error("{closed}{why}")]
    NotWritten {
        /// Whether all is verified closed, for people; empty where that was not waited for.
        closed: String,
        /// [`NotAccepted::NotWritten`].
        why: NotAccepted,
    },
}

/// Gives an order that closes, and waits until the telescope is verified closed; not at all where `within` is zero.
///
/// The first that answers closes: the observatory node, or where it is silent the device nodes of the domes, by their
/// guards. The observatory node is asked on meanwhile, and closes in its own way as soon as it answers. `taken` is called
/// with each that took the order.
///
/// # Errors
/// Nobody took the order, the observatory node refuses it, not everything is verified closed in time, or the order holds and
/// is not on disk.
pub async fn close(
    bus: &Bus,
    follower: &Follower,
    order: &Order,
    within: Duration,
    taken: impl FnMut(&TakenBy),
) -> Result<TakenBy, NotDone> {
    close_and_go_on(bus, follower, order, (within, Duration::ZERO), taken, |_| {}).await
}

/// As [`close()`], and where only the domes took the order and do not close in time, they are followed and the observatory
/// node is asked for `beyond` more: the guards go on, and an observatory node that comes back has to know of the order.
/// `late` is called before that. An order that was replaced by a newer one is over then: it would close what that opened.
///
/// # Errors
/// As [`close()`].
pub async fn close_and_go_on(
    bus: &Bus,
    follower: &Follower,
    order: &Order,
    (within, beyond): (Duration, Duration),
    mut taken: impl FnMut(&TakenBy),
    mut late: impl FnMut(&NotClosed),
) -> Result<TakenBy, NotDone> {
    let (address, given_utc) = (&follower.address, bus.clock().utc());
    let (silences, mut counted) = watch::channel(0);
    let count = || silences.send_modify(|silences| *silences += 1);
    let to_domes = || {
        count();
        async move {
            let over = domes::over(bus, address).await;
            let is_taken = !over.is_empty() && domes::close(bus, &over, order).await;
            if is_taken { ControlFlow::Break(over) } else { ControlFlow::Continue(()) }
        }
    };
    let (over, not_written) = match give_until_answered(bus, address, order, CLOSE_WITHIN, to_domes).await {
        Err(why @ NotAccepted::NotWritten { .. }) => (None, Some(why)),
        answer => (answer?, None),
    };
    let Some(over) = over else {
        taken(&TakenBy::Observatory);
        return closed_by_observatory(bus, follower, order, (given_utc, within), not_written).await;
    };
    let closing = TakenBy::Domes(over.clone());
    taken(&closing);
    let commanded = bus.clock().machine();
    let answers = async {
        let again = || {
            count();
            ask_again()
        };
        match ask_on(bus, follower, order, Duration::MAX, again).await {
            Err(NotDone::Replaced(_)) => {
                // Nobody is asked any more, and the domes are followed to their end.
                silences.send_replace(TRIES);
                pending().await
            }
            answer => answer,
        }
    };
    let mut answers = pin!(answers);
    let (mut time, mut more, mut waited) = (within, beyond, Duration::ZERO);
    loop {
        let closed = async {
            let closed = match time.is_zero() {
                true => Ok(()),
                false => follower.until_domes_closed(&over, commanded, time).await,
            };
            // The sender lives as long as this function.
            let _ = counted.wait_for(|silences| *silences >= TRIES).await;
            closed
        };
        let open = tokio::select! {
            answer = answers.as_mut() => {
                let not_written = answer?;
                taken(&TakenBy::Observatory);
                return closed_by_observatory(bus, follower, order, (given_utc, time), not_written).await;
            }
            closed = closed => match closed {
                Ok(()) => return Ok(closing),
                Err(open) => open,
            }
        };
        waited += time;
        let replaced = follower.replaced().map(Box::new);
        let is_over = more.is_zero() || replaced.is_some();
        let error = NotClosed::DomesLate { open, within: waited, replaced };
        if is_over {
            return Err(error.into());
        }
        late(&error);
        (time, more) = (more, Duration::ZERO);
    }
}

/// Follows an order that the observatory node took, with the reason why it was not on disk then, if it was not.
async fn closed_by_observatory(
    bus: &Bus,
    follower: &Follower,
    order: &Order,
    (given_utc, within): (Utc, Duration),
    not_written: Option<NotAccepted>,
) -> Result<TakenBy, NotDone> {
    let closed = match within.is_zero() {
        true => Ok(TakenBy::Observatory),
        false => follower.until_closed(order, given_utc, within).await,
    };
    // Of a node that fell silent before its guards closed there is a warning of its own.
    let is_warned = matches!(closed, Ok(TakenBy::Ended(_) | TakenBy::Domes(_)));
    let Some(why) = not_written.filter(|_| !is_warned) else { return closed.map_err(NotDone::from) };
    // It has tried again meanwhile, and answers a repeat by that.
    if give(bus, &follower.address, order).await.is_ok() {
        return closed.map_err(NotDone::from);
    }
    let closed = match closed {
        Ok(_) if within.is_zero() => String::new(),
        Ok(_) => "verified closed, but ".to_owned(),
        // Neither hides the other.
        Err(late) => format!("{late}. And "),
    };
    Err(NotDone::NotWritten { closed, why })
}

/// So long an order that closes and that only guards carried out is given on, machine time: an observatory node that hangs
/// is started again within half a minute, and would open again by its schedule.
pub const GIVEN_ON: Duration = Duration::from_secs(120);

/// What became of an order that a newer one replaced, for people.
fn replaced_by_words(OrderTaken { from, at_utc, .. }: &OrderTaken) -> String {
    format!(
        "the observatory node has taken a newer order of {} at {}: this one is not given any more",
        operator(from),
        at_utc.to_second()
    )
}

/// Gives an order that only guards carried out to the observatory node, until that answers, or `heard` is over; not any
/// more once that has taken a newer order about the same thing from anybody, also while the order was followed. When it
/// answers, `taken` is called, and the order is followed as by [`close()`]: a dome may have begun to open before.
///
/// # Errors
/// It did not answer, refuses, has taken a newer order, not everything is verified closed in the time `within` after it
/// took this one, or this one holds and is not on disk.
pub async fn give_on(
    bus: &Bus,
    follower: &Follower,
    order: &Order,
    (heard, within): (Duration, Duration),
    taken: impl FnOnce(&TakenBy),
) -> Result<TakenBy, NotDone> {
    let given_utc = bus.clock().utc();
    let not_written = ask_on(bus, follower, order, heard, ask_again).await?;
    taken(&TakenBy::Observatory);
    closed_by_observatory(bus, follower, order, (given_utc, within), not_written).await
}

/// Asks the observatory node until it takes the order; `silent` is called at each silence. Returns why the order is not on
/// disk, if it is not.
async fn ask_on(
    bus: &Bus,
    follower: &Follower,
    order: &Order,
    within: Duration,
    silent: impl FnMut() -> Ready<ControlFlow<Infallible>>,
) -> Result<Option<NotAccepted>, NotDone> {
    tokio::select! {
        biased;
        newer = follower.until_replaced(order) => Err(NotDone::Replaced(Box::new(newer))),
        answer = give_until_answered(bus, &follower.address, order, within, silent) => match answer {
            Err(why @ NotAccepted::NotWritten { .. }) => Ok(Some(why)),
            answer => answer.map(|_| None).map_err(NotDone::from),
        }
    }
}

#[cfg(test)]
mod tests {
    use contract::Kind;

    use super::*;

    #[test]
    fn an_order_that_guards_carried_out_is_given_on_whether_or_not_the_observatory_node_took_it_before() {
        let address = Address::new("paranal", "callisto").unwrap();
        let domes = vec![address.device(Kind::Dome, &"dome_1".parse().unwrap())];
        let warning = |taken: TakenBy| taken.warning().unwrap_or_default();
        assert_eq!(warning(TakenBy::Observatory), "");
        assert!(warning(TakenBy::Ended(domes.clone())).contains("may not have written the order down"));
        assert!(warning(TakenBy::Domes(domes)).contains("does not know of this order"));
    }
}
