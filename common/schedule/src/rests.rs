//! Rows that wait for a device to recover: each time twice as long, and other rows go on meanwhile.

use std::collections::BTreeMap;
use std::time::Duration;

use units::MachineTime;

use crate::row::RowId;

/// No rest is longer than so many times the first.
const MOST: u32 = 10;

/// The rests of rows.
#[derive(Debug, Default)]
pub struct Rests {
    rows: BTreeMap<RowId, Rest>,
}

#[derive(Debug)]
struct Rest {
    until: MachineTime,
    /// How many there were before it.
    count: u32,
    /// The device whose answer ends it, and from when on.
    silent: Option<(String, MachineTime)>,
}

impl Rests {
    /// Begins a rest; `first` is the length of the first one.
    pub fn begin(&mut self, row: &RowId, first: Duration, now: MachineTime) -> Duration {
        let count = self.rows.get(row).map_or(0, |rest| rest.count + 1);
        let length = grown(first, count);
        self.rows.insert(row.clone(), Rest { until: now.plus(length), count, silent: None });
        length
    }

    /// Lets a rest that has begun end when `device` is heard, after a pause that grows from `first` as rests do: a device
    /// that comes and goes is not asked at once each time.
    pub fn end_when_heard(&mut self, row: &RowId, device: String, first: Duration, now: MachineTime) {
        if let Some(rest) = self.rows.get_mut(row) {
            rest.silent = Some((device, now.plus(grown(first, rest.count))));
        }
    }

    /// Ends the rests for devices that are heard again.
    pub fn heard(&mut self, is_heard: impl Fn(&str) -> bool, now: MachineTime) {
        for rest in self.rows.values_mut() {
            if rest.silent.as_ref().is_some_and(|(device, from)| now >= *from && is_heard(device)) {
                (rest.until, rest.silent) = (rest.until.min(now), None);
            }
        }
    }

    /// Lets a row rest for so long; this does not mean that anything is wrong with it.
    pub fn hold(&mut self, row: &RowId, length: Duration, now: MachineTime) {
        let count = self.rows.get(row).map_or(0, |rest| rest.count);
        self.rows.insert(row.clone(), Rest { until: now.plus(length), count, silent: None });
    }

    /// Forgets the rows for which `is_known` is false.
    pub fn keep(&mut self, is_known: impl Fn(&RowId) -> bool) {
        self.rows.retain(|row, _| is_known(row));
    }

    /// Does a row rest now?
    pub fn rests(&self, row: &RowId, now: MachineTime) -> bool {
        self.rows.get(row).is_some_and(|rest| now < rest.until)
    }
}

/// The length of a rest after `count` others.
fn grown(first: Duration, count: u32) -> Duration {
    first.saturating_mul(1_u32.checked_shl(count).unwrap_or(MOST).min(MOST))
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

    #[test]
    fn a_rest_for_a_silent_device_ends_when_it_answers_after_a_pause_that_grows() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let (mut rests, row, mount) = (Rests::default(), RowId("a".to_owned()), "s/t/telescope/mount");
        let (first, pause) = (Duration::from_secs(30), Duration::from_secs(5));
        rests.begin(&row, first, at(0));
        rests.end_when_heard(&row, mount.to_owned(), pause, at(0));
        rests.heard(|device| device != mount, at(6));
        assert!(rests.rests(&row, at(6)), "another device answers");
        rests.heard(|device| device == mount, at(4));
        assert!(rests.rests(&row, at(4)), "a pause is made in any case");
        rests.heard(|device| device == mount, at(5));
        assert!(!rests.rests(&row, at(5)));
        // The second time the pause is twice as long, and without an answer the rest is as long as any.
        rests.begin(&row, first, at(100));
        rests.end_when_heard(&row, mount.to_owned(), pause, at(100));
        rests.heard(|_| true, at(109));
        assert!(rests.rests(&row, at(109)));
        rests.heard(|_| false, at(110));
        assert!(rests.rests(&row, at(159)) && !rests.rests(&row, at(160)));
        // One for another reason does not end with it.
        rests.begin(&row, first, at(200));
        rests.heard(|_| true, at(210));
        assert!(rests.rests(&row, at(210)));
    }
}
