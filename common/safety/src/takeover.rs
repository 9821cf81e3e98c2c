//! Which operator orders are active for a node that becomes the commander, and whether it can know.
//!
//! The last commander wrote its token with its orders to disk, and published it with them on the bus. The arbiter
//! grants tokens one after another: a node that is granted token n knows everything if it has the last orders of token
//! n - 1. If no node has them, an order to stay closed may be active, and so it is taken as active. Tokens whose
//! holders were ended before they commanded (`node-observatory/src/failover/claim_note.rs`) are passed over.

use std::collections::BTreeSet;

use contract::Stamped;
use contract::observatory::{Alerts, OperatorOrders};
use units::Utc;

use crate::active_orders::ActiveOrders;
use crate::annunciator::Annunciator;
use crate::on_disk::OnDisk;
use crate::ordered_by::OrderedBy;

/// What a node knows when it is granted the lease.
#[derive(Debug, Clone)]
pub struct Known<'a> {
    /// The token that it is granted; none where there is no arbiter, and so nobody to contend with.
    pub granted: Option<u64>,
    /// What it has in memory.
    pub own: &'a ActiveOrders,
    /// The token that this very incarnation held last.
    pub held: Option<u64>,
    /// Tokens whose holders never commanded.
    pub unused: &'a BTreeSet<u64>,
    /// What its folder holds, which may be the commander's before it.
    pub disk: &'a OnDisk,
    /// The last orders that were received from another node.
    pub received: Option<Word<'a>>,
}

/// The last orders of another node.
#[derive(Debug, Clone)]
pub struct Word<'a> {
    /// Its orders.
    pub orders: &'a ActiveOrders,
    /// So lately that it can have accepted nothing since.
    pub is_last: bool,
}

/// The node whose last orders are known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// This incarnation commanded, and nobody since.
    Own,
    /// The one whose orders are in the folder.
    Disk,
    /// The one whose orders were received.
    Bus,
    /// Nobody's.
    Nobody,
}

impl Source {
    /// People's answers to alerts, from the source of the orders where that was published: a record of an earlier
    /// commander would acknowledge what it never saw. An alert that no record has is new.
    pub fn answers_to_alerts(
        self,
        orders: Option<&Stamped<OperatorOrders>>,
        alerts: Option<&Stamped<Alerts>>,
    ) -> Annunciator {
        match (orders.filter(|_| self == Self::Bus), alerts) {
            // Both of one incarnation, or the acknowledgements are not the commander's.
            (Some(orders), Some(alerts)) if orders.boot_id == alerts.boot_id => {
                Annunciator::from_published(&alerts.body, &orders.body.shelved)
            }
            (Some(orders), _) => Annunciator::from_published(&Alerts::default(), &orders.body.shelved),
            (None, _) => Annunciator::default(),
        }
    }

    /// A disk that does not take the adopted orders, for this `cause`, may not have taken the last order of the
    /// incarnation before either: then they stay closed. True where that changes them.
    pub fn is_doubted_by_disk(self, orders: &mut ActiveOrders, cause: &str, now: Utc) -> bool {
        let is_doubted = self == Self::Disk && orders.stay_closed.is_none();
        if is_doubted {
            let reason = format!("{cause}; what was ordered last may be lost. Order open-again once the disk is well");
            orders.stay_closed = Some(OrderedBy::by_node(reason, now));
        }
        is_doubted
    }
}

