//! Which numbered payloads of each sender were received: each counts once, and what never came is known.

use std::collections::{BTreeMap, HashMap};

use contract::{BootId, Key};

/// Ranges of missing numbers remembered per sender, so that late ones are taken off.
const MOST_RANGES: usize = 20_000;
/// The same of all senders together.
const MOST_RANGES_OF_ALL: usize = 10 * MOST_RANGES;
/// Senders remembered; a key with an id in it (a frame's facts) makes one each.
const MOST_SENDERS: usize = 4_096;

/// Payloads of one sender that follow each other by their numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Gap {
    /// The incarnation of the sender.
    pub boot_id: BootId,
    /// Its key.
    pub key: Key,
    /// The first and the last number.
    pub first: u64,
    /// See `first`.
    pub last: u64,
}

/// The received numbers, by sender: one incarnation of a node on one key.
#[derive(Debug, Default)]
pub struct Numbers {
    senders: HashMap<(BootId, Key), Span>,
    received: u64,
    /// How many ranges of missing numbers are remembered now.
    remembered: usize,
    /// Missing numbers that nothing can bring any more, or that are no longer remembered.
    given_up: u64,
}

/// From the oldest to the newest received number, all but the missing ones.
#[derive(Debug)]
struct Span {
    oldest: u64,
    newest: u64,
    /// The first number of each range, with its last one.
    missing: BTreeMap<u64, u64>,
    /// Missing too, and in too many ranges to remember which.
    forgotten: u64,
    /// When its last payload came, counted in payloads.
    last: u64,
}

impl Numbers {
    /// What was received before, in an earlier incarnation of the receiver: of senders all numbers from one to another.
    pub fn after(known: Vec<(BootId, Key, u64, u64)>) -> Self {
        let mut numbers = Self::default();
        for (boot_id, key, oldest, newest) in known {
            let span = Span { oldest, newest, missing: BTreeMap::new(), forgotten: 0, last: 0 };
            numbers.senders.insert((boot_id, key), span);
        }
        numbers
    }

    /// Takes a number in; false if it was received before.
    pub fn observe(&mut self, boot_id: &BootId, key: &Key, seq: u64) -> bool {
        self.received += 1;
        let received = self.received;
        if let Some(is_new) = self.change(boot_id, key, |span, room| {
            span.last = received;
            span.observe(seq, room)
        }) {
            return is_new;
        }
        if self.senders.len() >= MOST_SENDERS {
            self.forget_longest_silent();
        }
        let span = Span { oldest: seq, newest: seq, missing: BTreeMap::new(), forgotten: 0, last: self.received };
        self.senders.insert((boot_id.clone(), key.clone()), span);
        true
    }

    /// A received payload was dropped again: it is missing.
    pub fn lose(&mut self, boot_id: &BootId, key: &Key, seq: u64) {
        self.change(boot_id, key, |span, room| span.miss(seq, seq, room));
    }

    /// How many were published between others that were received, and never came.
    pub fn missing(&self) -> u64 {
        self.senders.values().map(Span::count).fold(self.given_up, u64::saturating_add)
    }

    /// The missing numbers of all senders that may still come.
    pub fn gaps(&self) -> Vec<Gap> {
        if self.remembered == 0 {
            return Vec::new();
        }
        let of_sender = |((boot_id, key), span): (&(BootId, Key), &Span)| {
            let gap = |(first, last): (&u64, &u64)| Gap {
                boot_id: boot_id.clone(),
                key: key.clone(),
                first: *first,
                last: *last,
            };
            span.missing.iter().map(gap).collect::<Vec<_>>()
        };
        self.senders.iter().flat_map(of_sender).collect()
    }

    /// Those of the numbers in `gaps` that are still missing.
    pub fn still_missing(&self, gaps: &[Gap]) -> Vec<Gap> {
        let mut left = Vec::new();
        for gap in gaps {
            let Some(span) = self.senders.get(&(gap.boot_id.clone(), gap.key.clone())) else { continue };
            for (first, last) in span.missing.range(..=gap.last).filter(|(_, last)| **last >= gap.first) {
                left.push(Gap { first: gap.first.max(*first), last: gap.last.min(*last), ..gap.clone() });
            }
        }
        left
    }

