//! Notices that this process itself stood still: it was stopped, its threads were blocked, or its machine slept.

use std::time::Duration;

use bus::MachineTime;

/// The looks of a loop that turns at least every so often. After a standstill it has heard and asked nobody meanwhile, so that
/// the silence of that time says nothing about others. Pure: time comes in.
#[derive(Debug, Clone, Copy)]
pub struct Looks {
    last: MachineTime,
    longest: Duration,
}

impl Looks {
    /// The first look; more than `longest` from one look to the next is a standstill.
    pub fn begin(now: MachineTime, longest: Duration) -> Self {
        Self { last: now, longest }
    }

    /// The next look. Since when this process stood still, if it did: the time of the look before.
    pub fn stood_still_since(&mut self, now: MachineTime) -> Option<MachineTime> {
        let last = std::mem::replace(&mut self.last, now);
        (now.since(last) > self.longest).then_some(last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_look_that_comes_late_is_no_standstill_and_one_that_comes_too_late_is_one_once() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let mut looks = Looks::begin(at(100), Duration::from_secs(4));
        let found = [101, 105, 110, 111].map(|s| looks.stood_still_since(at(s)));
        assert_eq!(found, [None, None, Some(at(105)), None]);
    }
}
