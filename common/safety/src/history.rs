//! The received states of the safety inputs, as far back as the dwell times look.

use std::collections::VecDeque;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use units::{MachineTime, SkyTime};

/// Both monotonic times of one instant: dwell is judged in sky time, age in machine time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Now {
    /// Sky time.
    pub sky: SkyTime,
    /// Machine time.
    pub machine: MachineTime,
}

/// How long before a moment something was, by both clocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ago {
    machine: Duration,
    sky: Duration,
}

impl Ago {
    /// What was at `at`, seen from `now`.
    pub fn of(at: Now, now: Now) -> Self {
        Self { machine: now.machine.since(at.machine), sky: now.sky.since(at.sky) }
    }

    /// When that was, for one whose `now` this is.
    pub fn before(self, now: Now) -> Now {
        Now { sky: now.sky.minus(self.sky), machine: now.machine.minus(self.machine) }
    }
}

/// One value of an input, or why there was none.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry<T> {
    /// When it arrived here.
    pub at: Now,
    /// The value or the reason why there is none.
    pub outcome: Result<T, String>,
}

/// The values of one input, oldest first.
#[derive(Debug, Clone)]
pub struct Record<T> {
    entries: VecDeque<Entry<T>>,
    /// Outlives the dwell: an input that fell silent over a bad value stays bad.
    last_known: Option<Entry<T>>,
    /// Outlives it too: when the first value came.
    known_since: Option<SkyTime>,
    /// Why nothing has come since the newest entry, where the input's node reports that.
    silent: Option<String>,
    /// The good record that another incarnation of this node received.
    before: Option<GoodBefore>,
    /// This incarnation has received something.
    is_live: bool,
}

/// A good record without a gap, which ends with an entry that was restored.
#[derive(Debug, Clone, Copy)]
struct GoodBefore {
    began: Now,
    ends: Now,
}

/// What of a record survives a restart of this node, as it was when it was written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StoredRecord<T> {
    /// The newest bad value, where the record has one, and the newest entry.
    entries: Vec<(Ago, Result<T, String>)>,
    last_known: Option<(Ago, Result<T, String>)>,
    /// When the first value came, or when the listening for it began.
    known_since: Duration,
    /// When the record that ends with the newest entry began, if it is good.
    good_since: Option<Ago>,
}

/// More entries than any dwell needs; when they run out, the record starts later, which is the safe side.
const MOST_ENTRIES: usize = 50_000;

impl<T> Default for Record<T> {
    fn default() -> Self {
        Self {
            entries: VecDeque::new(),
            last_known: None,
            known_since: None,
            silent: None,
            before: None,
            is_live: false,
        }
    }
}

/// What a record proves.
#[derive(Debug, Clone, PartialEq)]
pub enum Evidence<T> {
    /// No value now, for this reason.
    Missing(String),
    /// The newest value is bad.
    Bad(T),
    /// Nothing but good values, without a gap, since then.
    Good {
        /// Start of the unbroken record.
        since: SkyTime,
        /// The newest value.
        newest: T,
    },
}

impl<T: Clone> Record<T> {
    /// No reading has come, for this reason: the newest one stays the newest one, and grows old.
    pub fn is_silent(&mut self, why: String) {
        self.silent = Some(why);
    }

    /// Adds the newest value.
    pub fn push(&mut self, entry: Entry<T>) {
        self.silent = None;
        self.is_live = true;
        if entry.outcome.is_ok() {
            self.last_known = Some(entry.clone());
            self.known_since.get_or_insert(entry.at.sky);
        }
        if self.entries.len() >= MOST_ENTRIES {
            self.entries.pop_front();
        }
        self.entries.push_back(entry);
    }

    /// Forgets what ended more than `dwell` ago, but for the one entry that shows how the window began.
    pub fn forget(&mut self, now: Now, dwell: Duration) {
        while self.entries.get(1).is_some_and(|second| now.sky.since(second.at.sky) > dwell) {
            self.entries.pop_front();
        }
    }

    /// Has this incarnation of the node received a value?
    pub fn is_live(&self) -> bool {
        self.is_live
    }

    /// The newest entry.
    pub fn newest(&self) -> Option<&Entry<T>> {
        self.entries.back()
    }

    /// The newest entry that carried a value, however old.
    pub fn last_known(&self) -> Option<&Entry<T>> {
        self.last_known.as_ref()
    }

    /// When the first value came, or when another incarnation began to listen for it, however long ago.
    pub fn known_since(&self) -> Option<SkyTime> {
        self.known_since
    }

    /// All that is remembered.
    pub fn entries(&self) -> impl Iterator<Item = &Entry<T>> {
        self.entries.iter()
    }

    /// In words why there is no entry at all.
    pub fn nothing(&self) -> String {
        self.silent.clone().unwrap_or_else(|| "nothing received yet".to_owned())
    }

