//! How often somebody may ask: a bucket of tries for each, which fills again with time.

use std::collections::HashMap;
use std::hash::Hash;
use std::time::Duration;

use bus::MachineTime;

/// Buckets that are remembered; those that came later share one.
const MOST: usize = 10_000;
const TIDY_EVERY: Duration = Duration::from_secs(1);

/// A bucket of tries for each key.
#[derive(Debug)]
pub struct Buckets<K> {
    per_s: f64,
    burst: f64,
    /// Tries that are left, and when that was so; under no key for all that find no place.
    left: HashMap<Option<K>, (f64, MachineTime)>,
    /// When those that were full again were last forgotten; looking at all of them takes time.
    tidied: Option<MachineTime>,
}

impl<K: Hash + Eq> Buckets<K> {
    /// So many tries per second for ever, and so many at once.
    pub fn new(per_s: f64, burst: f64) -> Self {
        Self { per_s, burst, left: HashMap::new(), tidied: None }
    }

    /// Takes one try, or returns how long to wait for it.
    pub fn take(&mut self, key: K, now: MachineTime) -> Result<(), Duration> {
        let key = self.place(key, now);
        let left = self.left_of(&key, now);
        let taken = left >= 1.0;
        self.left.insert(key, (if taken { left - 1.0 } else { left }, now));
        if taken { Ok(()) } else { Err(Duration::from_secs_f64((1.0 - left) / self.per_s)) }
    }

    /// Gives back a try that was taken.
    pub fn give_back(&mut self, key: K, now: MachineTime) {
        let key = self.place(key, now);
        let left = self.left_of(&key, now);
        self.left.insert(key, ((left + 1.0).min(self.burst), now));
    }

    fn left_of(&self, key: &Option<K>, now: MachineTime) -> f64 {
        let Some((left, at)) = self.left.get(key) else { return self.burst };
        (left + now.since(*at).as_secs_f64() * self.per_s).min(self.burst)
    }

    fn place(&mut self, key: K, now: MachineTime) -> Option<K> {
        let key = Some(key);
        let is_full = |left: &HashMap<_, _>| left.len() >= MOST && !left.contains_key(&key);
        if is_full(&self.left) && self.tidied.is_none_or(|tidied| now.since(tidied) >= TIDY_EVERY) {
            let (per_s, burst) = (self.per_s, self.burst);
            self.left.retain(|_, (left, at)| *left + now.since(*at).as_secs_f64() * per_s < burst);
            self.tidied = Some(now);
        }
        if is_full(&self.left) { None } else { key }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: f64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs_f64(s))
    }

    #[test]
    fn a_bucket_gives_its_burst_and_then_its_rate_to_each_key() {
        let mut buckets = Buckets::new(2.0, 3.0);
        let mut taken = |key: &'static str, s: f64| (0..10).filter(|_| buckets.take(key, at(s)).is_ok()).count();
        assert_eq!([taken("a", 1.0), taken("b", 1.0), taken("a", 2.0), taken("a", 100.0)], [3, 3, 2, 3]);
        assert_eq!(buckets.take("a", at(100.0)), Err(Duration::from_millis(500)));
        buckets.give_back("a", at(100.0));
        assert_eq!(buckets.take("a", at(100.0)), Ok(()));
    }

    #[test]
    fn many_keys_take_no_more_memory_than_ten_thousand() {
        let mut buckets = Buckets::new(0.001, 1.0);
        let passed = (0..300_000).filter(|key| buckets.take(*key, at(1.0)).is_ok()).count();
        assert!(buckets.left.len() <= MOST + 1 && passed == MOST + 1, "{passed}");
        assert!(buckets.take(2_000_000, at(5_000.0)).is_ok(), "those that are full again are forgotten");
        assert!(buckets.left.len() <= 2);
    }
}
