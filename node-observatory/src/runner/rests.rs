//! Rows that wait for a device to recover: each time twice as long, and other rows go on meanwhile.

use std::collections::BTreeMap;
use std::time::Duration;

use bus::MachineTime;

/// No rest is longer than so many times the first.
const MOST: u32 = 10;

/// Until when each row rests, and how often it did.
#[derive(Debug, Default)]
pub struct Rests {
    rows: BTreeMap<usize, (MachineTime, u32)>,
}

impl Rests {
    /// Begins a rest; `first` is the length of the first one.
    pub fn begin(&mut self, row: usize, first: Duration, now: MachineTime) -> Duration {
        let count = self.rows.get(&row).map_or(0, |(_, count)| count + 1);
        let rest = first.saturating_mul(1_u32.checked_shl(count).unwrap_or(MOST).min(MOST));
        self.rows.insert(row, (now.plus(rest), count));
        rest
    }

    /// Does it rest now?
    pub fn rests(&self, row: usize, now: MachineTime) -> bool {
        self.rows.get(&row).is_some_and(|(until, _)| now < *until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_rest_is_twice_as_long_up_to_ten_times_the_first() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let mut rests = Rests::default();
        let lengths: Vec<u64> = (0..40).map(|_| rests.begin(3, Duration::from_secs(30), at(0)).as_secs()).collect();
        assert_eq!(lengths[..6], [30, 60, 120, 240, 300, 300]);
        assert_eq!(lengths[39], 300);
        assert!(rests.rests(3, at(299)) && !rests.rests(3, at(300)) && !rests.rests(2, at(0)));
    }
}