    /// What the record proves; silence longer than `max_age` is a gap, and at its end a missing value.
    pub fn evidence(&self, now: Now, max_age: Duration, is_good: impl Fn(&T) -> bool) -> Evidence<T> {
        let Some(newest) = self.newest() else { return Evidence::Missing(self.nothing()) };
        let age = now.machine.since(newest.at.machine);
        if age > max_age {
            let why = self.silent.as_ref().map(|why| format!("; {why}")).unwrap_or_default();
            return Evidence::Missing(format!(
                "stale: last received {:.1} s ago, allowed are {:.1} s{why}",
                age.as_secs_f64(),
                max_age.as_secs_f64()
            ));
        }
        let value = match &newest.outcome {
            Ok(value) => value,
            Err(reason) => return Evidence::Missing(reason.clone()),
        };
        if !is_good(value) {
            return Evidence::Bad(value.clone());
        }
        Evidence::Good { since: self.good_since(newest, max_age, is_good).sky, newest: value.clone() }
    }

    /// When the good record that ends with the newest entry began.
    fn good_since(&self, newest: &Entry<T>, max_age: Duration, is_good: impl Fn(&T) -> bool) -> Now {
        let mut since = newest.at;
        for entry in self.entries.iter().rev() {
            let good = entry.outcome.as_ref().is_ok_and(&is_good);
            if !good || since.machine.since(entry.at.machine) > max_age {
                break;
            }
            since = entry.at;
            if let Some(before) = self.before.filter(|before| before.ends == entry.at) {
                return before.began;
            }
        }
        since
    }

    /// What is to be written of it; the listening began at `since`.
    pub fn store(&self, now: Now, max_age: Duration, since: SkyTime, is_good: impl Fn(&T) -> bool) -> StoredRecord<T> {
        let stored = |entry: &Entry<T>| (Ago::of(entry.at, now), entry.outcome.clone());
        let is_bad = |entry: &&Entry<T>| entry.outcome.as_ref().is_ok_and(|value| !is_good(value));
        let earlier = self.entries.iter().rev().skip(1).find(is_bad);
        let good = self.newest().filter(|newest| newest.outcome.as_ref().is_ok_and(&is_good));
        StoredRecord {
            entries: earlier.into_iter().chain(self.newest()).map(stored).collect(),
            last_known: self.last_known.as_ref().map(stored),
            known_since: now.sky.since(self.known_since.map_or(since, |known| known.min(since))),
            good_since: good.map(|newest| Ago::of(self.good_since(newest, max_age, &is_good), now)),
        }
    }

    /// The record of another incarnation of this node, which wrote it `then`. It counts as far as live values join it.
    pub fn of_stored(stored: &StoredRecord<T>, then: Now) -> Self {
        let entry =
            |(ago, outcome): &(Ago, Result<T, String>)| Entry { at: ago.before(then), outcome: outcome.clone() };
        let entries: VecDeque<Entry<T>> = stored.entries.iter().map(entry).collect();
        let ends = entries.back().map(|newest| newest.at);
        Self {
            before: ends.zip(stored.good_since).map(|(ends, ago)| GoodBefore { began: ago.before(then), ends }),
            entries,
            last_known: stored.last_known.as_ref().map(entry),
            known_since: Some(then.sky.minus(stored.known_since)),
            silent: None,
            is_live: false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: u64) -> Now {
        let since = Duration::from_secs(seconds);
        Now { sky: SkyTime::from_start(since), machine: MachineTime::from_boot(since) }
    }

    fn record(outcomes: &[(u64, Result<f64, String>)]) -> Record<f64> {
        let mut record = Record::default();
        for (seconds, outcome) in outcomes {
            record.push(Entry { at: at(*seconds), outcome: outcome.clone() });
        }
        record
    }

    const MAX_AGE: Duration = Duration::from_secs(10);

    fn since(record: &Record<f64>, now: u64) -> Option<SkyTime> {
        match record.evidence(at(now), MAX_AGE, |value| *value < 5.0) {
            Evidence::Good { since, .. } => Some(since),
            Evidence::Bad(_) | Evidence::Missing(_) => None,
        }
    }

    #[test]
    fn evidence_reaches_back_to_the_last_bad_word_gap_or_missing_value() {
        assert_eq!(since(&record(&[(0, Ok(1.0)), (8, Ok(1.0)), (16, Ok(1.0))]), 18), Some(at(0).sky));
        assert_eq!(since(&record(&[(0, Ok(1.0)), (8, Ok(9.0)), (16, Ok(1.0))]), 18), Some(at(16).sky));
        assert_eq!(since(&record(&[(0, Ok(1.0)), (8, Err("x".into())), (16, Ok(1.0))]), 18), Some(at(16).sky));
        assert_eq!(since(&record(&[(0, Ok(1.0)), (11, Ok(1.0)), (16, Ok(1.0))]), 18), Some(at(11).sky));
        assert_eq!(since(&record(&[(0, Ok(1.0))]), 11), None);
    }

    #[test]
    fn forgetting_keeps_how_the_window_began() {
        let mut record = record(&[(0, Ok(1.0)), (8, Ok(1.0)), (16, Ok(1.0)), (24, Ok(1.0))]);
        record.forget(at(30), Duration::from_secs(20));
        assert_eq!(since(&record, 30), Some(at(8).sky));
    }

    #[test]
    fn the_last_value_is_remembered_through_silence() {
        let mut record = record(&[(0, Ok(9.0)), (5, Err("timeout".into())), (10, Err("timeout".into()))]);
        record.forget(at(1000), Duration::from_secs(1));
        assert_eq!(record.last_known().unwrap().outcome, Ok(9.0));
    }
}
