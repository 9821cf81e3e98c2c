//! Which operator orders are active for a node that becomes the commander, and whether it can know.
//!
//! The last commander wrote its token with its orders to disk, and published it with them on the bus. The arbiter
//! grants tokens one after another: a node that is granted token n knows everything if it has the last orders of token
//! n - 1. If no node has them, an order to stay closed may be active, and so it is taken as active. Tokens whose
//! holders were ended before they commanded (`node-observatory/src/claim_note.rs`) are passed over.

use std::collections::BTreeSet;

use units::Utc;

use crate::on_disk::OnDisk;
use crate::said::Said;
use crate::standing::Standing;

/// What a node knows when it is granted the lease.
#[derive(Debug, Clone)]
pub struct Known<'a> {
    /// The token that it is granted; none where there is no arbiter, and so nobody to contend with.
    pub granted: Option<u64>,
    /// What it has in memory.
    pub own: &'a Standing,
    /// The token that this very incarnation held last.
    pub held: Option<u64>,
    /// Tokens whose holders never commanded.
    pub unused: &'a BTreeSet<u64>,
    /// What its folder holds, which may be the commander's before it.
    pub disk: &'a OnDisk,
    /// A version that wrote no tokens has commanded from this folder.
    pub is_older_version: bool,
    /// The last orders that were received from another node.
    pub heard: Option<Word<'a>>,
}

/// The last orders of another node.
#[derive(Debug, Clone)]
pub struct Word<'a> {
    /// Its orders.
    pub orders: &'a Standing,
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
    /// The one that was received from.
    Bus,
    /// Nobody's.
    Nobody,
}