    /// Nothing can bring these any more; they no longer count as gaps.
    pub fn give_up(&mut self, gaps: &[Gap]) {
        for Gap { boot_id, key, first, last } in gaps {
            self.change(boot_id, key, |span, room| span.take(*first, *last, room));
            self.given_up = self.given_up.saturating_add((last - first).saturating_add(1));
        }
    }

    /// Changes the span of a sender that is known, with the number of ranges that may be added.
    fn change<T>(&mut self, boot_id: &BootId, key: &Key, change: impl FnOnce(&mut Span, usize) -> T) -> Option<T> {
        let span = self.senders.get_mut(&(boot_id.clone(), key.clone()))?;
        let before = span.missing.len();
        let room = MOST_RANGES_OF_ALL.saturating_sub(self.remembered).min(MOST_RANGES.saturating_sub(before));
        let result = change(span, room);
        self.remembered = self.remembered + span.missing.len() - before;
        Some(result)
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
    /// Takes a number in; at most `room` more ranges of missing ones are remembered.
    fn observe(&mut self, seq: u64, room: usize) -> bool {
        if seq > self.newest {
            if seq - self.newest > 1 {
                self.miss(self.newest + 1, seq - 1, room);
            }
            self.newest = seq;
            true
        } else if seq < self.oldest {
            if self.oldest - seq > 1 {
                self.miss(seq + 1, self.oldest - 1, room);
            }
            self.oldest = seq;
            true
        } else {
            self.take(seq, seq, room)
        }
    }

    /// Notes that the numbers from `first` to `last` are missing, none of which was.
    fn miss(&mut self, mut first: u64, mut last: u64, room: usize) {
        if let Some((before, _)) = self.missing.range(..first).next_back().filter(|(_, end)| **end + 1 == first) {
            first = *before;
        }
        if let Some(end) = last.checked_add(1).and_then(|next| self.missing.remove(&next)) {
            last = end;
        }
        if room == 0 && !self.missing.contains_key(&first) {
            self.forgotten = self.forgotten.saturating_add((last - first).saturating_add(1));
        } else {
            self.missing.insert(first, last);
        }
    }

    /// Takes the numbers from `first` to `last` off the missing ones; false if none of them was missing.
    fn take(&mut self, first: u64, last: u64, room: usize) -> bool {
        let touched: Vec<(u64, u64)> = self
            .missing
            .range(..=last)
            .rev()
            .take_while(|(_, end)| **end >= first)
            .map(|(start, end)| (*start, *end))
            .collect();
        for (start, end) in &touched {
            self.missing.remove(start);
            if *start < first {
                self.missing.insert(*start, first - 1);
            }
            if *end > last {
                if room == 0 && *start < first {
                    self.forgotten = self.forgotten.saturating_add(end - last);
                } else {
                    self.missing.insert(last + 1, *end);
                }
            }
        }
        !touched.is_empty()
    }

    fn count(&self) -> u64 {
        let ranges = self.missing.iter().map(|(first, last)| (last - first).saturating_add(1));
        ranges.fold(self.forgotten, u64::saturating_add)
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
        let new: Vec<bool> = [5, 6, 9, 10, 7, 10].into_iter().map(|seq| numbers.observe(&boot_id, &key, seq)).collect();
        assert_eq!(new, [true, true, true, true, true, false]);
        assert_eq!(numbers.missing(), 1, "only 8 is missing");
        assert!(numbers.observe(&BootId::fresh(), &key, 100));
        assert_eq!(numbers.missing(), 1, "another incarnation begins anywhere");
        assert!(numbers.observe(&boot_id, &key, 1_000_000));
        assert_eq!(numbers.missing(), 1_000_000 - 10);
    }

    #[test]
    fn the_past_comes_after_the_present_and_counts_once() {
        let mut numbers = Numbers::default();
        let (boot_id, key) = (BootId::fresh(), key());
        assert!(numbers.observe(&boot_id, &key, 3));
        for seq in 0..3 {
            assert!(numbers.observe(&boot_id, &key, seq), "{seq}");
        }
        assert!(!numbers.observe(&boot_id, &key, 0) && !numbers.observe(&boot_id, &key, 3));
        assert_eq!(numbers.missing(), 0);
    }

    #[test]
    fn what_a_stranger_leaves_out_takes_no_memory() {
        let mut numbers = Numbers::default();
        for sender in 0..200 {
            let boot_id = BootId::fresh();
            numbers.observe(&boot_id, &key(), sender);
            numbers.observe(&boot_id, &key(), u64::MAX);
        }
        let remembered: usize = numbers.senders.values().map(|span| span.missing.len()).sum();
        assert_eq!((remembered, numbers.remembered), (200, 200));
        assert_eq!(numbers.missing(), u64::MAX);
        for sender in 0..12 {
            let boot_id = BootId::fresh();
            for range in 0..MOST_RANGES as u64 + 9 {
                numbers.observe(&boot_id, &key(), sender + 2 * range);
            }
        }
        assert_eq!(numbers.remembered, MOST_RANGES_OF_ALL);
        let boots: Vec<BootId> = (0..MOST_SENDERS).map(|_| BootId::fresh()).collect();
        for boot_id in &boots {
            numbers.observe(boot_id, &key(), 0);
        }
        assert_eq!(numbers.remembered, 0, "what is forgotten takes no room");
    }

    #[test]
    fn the_longest_silent_sender_is_forgotten_first() {
        let mut numbers = Numbers::default();
        let boots: Vec<BootId> = (0..=MOST_SENDERS).map(|_| BootId::fresh()).collect();
        for boot_id in &boots[..MOST_SENDERS] {
            numbers.observe(boot_id, &key(), 0);
        }
        numbers.observe(&boots[0], &key(), 1);
        numbers.observe(&boots[1], &key(), 2);
        for boot_id in &boots[2..MOST_SENDERS] {
            numbers.observe(boot_id, &key(), 1);
        }
        numbers.observe(&boots[MOST_SENDERS], &key(), 0);
        assert_eq!((numbers.senders.len(), numbers.missing()), (MOST_SENDERS, 1));
        assert!(!numbers.observe(&boots[1], &key(), 2), "received just now");
        assert!(numbers.observe(&boots[0], &key(), 1), "forgotten");
    }

    fn ranges(numbers: &Numbers) -> Vec<(u64, u64)> {
        let mut ranges: Vec<_> = numbers.gaps().iter().map(|gap| (gap.first, gap.last)).collect();
        ranges.sort_unstable();
        ranges
    }

    #[test]
    fn one_that_was_away_knows_what_it_lacks_and_takes_nothing_twice() {
        let (boot_id, key) = (BootId::fresh(), key());
        let mut numbers = Numbers::after(vec![(boot_id.clone(), key.clone(), 30, 100)]);
        assert!(!numbers.observe(&boot_id, &key, 42) && !numbers.observe(&boot_id, &key, 100));
        assert!(numbers.observe(&boot_id, &key, 151) && numbers.observe(&boot_id, &key, 152));
        assert_eq!(ranges(&numbers), [(101, 150)]);
        assert!(numbers.observe(&boot_id, &key, 120), "it comes late");
        assert_eq!(ranges(&numbers), [(101, 119), (121, 150)]);
        numbers.lose(&boot_id, &key, 120);
        numbers.lose(&boot_id, &key, 152);
        assert_eq!(ranges(&numbers), [(101, 150), (152, 152)], "what was dropped is missing again");
        let asked = numbers.gaps();
        for seq in (101..=110).chain(140..=152) {
            assert!(numbers.observe(&boot_id, &key, seq) != (seq == 151), "{seq}");
        }
        let left = numbers.still_missing(&asked);
        assert_eq!(left, [Gap { boot_id: boot_id.clone(), key: key.clone(), first: 111, last: 139 }]);
        numbers.give_up(&left);
        assert_eq!((ranges(&numbers), numbers.missing(), numbers.remembered), (vec![], 29, 0));
        assert!(!numbers.observe(&boot_id, &key, 120), "given up");
    }
}
