//! What of a parameter a limit is put on: its value, its largest over a window, or its change per minute.

use std::collections::VecDeque;
use std::time::Duration;

use bus::SkyTime;

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Measure {
    /// The newest value.
    Value,
    /// The largest value of the last so long, sky time.
    Max(Duration),
    /// The change per minute over so long, sky time.
    Rate(Duration),
}

/// The values that a measure needs, oldest first; one more than the window, which shows how it began.
#[derive(Debug, Clone, Default)]
pub struct Window {
    values: VecDeque<(SkyTime, f64)>,
    /// What was before this is not known.
    recalled_since: Option<SkyTime>,
}

impl Measure {
    /// The window that it is taken over, sky time.
    pub fn over(self) -> Duration {
        match self {
            Self::Value => Duration::ZERO,
            Self::Max(over) | Self::Rate(over) => over,
        }
    }
}

impl Window {
    /// One whose values begin in the middle of a longer past: the largest of a window is not known before it is full.
    pub fn recalled(since: SkyTime) -> Self {
        Self { values: VecDeque::new(), recalled_since: Some(since) }
    }

    /// The measure with one more value, or why it has none yet.
    pub fn measure(&mut self, measure: Measure, at: SkyTime, value: f64) -> Result<f64, String> {
        let over = match measure {
            Measure::Value => return Ok(value),
            Measure::Max(over) | Measure::Rate(over) => over,
        };
        self.values.push_back((at, value));
        while self.values.get(1).is_some_and(|(second, _)| at.since(*second) >= over) {
            self.values.pop_front();
        }
        let within = self.values.iter().filter(|(then, _)| at.since(*then) <= over);
        match (measure, self.values.front()) {
            (Measure::Rate(_), Some((then, first))) => {
                let passed = at.since(*then);
                if passed < over {
                    return Err(format!("heard for {:.1} of {:.1} min", minutes(passed), minutes(over)));
                }
                Ok((value - first) / minutes(passed))
            }
            _ => Ok(within.map(|(_, value)| *value).fold(value, f64::max)),
        }
    }

    /// Is the measure known, or may it have been more before the record began?
    pub fn is_whole(&self, measure: Measure, at: SkyTime) -> bool {
        let is_short = |since: SkyTime| at.since(since) < measure.over();
        // a rate has no value before its window is full
        !matches!(measure, Measure::Max(_)) || !self.recalled_since.is_some_and(is_short)
    }

    /// A missing value: what was measured across it would be a guess.
    pub fn clear(&mut self) {
        self.values.clear();
        self.recalled_since = None;
    }
}

fn minutes(duration: Duration) -> f64 {
    duration.as_secs_f64() / 60.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(second: u64) -> SkyTime {
        SkyTime::from_start(Duration::from_secs(second))
    }

    #[test]
    fn a_gust_counts_for_the_whole_window() {
        let (mut window, measure) = (Window::default(), Measure::Max(Duration::from_secs(60)));
        let told: Vec<f64> = [(0, 5.0), (10, 18.0), (20, 6.0), (70, 7.0), (71, 7.0)]
            .into_iter()
            .map(|(second, value)| window.measure(measure, at(second), value).unwrap())
            .collect();
        assert_eq!(told, [5.0, 18.0, 18.0, 18.0, 7.0]);
    }

    #[test]
    fn a_recalled_maximum_needs_its_whole_window_until_a_hole_begins_it_anew() {
        let (mut window, measure) = (Window::recalled(at(100)), Measure::Max(Duration::from_secs(60)));
        assert_eq!(window.measure(measure, at(100), 5.0), Ok(5.0));
        assert!(!window.is_whole(measure, at(100)) && !window.is_whole(measure, at(159)));
        assert!(window.is_whole(measure, at(160)) && window.is_whole(Measure::Value, at(100)));
        window.clear();
        assert!(window.is_whole(measure, at(110)), "as it was when it was heard");
    }

    #[test]
    fn a_rate_needs_its_whole_window_without_a_hole() {
        let (mut window, measure) = (Window::default(), Measure::Rate(Duration::from_secs(120)));
        assert_eq!(window.measure(measure, at(0), 10.0).unwrap_err(), "heard for 0.0 of 2.0 min");
        assert!(window.measure(measure, at(60), 11.0).is_err());
        assert_eq!(window.measure(measure, at(120), 14.0), Ok(2.0));
        assert_eq!(window.measure(measure, at(180), 11.0), Ok(0.0));
        window.clear();
        assert!(window.measure(measure, at(240), 30.0).is_err());
    }
}
