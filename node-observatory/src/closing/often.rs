//! A dome that must be closed again and again raises an alert; pure.

use std::collections::VecDeque;
use std::time::Duration;

use bus::MachineTime;

/// So many closings ...
const MANY: usize = 3;
/// ... within this time are too many.
const WITHIN: Duration = Duration::from_secs(600);

/// The closings of late, which the sky called for.
#[derive(Debug, Default)]
pub struct Often {
    began: VecDeque<(MachineTime, String)>,
}

impl Often {
    /// A closing of something open began.
    pub fn note(&mut self, now: MachineTime, why: &str) {
        self.began.push_back((now, why.to_owned()));
        if self.began.len() > MANY {
            self.began.pop_front();
        }
    }

    /// The cause of the alert while there are too many.
    pub fn report(&self, now: MachineTime) -> Option<String> {
        let (first, _) = self.began.front().filter(|_| self.began.len() >= MANY)?;
        let minutes = now.since(*first).as_secs_f64() / 60.0;
        let causes: Vec<&str> = self.began.iter().map(|(_, why)| why.as_str()).collect();
        (now.since(*first) <= WITHIN)
            .then(|| format!("closed {MANY} times within {:.0} min: {}", minutes.ceil(), causes.join("; then ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_closings_within_ten_minutes_are_reported_with_their_causes_until_the_first_is_old() {
        let at = |seconds| MachineTime::from_boot(Duration::from_secs(seconds));
        let mut often = Often::default();
        for (second, why) in [(0, "rain"), (500, "monitor")] {
            often.note(at(second), why);
            assert_eq!(often.report(at(second)), None);
        }
        often.note(at(700), "monitor");
        assert_eq!(often.report(at(700)), None, "the first is more than ten minutes ago");
        often.note(at(800), "wind");
        assert_eq!(often.report(at(800)).unwrap(), "closed 3 times within 5 min: monitor; then monitor; then wind");
        assert!(often.report(at(1099)).is_some() && often.report(at(1101)).is_none());
    }
}
