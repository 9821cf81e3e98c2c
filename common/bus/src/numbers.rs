//! Which numbered payloads of each sender were received: each counts once, and what never came is known.

use std::collections::{BTreeSet, HashMap};

use contract::{BootId, Key};

/// Missing numbers remembered per sender, so that late ones are taken off the count: more than any cache holds.
const MOST_MISSING: usize = 20_000;
/// The same of all senders together.
const MOST_MISSING_OF_ALL: usize = 10 * MOST_MISSING;
/// Senders remembered; a key with an id in it (a frame's facts) makes one each.
const MOST_SENDERS: usize = 4_096;

/// The received numbers, by sender: one incarnation of a node on one key.
#[derive(Debug, Default)]
pub struct Numbers {
    senders: HashMap<(BootId, Key), Span>,
    heard: u64,
    /// How many missing numbers are remembered now.
    remembered: usize,
    /// Missing numbers of senders that are no longer remembered.
    given_up: u64,
}

/// From the oldest to the newest received number, all but the missing ones.
#[derive(Debug)]
struct Span {
    oldest: u64,
    newest: u64,
    missing: BTreeSet<u64>,
    /// Missing too, and too many to remember which.
    forgotten: u64,
    /// When it was last received from, counted in payloads.
    last: u64,
}

impl Numbers {
    /// Takes a number in; false if it was received before.
    pub fn hear(&mut self, boot_id: &BootId, key: &Key, seq: u64) -> bool {
        self.heard += 1;
        if let Some(span) = self.senders.get_mut(&(boot_id.clone(), key.clone())) {
            span.last = self.heard;
            let before = span.missing.len();
            let is_new = span.hear(seq, MOST_MISSING_OF_ALL.saturating_sub(self.remembered));
            self.remembered = self.remembered + span.missing.len() - before;
            return is_new;
        }
        if self.senders.len() >= MOST_SENDERS {
            self.forget_longest_silent();
        }
        let span = Span { oldest: seq, newest: seq, missing: BTreeSet::new(), forgotten: 0, last: self.heard };
        self.senders.insert((boot_id.clone(), key.clone()), span);
        true
    }

    /// How many were published between others that were received, and never came.
    pub fn missing(&self) -> u64 {
        self.senders.values().map(Span::count).fold(self.given_up, u64::saturating_add)
    }

    fn forget_longest_silent(&mut self) {
        let silent = self.senders.iter().min_by_key(|(_, span)| span.last).map(|(sender, _)| sender.clone());
        if let Some(span) = silent.and_then(|sender| self.senders.remove(&sender)) {
            self.given_up = self.given_up.saturating_add(span.count());
            self.remembered -= span.missing.len();
        }
    }
}

impl Span {
    /// Takes a number in; at most `room` more missing ones are remembered.
    fn hear(&mut self, seq: u64, room: usize) -> bool {
        if seq > self.newest {
            self.miss(self.newest + 1, seq, room);
            self.newest = seq;
            true
        } else if seq < self.oldest {
            self.miss(seq + 1, self.oldest, room);
            self.oldest = seq;
            true
        } else {
            self.missing.remove(&seq)
        }
    }

    /// Notes the numbers from `first` to before `end`.
    fn miss(&mut self, first: u64, end: u64, room: usize) {
        let room = MOST_MISSING.saturating_sub(self.missing.len()).min(room);
        self.missing.extend((first..end).take(room));
        self.forgotten = self.forgotten.saturating_add((end - first).saturating_sub(room as u64));
    }

    fn count(&self) -> u64 {
        self.forgotten.saturating_add(self.missing.len() as u64)
    }
}

#[cfg(test)]
mod tests {
    use contract::{Address, Kind};

    use super::*;

    fn key() -> Key {
        let address = Address::new("paranal", "callisto").unwrap();
        Key::State(address.device(Kind::Telescope, &"mount".parse().unwrap()))
    }

    #[test]
    fn what_never_came_is_counted_and_what_comes_late_is_not() {
        let mut numbers = Numbers::default();
        let (boot_id, key) = (BootId::fresh(), key());
        let new: Vec<bool> = [5, 6, 9, 10, 7, 10].into_iter().map(|seq| numbers.hear(&boot_id, &key, seq)).collect();
        assert_eq!(new, [true, true, true, true, true, false]);
        assert_eq!(numbers.missing(), 1, "only 8 is missing");
        assert!(numbers.hear(&BootId::fresh(), &key, 100));
        assert_eq!(numbers.missing(), 1, "another life begins anywhere");
        assert!(numbers.hear(&boot_id, &key, 1_000_000));
        assert_eq!(numbers.missing(), 1_000_000 - 10);
    }

    #[test]
    fn the_past_comes_after_the_present_and_counts_once() {
        let mut numbers = Numbers::default();
        let (boot_id, key) = (BootId::fresh(), key());
        assert!(numbers.hear(&boot_id, &key, 3));
        for seq in 0..3 {
            assert!(numbers.hear(&boot_id, &key, seq), "{seq}");
        }
        assert!(!numbers.hear(&boot_id, &key, 0) && !numbers.hear(&boot_id, &key, 3));
        assert_eq!(numbers.missing(), 0);
    }

    #[test]
    fn what_a_stranger_leaves_out_takes_no_memory() {
        let mut numbers = Numbers::default();
        for sender in 0..200 {
            let boot_id = BootId::fresh();
            numbers.hear(&boot_id, &key(), sender);
            numbers.hear(&boot_id, &key(), u64::MAX);
        }
        let remembered: usize = numbers.senders.values().map(|span| span.missing.len()).sum();
        assert_eq!((remembered, numbers.remembered), (MOST_MISSING_OF_ALL, MOST_MISSING_OF_ALL));
        assert_eq!(numbers.missing(), u64::MAX);
        let boots: Vec<BootId> = (0..MOST_SENDERS).map(|_| BootId::fresh()).collect();
        for boot_id in &boots {
            numbers.hear(boot_id, &key(), 0);
        }
        assert_eq!(numbers.remembered, 0, "what is forgotten takes no room");
    }

    #[test]
    fn the_longest_silent_sender_is_forgotten_first() {
        let mut numbers = Numbers::default();
        let boots: Vec<BootId> = (0..=MOST_SENDERS).map(|_| BootId::fresh()).collect();
        for boot_id in &boots[..MOST_SENDERS] {
            numbers.hear(boot_id, &key(), 0);
        }
        numbers.hear(&boots[0], &key(), 1);
        numbers.hear(&boots[1], &key(), 2);
        for boot_id in &boots[2..MOST_SENDERS] {
            numbers.hear(boot_id, &key(), 1);
        }
        numbers.hear(&boots[MOST_SENDERS], &key(), 0);
        assert_eq!((numbers.senders.len(), numbers.missing()), (MOST_SENDERS, 1));
        assert!(!numbers.hear(&boots[1], &key(), 2), "heard just now");
        assert!(numbers.hear(&boots[0], &key(), 1), "forgotten");
    }
}