impl Known<'_> {
    /// What holds from now on.
    pub fn inherit(&self, now: Utc) -> (Standing, Source) {
        let before = self.before();
        let follows = |token: Option<u64>| match &before {
            None => true,
            Some(before) => token.is_some_and(|token| before.contains(&token)),
        };
        let heard = self.heard.as_ref().filter(|word| {
            // A node publishes without a token because nobody commands: its orders hold too.
            follows(word.orders.token) || (word.orders.token.is_none() && word.is_last)
        });
        let on_disk = match self.disk {
            OnDisk::Found(standing) if standing.token.is_none() || follows(standing.token) => Some(standing),
            OnDisk::Found(_) | OnDisk::Absent | OnDisk::Unreadable(_) => None,
        };
        let is_first = *self.disk == OnDisk::Absent && (follows(Some(0)) || self.is_older_version);
        let source = if self.held.is_some() && follows(self.held) {
            Source::Own
        } else if on_disk.is_some() || is_first {
            Source::Disk
        } else if heard.is_some_and(|word| word.is_last && word.orders.token.is_some()) {
            Source::Bus
        } else {
            Source::Nobody
        };
        // The orders in this node's memory were adopted from the commander, or given to this node itself.
        let mut standing = self.own.clone();
        for known in on_disk.into_iter().chain(heard.map(|word| word.orders)) {
            standing = standing.stricter(known);
        }
        if source == Source::Nobody {
            standing.overrides.clear();
            standing.stay_closed.get_or_insert_with(|| self.unknown(now));
        }
        standing.token = self.granted;
        (standing, source)
    }

    /// The tokens of which one is the last commander's: the one before, and those before that one which nobody
    /// commanded with; none where there is no arbiter.
    fn before(&self) -> Option<std::ops::RangeInclusive<u64>> {
        let last = self.granted?.saturating_sub(1);
        let unused = (0..=last).rev().take_while(|token| self.unused.contains(token)).count() as u64;
        Some(last.saturating_sub(unused)..=last)
    }

    fn unknown(&self, now: Utc) -> Said {
        let again = "order open-again once nothing speaks against opening";
        let reason = match self.disk {
            OnDisk::Unreadable(why) => format!("{why}; {again}"),
            OnDisk::Absent | OnDisk::Found(_) => {
                let before = self.before().map_or(0, |before| *before.start());
                format!(
                    "whoever commanded with token {before} was not heard to the end, and may have been ordered to stay closed; {again}"
                )
            }
        };
        Said::by_node(reason, now)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::standing::Override;

    fn now() -> Utc {
        Utc::from_seconds(5000.0)
    }

    fn said(reason: &str) -> Said {
        Said { from: "web/ana".to_owned(), reason: reason.to_owned(), at_utc: Utc::from_seconds(1000.0) }
    }

    fn nothing(token: Option<u64>) -> Standing {
        Standing { token, ..Standing::default() }
    }

    fn veto(token: Option<u64>) -> Standing {
        Standing { stay_closed: Some(said("people on the roof")), ..nothing(token) }
    }

    fn softened(token: Option<u64>) -> Standing {
        let order = Override { said: said("wet"), until_utc: Utc::from_seconds(6000.0) };
        Standing { overrides: BTreeMap::from([("wx/Humidity".to_owned(), order)]), ..nothing(token) }
    }

    struct Story<'a> {
        name: &'static str,
        own: Standing,
        held: Option<u64>,
        unused: &'a [u64],
        disk: OnDisk,
        heard: Option<(Standing, bool)>,
        closed: Option<&'a str>,
        softened: bool,
        source: Source,
    }

    const ROOF: Option<&str> = Some("people on the roof");
    const UNKNOWN: Option<&str> = Some("token 6 was not heard to the end");

    fn story(name: &'static str) -> Story<'static> {
        let own = nothing(None);
        Story {
            name,
            own,
            held: None,
            unused: &[],
            disk: OnDisk::Absent,
            heard: None,
            closed: None,
            softened: false,
            source: Source::Nobody,
        }
    }

    /// In all of them token 7 is granted.
    #[test]
    fn what_holds_is_what_the_commander_before_was_told_and_stays_closed_where_nobody_knows() {
        use OnDisk::{Found, Unreadable};
        let (disk, bus, own) = (Source::Disk, Source::Bus, Source::Own);
        let stories = [
            Story { closed: UNKNOWN, ..story("a new folder, and nobody was heard") },
            Story {
                disk: Found(softened(Some(6))),
                own: softened(Some(6)),
                softened: true,
                source: disk,
                ..story("a restart")
            },
            Story {
                disk: Found(veto(Some(6))),
                own: veto(Some(6)),
                closed: ROOF,
                source: disk,
                ..story("a restart, closed")
            },
            Story {
                disk: Found(veto(Some(6))),
                closed: ROOF,
                source: disk,
                ..story("a shared folder, and a deaf standby")
            },
            Story { disk: Found(nothing(Some(4))), closed: UNKNOWN, ..story("somebody else commanded since") },
            Story {
                disk: Found(veto(Some(4))),
                own: veto(Some(4)),
                closed: ROOF,
                ..story("somebody else, and it was closed before")
            },
            Story {
                disk: Found(softened(None)),
                own: softened(None),
                softened: true,
                source: disk,
                ..story("an older version's file")
            },
            Story {
                heard: Some((veto(Some(6)), true)),
                own: veto(None),
                closed: ROOF,
                source: bus,
                ..story("a folder of its own, and the last word")
            },
            Story {
                heard: Some((softened(Some(6)), true)),
                own: softened(None),
                softened: true,
                source: bus,
                ..story("what was softened stays so")
            },
            Story {
                heard: Some((softened(Some(6)), false)),
                own: softened(None),
                closed: UNKNOWN,
                ..story("it was heard too long ago")
            },
            Story {
                heard: Some((nothing(Some(5)), true)),
                closed: UNKNOWN,
                ..story("heard, but not the last commander")
            },
            Story {
                disk: Found(veto(Some(3))),
                heard: Some((nothing(Some(6)), true)),
                source: bus,
                ..story("taken back since, as was heard")
            },
            Story {
                disk: Found(nothing(Some(6))),
                heard: Some((veto(None), true)),
                closed: ROOF,
                source: disk,
                ..story("ordered of a node that stood in while the arbiter was silent")
            },
            Story {
                own: veto(Some(6)),
                held: Some(6),
                closed: ROOF,
                source: own,
                ..story("the lease again, and a disk that fails")
            },
            Story {
                own: veto(Some(6)),
                held: Some(6),
                disk: Found(nothing(Some(6))),
                closed: ROOF,
                source: own,
                ..story("the same, and the disk has not heard of it")
            },
            Story {
                own: nothing(Some(5)),
                held: Some(5),
                closed: UNKNOWN,
                ..story("another had the lease in between")
            },
            Story {
                disk: Found(softened(Some(4))),
                own: softened(Some(4)),
                unused: &[6, 5],
                softened: true,
                source: disk,
                ..story("two lives were ended before they commanded")
            },
            Story {
                disk: Found(nothing(Some(5))),
                unused: &[6],
                source: disk,
                ..story("a life was ended when its token was on disk, and before it commanded")
            },
            Story { unused: &[6, 5, 4, 3, 2, 1], source: disk, ..story("nobody has ever commanded") },
            Story {
                disk: Found(nothing(Some(4))),
                unused: &[5],
                closed: UNKNOWN,
                ..story("somebody commanded after the life that was ended")
            },
            Story {
                disk: Found(nothing(Some(4))),
                unused: &[6],
                closed: Some("token 5 was not heard to the end"),
                ..story("... and before it")
            },
            Story {
                disk: Unreadable("standing.json cannot be read: broken".to_owned()),
                closed: Some("standing.json cannot be read: broken"),
                ..story("a file that cannot be read")
            },
        ];
        for Story { name, own, held, unused, disk, heard, closed, softened, source } in stories {
            let unused = &unused.iter().copied().collect();
            let heard = heard.as_ref().map(|(orders, is_last)| Word { orders, is_last: *is_last });
            let known =
                Known { granted: Some(7), own: &own, held, unused, disk: &disk, is_older_version: false, heard };
            let (standing, from) = known.inherit(now());
            let reason = standing.stay_closed.as_ref().map(|said| said.reason.clone());
            match closed {
                None => assert_eq!(reason, None, "{name}"),
                Some(words) => assert!(reason.as_ref().is_some_and(|why| why.contains(words)), "{name}: {reason:?}"),
            }
            assert_eq!(!standing.overrides.is_empty(), softened, "{name}");
            assert_eq!((standing.token, from), (Some(7), source), "{name}");
        }
    }

    #[test]
    fn the_first_commander_of_all_and_one_without_an_arbiter_know_everything() {
        let (nothing, unused) = (nothing(None), BTreeSet::new());
        let known = |granted, is_older_version| Known {
            granted,
            own: &nothing,
            held: None,
            unused: &unused,
            disk: &OnDisk::Absent,
            is_older_version,
            heard: None,
        };
        for (granted, older) in [(Some(1), false), (None, false), (Some(38), true)] {
            let (standing, source) = known(granted, older).inherit(now());
            assert_eq!((standing.stay_closed, source), (None, Source::Disk), "{granted:?}");
        }
    }
}
