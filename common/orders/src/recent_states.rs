//! Refuses orders that come too late to loosen anything.
//!
//! An order to a node that is stopped, or behind a link that is cut, lies in a buffer. Its giver sees that nobody
//! answered, and may have closed the telescope since. An order therefore names the newest state of the night that its
//! giver had received, and this node knows by its own clock when it published that. No clock of the giver counts.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use contract::{BootId, Order};
use units::MachineTime;

/// An order that loosens is executed within so long of the state that its giver had seen. States are a second apart, and
/// a giver waits 3 s for the answer.
const RECENT: Duration = Duration::from_secs(5);
/// A node that publishes each second, and did not for so long, did not run.
const STALL: Duration = Duration::from_secs(4);
/// At most this many states are remembered; they are at least 50 ms apart.
const MOST: usize = 256;

/// When this node published which state of the night, the newest last.
#[derive(Debug, Default)]
pub struct RecentStates(Mutex<VecDeque<(u64, MachineTime)>>);

impl RecentStates {
    /// Remembers that the state of this number was published.
    pub fn note(&self, seq: u64, now: MachineTime) {
        let mut states = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // One that is older stays, to know whether this node ran at the beginning of the time.
        while states.len() >= MOST || states.get(1).is_some_and(|(_, at)| now.since(*at) > RECENT) {
            states.pop_front();
        }
        states.push_back((seq, now));
    }

    /// Is an order given now, and not long ago?
    ///
    /// # Errors
    /// For people: why it is not executed.
    pub fn check(&self, order: &Order, own: &BootId, now: MachineTime) -> Result<(), String> {
        if order.kind.only_tightens() {
            return Ok(());
        }
        let states = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(seen) = &order.seen else { return ran(&states, now) };
        if seen.boot_id != *own {
            return Err("it was given while another observatory node published for the telescope; look at its state, and order \
                        again"
                .to_owned());
        }
        let published = states.iter().find(|(seq, _)| *seq == seen.seq);
        match published {
            Some((_, at)) if now.since(*at) <= RECENT => Ok(()),
            _ => Err(format!(
                "it arrived late: its giver had last received a state of this node more than {} s ago; look at its state, and order again",
                RECENT.as_secs()
            )),
        }
    }
}

/// An order that names no state may have waited while this node did not run.
fn ran(states: &VecDeque<(u64, MachineTime)>, now: MachineTime) -> Result<(), String> {
    let times = states.iter().map(|(_, at)| *at).chain([now]);
    let longest = times.clone().zip(times.skip(1)).map(|(from, to)| to.since(from)).max().unwrap_or_default();
    if longest < STALL {
        return Ok(());
    }
    Err(format!(
        "this node did not run for {:.0} s until a moment ago, so the order may be an old one; look at the telescope's state, \
         and order again",
        longest.as_secs_f64()
    ))
}

#[cfg(test)]
mod tests {
    use contract::command::Seen;
    use contract::{CommandId, OrderKind};

    use super::*;

    fn at(seconds: f64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs_f64(100.0 + seconds))
    }

    fn order(kind: OrderKind, seen: Option<Seen>) -> Order {
        Order { id: CommandId::fresh(), from: "cli/ana".to_owned(), reason: String::new(), kind, seen }
    }

    /// A node that published each second from 0 to 20 s.
    fn states() -> RecentStates {
        let states = RecentStates::default();
        (0..=20).for_each(|n| states.note(n, at(n as f64)));
        states
    }

    #[test]
    fn an_order_that_lay_in_a_buffer_loosens_nothing_and_closes_all_the_same() {
        let (states, own) = (states(), BootId::fresh());
        let seen = |seq| Some(Seen { boot_id: own.clone(), seq });
        let check = |kind, seen, now| states.check(&order(kind, seen), &own, at(now));
        assert_eq!(check(OrderKind::Robotic(true), seen(20), 21.0), Ok(()));
        assert_eq!(check(OrderKind::Robotic(true), seen(16), 20.5), Ok(()));
        for (seq, now) in [(15, 20.6), (20, 40.0), (0, 20.0), (21, 20.5), (u64::MAX, 20.5)] {
            let refused = check(OrderKind::StayClosed(false), seen(seq), now).unwrap_err();
            assert!(refused.contains("late"), "{seq} at {now}: {refused}");
        }
        let other = Some(Seen { boot_id: BootId::fresh(), seq: 20 });
        assert!(check(OrderKind::Robotic(true), other, 20.5).unwrap_err().contains("another observatory node"));
        for kind in [OrderKind::Close, OrderKind::Robotic(false), OrderKind::StayClosed(true)] {
            assert_eq!(check(kind, seen(0), 4000.0), Ok(()));
        }
    }

    #[test]
    fn an_order_that_names_no_state_is_refused_after_a_stall() {
        let own = BootId::fresh();
        let start = order(OrderKind::Robotic(true), None);
        assert_eq!(RecentStates::default().check(&start, &own, at(0.0)), Ok(()), "a node that has just started");
        let states = states();
        assert_eq!(states.check(&start, &own, at(20.9)), Ok(()));
        // Stopped at 20 s, it goes on at 63 s; the order is read before or after the next state is published.
        assert!(states.check(&start, &own, at(63.0)).unwrap_err().contains("43 s"));
        states.note(21, at(63.0));
        assert!(states.check(&start, &own, at(63.2)).unwrap_err().contains("43 s"));
        (1..=4).for_each(|n| states.note(21 + n, at(63.0 + n as f64)));
        assert!(states.check(&start, &own, at(67.5)).is_err());
        (5..=7).for_each(|n| states.note(21 + n, at(63.0 + n as f64)));
        assert_eq!(states.check(&start, &own, at(70.5)), Ok(()));
    }
}
