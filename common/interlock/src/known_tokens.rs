//! Fencing tokens as a device node counts and follows them; pure.
//!
//! The arbiter counts by what it granted itself, and no sample on the bus changes that. All other nodes follow
//! the arbiter's own count, up and down: a token that somebody invents counts only until the arbiter publishes again.
//!
//! An arbiter whose file is gone, or an older copy, continues beyond the newest token that it is shown: a claimant shows
//! the one that it remembers, and an arbiter that has never granted takes those of leases, permits and guards, too.
//! Then no device takes the new token for an old one, and the commander knows that nobody commanded since.

use std::collections::{BTreeMap, BTreeSet};

/// A token is one more than the one before. One that is larger than this was never granted by anybody.
const LARGEST: u64 = 1 << 53;
/// No site grants so many: one that is shown and larger was invented. Even after this one there is room for the others.
const LARGEST_SHOWN: u64 = 1 << 40;

/// The newest tokens known, by telescope.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct KnownTokens {
    /// Telescopes whose leases this node grants.
    arbitrated: BTreeSet<String>,
    newest: BTreeMap<String, u64>,
    /// The newest tokens that others published of leases that this node grants, until it has granted one.
    shown: BTreeMap<String, u64>,
}

/// A token that is to be granted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct NextToken {
    /// It.
    pub token: u64,
    /// The newest token of the own count, where that was left behind because somebody showed a newer one.
    pub left_behind: Option<u64>,
}

impl KnownTokens {
    /// What a file had; also those of it that nobody can have granted, which do not count.
    pub fn of(newest: BTreeMap<String, u64>) -> (Self, BTreeMap<String, u64>) {
        let (newest, never_granted) = newest.into_iter().partition(|(_, token)| *token <= LARGEST);
        (Self { newest, ..Self::default() }, never_granted)
    }

    /// This node grants the leases of a telescope: what the bus carries of them counts no more.
    pub fn arbitrate(&mut self, telescope: &str) {
        self.arbitrated.insert(telescope.to_owned());
    }

    /// Does this node grant the leases of a telescope?
    pub fn is_arbiter(&self, telescope: &str) -> bool {
        self.arbitrated.contains(telescope)
    }

    /// Highest token of a telescope; 0 where none is known.
    pub fn highest(&self, telescope: &str) -> u64 {
        self.newest.get(telescope).copied().unwrap_or(0)
    }

    /// Somebody published this token of a lease that this node grants. It counts while this node has none of its own.
    pub fn show(&mut self, telescope: &str, token: u64) {
        if self.is_arbiter(telescope) && self.highest(telescope) == 0 && token <= LARGEST_SHOWN {
            let shown = self.shown.entry(telescope.to_owned()).or_default();
            *shown = token.max(*shown);
        }
    }

    /// The token that is granted next to a claimant that remembers this one.
    pub fn next(&self, telescope: &str, claimant_shows: Option<u64>) -> NextToken {
        let own = self.highest(telescope);
        let published = self.shown.get(telescope).copied();
        let shown = claimant_shows.filter(|token| *token <= LARGEST_SHOWN).max(published);
        let newest = shown.unwrap_or_default().max(own);
        NextToken { token: newest.saturating_add(1), left_behind: (newest > own).then_some(own) }
    }

    /// Is this token of another node of the same host higher than the own one, and one that can have been granted?
    pub fn is_raised_by(&self, telescope: &str, token: u64) -> bool {
        token <= LARGEST && token > self.highest(telescope)
    }

    /// Does this token of the arbiter's count change the own one? The arbiter itself follows nobody.
    pub fn follows(&self, telescope: &str, token: u64) -> bool {
        !self.is_arbiter(telescope) && token <= LARGEST && token != self.highest(telescope)
    }

    /// This token counts from now on.
    pub fn learn(&mut self, telescope: &str, token: u64) {
        self.newest.insert(telescope.to_owned(), token);
    }

    /// All tokens that count: what is written to the disk.
    pub fn newest(&self) -> &BTreeMap<String, u64> {
        &self.newest
    }

    /// The same with this one, before it counts.
    pub fn with(&self, telescope: &str, token: u64) -> BTreeMap<String, u64> {
        let mut newest = self.newest.clone();
        newest.insert(telescope.to_owned(), token);
        newest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arbiter_follows_nobody_and_others_follow_it_up_and_down() {
        let mut tokens = KnownTokens::default();
        tokens.learn("alpha", 7);
        assert!(tokens.follows("alpha", 9) && tokens.follows("alpha", 3) && !tokens.follows("alpha", 7));
        assert!(!tokens.follows("alpha", u64::MAX), "never granted");
        tokens.arbitrate("alpha");
        assert!(!tokens.follows("alpha", 9));
        let next = |telescope| tokens.next(telescope, None).token;
        assert_eq!((next("alpha"), next("beta")), (8, 1));
    }

    fn arbiter(own: u64) -> KnownTokens {
        let (mut tokens, _) = KnownTokens::of([("alpha".to_owned(), own)].into());
        tokens.arbitrate("alpha");
        tokens
    }

    #[test]
    fn an_arbiter_without_its_file_continues_beyond_what_it_is_shown_in_one_step() {
        let next = |own, published: &[u64], claimant_shows| {
            let mut tokens = arbiter(own);
            published.iter().for_each(|token| tokens.show("alpha", *token));
            let next = tokens.next("alpha", claimant_shows);
            (next.token, next.left_behind)
        };
        for (name, own, published, claimant_shows, expected) in [
            ("a first start", 0, &[][..], None, (1, None)),
            ("the claimant remembers it", 0, &[], Some(2000), (2001, Some(0))),
            ("it was on the bus", 0, &[1999, 2000, 1998], None, (2001, Some(0))),
            ("the newest of both", 0, &[2000], Some(1990), (2001, Some(0))),
            ("an older copy of the file", 1500, &[], Some(2000), (2001, Some(1500))),
            ("a claimant that is behind", 2000, &[], Some(1990), (2001, None)),
            ("a count of its own follows no sample", 7, &[2000], None, (8, None)),
            ("nobody grants so many", 0, &[u64::MAX], Some(u64::MAX), (1, None)),
            ("nor believes them next to a true one", 0, &[2000, 1 << 52], Some(1 << 52), (2001, Some(0))),
        ] {
            assert_eq!(next(own, published, claimant_shows), expected, "{name}");
        }
        let mut other = KnownTokens::default();
        other.show("beta", 2000);
        assert_eq!(other.next("beta", None).token, 1, "a lease that this node does not grant");
    }

    #[test]
    fn after_the_largest_invented_token_no_night_ends() {
        let mut tokens = arbiter(0);
        tokens.show("alpha", LARGEST_SHOWN);
        let first = tokens.next("alpha", None).token;
        tokens.learn("alpha", first);
        assert!(tokens.next("alpha", Some(first)).token == first + 1 && LARGEST - first > LARGEST_SHOWN);
        let (again, never_granted) = KnownTokens::of(tokens.newest().clone());
        assert!(never_granted.is_empty() && again.highest("alpha") == first);
    }
}
