//! The received states of the safety inputs, as far back as the dwell times look.

use std::collections::VecDeque;
use std::time::Duration;

use units::{MachineTime, SkyTime};

/// Both monotonic times of one instant: dwell is judged in sky time, age in machine time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Now {
    /// Sky time.
    pub sky: SkyTime,
    /// Machine time.
    pub machine: MachineTime,
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
}

/// More entries than any dwell needs; when they run out, the record starts later, which is the safe side.
const MOST_ENTRIES: usize = 50_000;

impl<T> Default for Record<T> {
    fn default() -> Self {
        Self { entries: VecDeque::new(), last_known: None, known_since: None, silent: None }
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

    /// Was no value ever received?
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The newest entry.
    pub fn newest(&self) -> Option<&Entry<T>> {
        self.entries.back()
    }

    /// The newest entry that carried a value, however old.
    pub fn last_known(&self) -> Option<&Entry<T>> {
        self.last_known.as_ref()
    }

    /// When the first value came, however long ago.
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
        let mut first = newest;
        for entry in self.entries.iter().rev().skip(1) {
            let good = entry.outcome.as_ref().is_ok_and(&is_good);
            if !good || first.at.machine.since(entry.at.machine) > max_age {
                break;
            }
            first = entry;
        }
        Evidence::Good { since: first.at.sky, newest: value.clone() }
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
