//! Fencing tokens as a device node counts and follows them; pure.
//!
//! The arbiter counts by what it granted itself, and no sample on the bus changes that. All other nodes follow
//! the arbiter's own count, up and down: a token that somebody invents counts only until the arbiter publishes again.

use std::collections::{BTreeMap, BTreeSet};

/// A token is one more than the one before. One that is larger than this was never granted by anybody.
const LARGEST: u64 = 1 << 53;

/// The newest tokens known, by telescope.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct KnownTokens {
    /// Telescopes whose leases this node grants.
    arbitrated: BTreeSet<String>,
    newest: BTreeMap<String, u64>,
}

impl KnownTokens {
    /// What a file had; also those of it that nobody can have granted, which do not count.
    pub fn of(newest: BTreeMap<String, u64>) -> (Self, BTreeMap<String, u64>) {
        let (newest, never_granted) = newest.into_iter().partition(|(_, token)| *token <= LARGEST);
        (Self { arbitrated: BTreeSet::new(), newest }, never_granted)
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

    /// The token that is granted next.
    pub fn next(&self, telescope: &str) -> u64 {
        self.highest(telescope).saturating_add(1)
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
        assert_eq!((tokens.next("alpha"), tokens.next("beta")), (8, 1));
    }
}
