//! Rows that wait for a device to recover: each time twice as long, and other rows go on meanwhile.

use std::collections::BTreeMap;
use std::time::Duration;

use units::MachineTime;

use crate::row::RowId;

/// No rest is longer than so many times the first.
const MOST: u32 = 10;

/// The time until which each row rests, and how often it did.
#[derive(Debug, Default)]
pub struct Rests {
    rows: BTreeMap<RowId, (MachineTime, u32)>,
}

impl Rests {
    /// Begins a rest; `first` is the length of the first one.
    pub fn begin(&mut self, row: &RowId, first: Duration, now: MachineTime) -> Duration {
        let count = self.rows.get(row).map_or(0, |(_, count)| count + 1);
        let rest = first.saturating_mul(1_u32.checked_shl(count).unwrap_or(MOST).min(MOST));
        self.rows.insert(row.clone(), (now.plus(rest), count));
        rest
    }

    /// Lets a row rest for so long; this does not mean that anything is wrong with it.
    pub fn hold(&mut self, row: &RowId, length: Duration, now: MachineTime) {
        let count = self.rows.get(row).map_or(0, |(_, count)| *count);
        self.rows.insert(row.clone(), (now.plus(length), count));
    }

    /// Forgets the rows for which `is_known` is false.
    pub fn keep(&mut self, is_known: impl Fn(&RowId) -> bool) {
        self.rows.retain(|row, _| is_known(row));
    }

    /// Does a row rest now?
    pub fn rests(&self, row: &RowId, now: MachineTime) -> bool {
        self.rows.get(row).is_some_and(|(until, _)| now < *until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_rest_is_twice_as_long_up_to_ten_times_the_first() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let (mut rests, row) = (Rests::default(), RowId("a".to_owned()));
        let lengths: Vec<u64> = (0..40).map(|_| rests.begin(&row, Duration::from_secs(30), at(0)).as_secs()).collect();
        assert_eq!(lengths[..6], [30, 60, 120, 240, 300, 300]);
        assert_eq!(lengths[39], 300);
        assert!(rests.rests(&row, at(299)) && !rests.rests(&row, at(300)));
        assert!(!rests.rests(&RowId("b".to_owned()), at(0)));
        rests.hold(&row, Duration::from_secs(7), at(400));
        assert!(rests.rests(&row, at(406)) && !rests.rests(&row, at(407)));
        rests.keep(|_| false);
        assert!(!rests.rests(&row, at(0)));
    }
}