impl Known<'_> {
    /// What holds from now on.
    pub fn take_over(&self, now: Utc) -> (ActiveOrders, Source) {
        let before = self.before();
        let follows = |token: Option<u64>| match &before {
            None => true,
            Some(before) => token.is_some_and(|token| before.contains(&token)),
        };
        let received = self.received.as_ref().filter(|word| {
            // A node publishes without a token because nobody commands: its orders hold too.
            follows(word.orders.token) || (word.orders.token.is_none() && word.is_last)
        });
        let on_disk = match self.disk {
            OnDisk::Found(orders) if orders.token.is_none() || follows(orders.token) => Some(orders),
            OnDisk::Found(_) | OnDisk::Absent | OnDisk::Unreadable(_) => None,
        };
        let is_first = *self.disk == OnDisk::Absent && follows(Some(0));
        let source = if self.held.is_some() && follows(self.held) {
            Source::Own
        } else if on_disk.is_some() || is_first {
            Source::Disk
        } else if received.is_some_and(|word| word.is_last && word.orders.token.is_some()) {
            Source::Bus
        } else {
            Source::Nobody
        };
        // The orders in this node's memory were adopted from the commander, or given to this node itself.
        let mut orders = self.own.clone();
        for known in on_disk.into_iter().chain(received.map(|word| word.orders)) {
            orders = orders.stricter(known);
        }
        if source == Source::Nobody {
            orders.overrides.clear();
            orders.stay_closed.get_or_insert_with(|| self.unknown(now));
        }
        orders.token = self.granted;
        (orders, source)
    }

    /// The tokens of which one is the last commander's: the one before, and those before that one which nobody
    /// commanded with; none where there is no arbiter.
    fn before(&self) -> Option<std::ops::RangeInclusive<u64>> {
        let last = self.granted?.saturating_sub(1);
        let unused = (0..=last).rev().take_while(|token| self.unused.contains(token)).count() as u64;
        Some(last.saturating_sub(unused)..=last)
    }

    fn unknown(&self, now: Utc) -> OrderedBy {
        let again = "give `open-again` when nobody needs the dome closed";
        let reason = match self.disk {
            OnDisk::Unreadable(why) => format!("{why}; {again}"),
            OnDisk::Absent | OnDisk::Found(_) => {
                let before = self.before().map_or(0, |before| *before.start());
                let gone = if *self.disk == OnDisk::Absent { "the data folder has no orders, and " } else { "" };
                format!(
                    "{gone}the last orders to the commander with token {before} were not received, and one of them may be to stay \
                     closed; {again}"
                )
            }
        };
        OrderedBy::by_node(reason, now)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use contract::BootId;
    use contract::observatory::{AlertEvent, Notification, Shelved};

    use super::*;
    use crate::active_orders::Override;

    fn now() -> Utc {
        Utc::from_seconds(5000.0)
    }

    fn ordered_by(reason: &str) -> OrderedBy {
        OrderedBy { from: "web/ana".to_owned(), reason: reason.to_owned(), at_utc: Utc::from_seconds(1000.0) }
    }

    fn nothing(token: Option<u64>) -> ActiveOrders {
        ActiveOrders { token, ..ActiveOrders::default() }
    }

    fn veto(token: Option<u64>) -> ActiveOrders {
        ActiveOrders { stay_closed: Some(ordered_by("people on the roof")), ..nothing(token) }
    }

    fn softened(token: Option<u64>) -> ActiveOrders {
        let order = Override { ordered_by: ordered_by("wet"), until_utc: Utc::from_seconds(6000.0) };
        ActiveOrders { overrides: BTreeMap::from([("wx/Humidity".to_owned(), order)]), ..nothing(token) }
    }

    struct Scenario<'a> {
        name: &'static str,
        own: ActiveOrders,
        held: Option<u64>,
        unused: &'a [u64],
        disk: OnDisk,
        received: Option<(ActiveOrders, bool)>,
        closed: Option<&'a str>,
        softened: bool,
        source: Source,
    }

    const ROOF: Option<&str> = Some("people on the roof");
    const UNKNOWN: Option<&str> = Some("token 6 were not received");

    fn scenario(name: &'static str) -> Scenario<'static> {
        let own = nothing(None);
        Scenario {
            name,
            own,
            held: None,
            unused: &[],
            disk: OnDisk::Absent,
            received: None,
            closed: None,
            softened: false,
            source: Source::Nobody,
        }
    }

    /// In all of them token 7 is granted.
    #[test]
    fn the_orders_to_the_earlier_commander_hold_and_the_dome_stays_closed_where_nobody_knows_them() {
        use OnDisk::{Found, Unreadable};
        let (disk, bus, own) = (Source::Disk, Source::Bus, Source::Own);
        let scenarios = [
            Scenario { closed: UNKNOWN, ..scenario("a new folder, and nobody has published") },
            Scenario {
                disk: Found(softened(Some(6))),
                own: softened(Some(6)),
                softened: true,
                source: disk,
                ..scenario("a restart")
            },
            Scenario {
                disk: Found(veto(Some(6))),
                own: veto(Some(6)),
                closed: ROOF,
                source: disk,
                ..scenario("a restart, closed")
            },
            Scenario {
                disk: Found(veto(Some(6))),
                closed: ROOF,
                source: disk,
                ..scenario("a shared folder, and a deaf standby")
            },
            Scenario { disk: Found(nothing(Some(4))), closed: UNKNOWN, ..scenario("somebody else commanded since") },
            Scenario {
                disk: Found(veto(Some(4))),
                own: veto(Some(4)),
                closed: ROOF,
                ..scenario("somebody else, and it was closed before")
            },
            Scenario {
                disk: Found(softened(None)),
                own: softened(None),
                softened: true,
                source: disk,
                ..scenario("an older version's file")
            },
            Scenario {
                received: Some((veto(Some(6)), true)),
                own: veto(None),
                closed: ROOF,
                source: bus,
                ..scenario("a folder of its own, and the last orders")
            },
            Scenario {
                received: Some((softened(Some(6)), true)),
                own: softened(None),
                softened: true,
                source: bus,
                ..scenario("what was softened stays so")
            },
            Scenario {
                received: Some((softened(Some(6)), false)),
                own: softened(None),
                closed: UNKNOWN,
                ..scenario("it was received too long ago")
            },
            Scenario {
                received: Some((nothing(Some(5)), true)),
                closed: UNKNOWN,
                ..scenario("received, but not from the last commander")
            },
            Scenario {
                disk: Found(veto(Some(3))),
                received: Some((nothing(Some(6)), true)),
                source: bus,
                ..scenario("taken back since, as was received")
            },
            Scenario {
                disk: Found(nothing(Some(6))),
                received: Some((veto(None), true)),
                closed: ROOF,
                source: disk,
                ..scenario("ordered of a node that stood in while the arbiter was silent")
            },
            Scenario {
                own: veto(Some(6)),
                held: Some(6),
                closed: ROOF,
                source: own,
                ..scenario("the lease again, and a disk that fails")
            },
            Scenario {
                own: veto(Some(6)),
                held: Some(6),
                disk: Found(nothing(Some(6))),
                closed: ROOF,
                source: own,
                ..scenario("the same, and the disk does not know it")
            },
            Scenario {
                own: nothing(Some(5)),
                held: Some(5),
                closed: UNKNOWN,
                ..scenario("another had the lease in between")
            },
            Scenario {
                disk: Found(softened(Some(4))),
                own: softened(Some(4)),
                unused: &[6, 5],
                softened: true,
                source: disk,
                ..scenario("two incarnations were ended before they commanded")
            },
            Scenario {
                disk: Found(nothing(Some(5))),
                unused: &[6],
                source: disk,
                ..scenario("a process was ended when its token was on disk, and before it commanded")
            },
            Scenario { unused: &[6, 5, 4, 3, 2, 1], source: disk, ..scenario("nobody has ever commanded") },
            Scenario {
                disk: Found(nothing(Some(4))),
                unused: &[5],
                closed: UNKNOWN,
                ..scenario("somebody commanded after the incarnation that was ended")
            },
            Scenario {
                disk: Found(nothing(Some(4))),
                unused: &[6],
                closed: Some("token 5 were not received"),
                ..scenario("... and before it")
            },
            Scenario {
                disk: Unreadable("operator-orders.json cannot be read: broken".to_owned()),
                closed: Some("operator-orders.json cannot be read: broken"),
                ..scenario("a file that cannot be read")
            },
        ];
        for Scenario { name, own, held, unused, disk, received, closed, softened, source } in scenarios {
            let unused = &unused.iter().copied().collect();
            let received = received.as_ref().map(|(orders, is_last)| Word { orders, is_last: *is_last });
            let known = Known { granted: Some(7), own: &own, held, unused, disk: &disk, received };
            let (active, from) = known.take_over(now());
            let reason = active.stay_closed.as_ref().map(|ordered_by| ordered_by.reason.clone());
            match closed {
                None => assert_eq!(reason, None, "{name}"),
                Some(words) => assert!(reason.as_ref().is_some_and(|why| why.contains(words)), "{name}: {reason:?}"),
            }
            assert_eq!(!active.overrides.is_empty(), softened, "{name}");
            assert_eq!((active.token, from), (Some(7), source), "{name}");
        }
    }

    #[test]
    fn the_first_commander_of_all_and_one_without_an_arbiter_know_everything() {
        let (nothing, unused) = (nothing(None), BTreeSet::new());
        let known = |granted| Known {
            granted,
            own: &nothing,
            held: None,
            unused: &unused,
            disk: &OnDisk::Absent,
            received: None,
        };
        for granted in [Some(1), None] {
            let (orders, source) = known(granted).take_over(now());
            assert_eq!((orders.stay_closed, source), (None, Source::Disk), "{granted:?}");
        }
        // Others commanded before, and the file that would have an order to stay closed is not there.
        let (orders, source) = known(Some(38)).take_over(now());
        let why = orders.stay_closed.as_ref().map(|ordered_by| ordered_by.reason.as_str()).unwrap_or_default();
        assert!(why.starts_with("the data folder has no orders, and ") && source == Source::Nobody, "{orders:?}");
    }

    fn stamped<T>(boot_id: &BootId, body: T) -> Stamped<T> {
        Stamped { boot_id: boot_id.clone(), seq: 0, at_utc: now(), sent_s: None, held_s: None, body }
    }

    #[test]
    fn answers_to_alerts_are_the_last_commanders_or_nobodys() {
        let shelved = Shelved { alert: "a".to_owned(), until_utc: now(), ordered: ordered_by("later").into() };
        let (commander, other) = (BootId::fresh(), BootId::fresh());
        let orders = stamped(&commander, nothing(Some(6)).published(Some(6), vec![shelved]));
        let (receiver, id, event) = ("pager".to_owned(), "a".to_owned(), AlertEvent::Raised);
        let sent = Notification { receiver, id, raised_utc: now(), event, sent_utc: now() };
        let alerts = |boot_id| stamped(boot_id, Alerts { alerts: Vec::new(), notifications: vec![sent.clone()] });
        // The source, whose alerts were received, and whether the shelf and the notifications are adopted.
        for (source, boot_id, has_shelf, has_sent) in [
            (Source::Bus, Some(&commander), true, true),
            (Source::Bus, Some(&other), true, false),
            (Source::Bus, None, true, false),
            (Source::Nobody, Some(&commander), false, false),
        ] {
            let adopted = source.answers_to_alerts(Some(&orders), boot_id.map(alerts).as_ref());
            assert_eq!(!adopted.shelf().is_empty(), has_shelf, "{source:?} {boot_id:?}");
            assert_eq!(adopted != source.answers_to_alerts(Some(&orders), None), has_sent, "{source:?} {boot_id:?}");
        }
    }

    #[test]
    fn a_disk_that_does_not_take_the_orders_may_have_lost_the_last_one() {
        for (source, before, is_doubted) in [
            (Source::Disk, nothing(Some(7)), true),
            (Source::Disk, veto(Some(7)), false),
            (Source::Bus, nothing(Some(7)), false),
            (Source::Own, nothing(Some(7)), false),
        ] {
            let mut orders = before.clone();
            assert_eq!(source.is_doubted_by_disk(&mut orders, "the disk is full", now()), is_doubted, "{source:?}");
            assert_eq!(orders != before, is_doubted, "{source:?}");
            assert!(!is_doubted || orders.stay_closed.is_some(), "{source:?}");
        }
    }
}
