//! The requests to the simulator: every PUT with its machine time, and how many requests a minute.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use serde::Serialize;
use units::Utc;

use crate::clock::wall_clock;
use crate::kind::Kind;

/// Entries kept; older ones are forgotten.
const MOST_STORED: usize = 20_000;

/// One PUT to a device.
#[derive(Debug, Clone, Serialize)]
pub struct Entry {
    /// Counts up from 1.
    pub seq: u64,
    /// Host's wall clock on arrival.
    pub wall_utc: Utc,
    /// Sky time on arrival.
    pub sky_utc: Utc,
    /// Machine time on arrival; compare with `Instant`s of the same process.
    #[serde(skip)]
    pub at: Instant,
    /// The device.
    pub device: Kind,
    /// Lower-case member, such as `closeshutter`.
    pub member: String,
    /// Its parameters, `Name=value&...`.
    pub parameters: String,
    /// ASCOM error number of the answer, 0 for success; None while the answer is kept back by a fault.
    pub error: Option<i32>,
}

/// The log of one simulator.
#[derive(Debug, Default)]
pub struct Log {
    puts: VecDeque<Entry>,
    last_seq: u64,
    total: u64,
    by_device: BTreeMap<Kind, u64>,
    recent: VecDeque<Instant>,
}

impl Log {
    /// Counts any request to a device.
    pub fn count(&mut self, device: Kind) {
        let now = Instant::now();
        self.total += 1;
        *self.by_device.entry(device).or_default() += 1;
        self.recent.push_back(now);
        while self.recent.front().is_some_and(|at| now.duration_since(*at) > Duration::from_secs(60)) {
            self.recent.pop_front();
        }
    }

    /// Notes a PUT on its arrival; gives its number.
    pub fn note(&mut self, device: Kind, member: &str, parameters: String, sky_utc: Utc) -> u64 {
        self.last_seq += 1;
        self.puts.push_back(Entry {
            seq: self.last_seq,
            wall_utc: wall_clock(),
            sky_utc,
            at: Instant::now(),
            device,
            member: member.to_owned(),
            parameters,
            error: None,
        });
        if self.puts.len() > MOST_STORED {
            self.puts.pop_front();
        }
        self.last_seq
    }

    /// Notes how a PUT was answered.
    pub fn answered(&mut self, seq: u64, error: i32) {
        if let Some(entry) = self.puts.iter_mut().rev().find(|entry| entry.seq == seq) {
            entry.error = Some(error);
        }
    }

    /// The PUTs with a number greater than `seq`, oldest first.
    pub fn since(&self, seq: u64) -> Vec<Entry> {
        self.puts.iter().filter(|entry| entry.seq > seq).cloned().collect()
    }

    /// Requests within the last minute of machine time.
    pub fn last_minute(&self) -> usize {
        let now = Instant::now();
        self.recent.iter().filter(|at| now.duration_since(**at) <= Duration::from_secs(60)).count()
    }

    /// Requests since the start.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// Requests since the start, per device.
    pub fn by_device(&self) -> &BTreeMap<Kind, u64> {
        &self.by_device
    }
}
