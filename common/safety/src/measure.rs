//! What of a parameter a limit is put on: its value, its largest over a window, or its change per minute.

use std::collections::VecDeque;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use units::SkyTime;

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
    /// The values before this are not known; `None` before the first value.
    known_since: Option<SkyTime>,
}

/// What of a window survives a restart of this node: how old everything was when it was written, sky time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StoredWindow {
    values: Vec<(Duration, f64)>,
    known_since: Option<Duration>,
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
    /// One that knows nothing of the time before: the largest of a window is not known before it is full.
    pub fn since(since: SkyTime) -> Self {
        Self { values: VecDeque::new(), known_since: Some(since) }
    }

    /// What is to be written of it.
    pub fn store(&self, now: SkyTime) -> StoredWindow {
        let values = self.values.iter().map(|(at, value)| (now.since(*at), *value)).collect();
        StoredWindow { values, known_since: self.known_since.map(|since| now.since(since)) }
    }

    /// The window that was written `then`.
    pub fn of_stored(stored: &StoredWindow, then: SkyTime) -> Self {
        let values = stored.values.iter().map(|(ago, value)| (then.minus(*ago), *value)).collect();
        Self { values, known_since: stored.known_since.map(|ago| then.minus(ago)) }
    }

    /// The measure with one more value, or why it has none yet.
    pub fn measure(&mut self, measure: Measure, at: SkyTime, value: f64) -> Result<f64, String> {
        let over = match measure {
            Measure::Value => return Ok(value),
            Measure::Max(over) | Measure::Rate(over) => over,
        };
        self.known_since.get_or_insert(at);
        self.values.push_back((at, value));
        while self.values.get(1).is_some_and(|(second, _)| at.since(*second) >= over) {
            self.values.pop_front();
        }
        let within = self.values.iter().filter(|(then, _)| at.since(*then) <= over);
        match (measure, self.values.front()) {
            (Measure::Rate(_), Some((then, first))) => {
                let passed = at.since(*then);
                if passed < over {
                    return Err(format!(
                        "values for {:.1} of the {:.1} min that are needed",
                        minutes(passed),
                        minutes(over)
                    ));
                }
                Ok((value - first) / minutes(passed))
            }
            _ => Ok(within.map(|(_, value)| *value).fold(value, f64::max)),
        }
    }

    /// How long it takes until no value of the time before can be within the window, sky time; zero once it is so. A
    /// rate has no value before that.
    pub fn unknown_for(&self, measure: Measure, at: SkyTime) -> Duration {
        match measure {
            Measure::Value | Measure::Rate(_) => Duration::ZERO,
            Measure::Max(over) => self.known_since.map_or(over, |since| over.saturating_sub(at.since(since))),
        }
    }

    /// A value is missing. A rate across it would be a guess, so its window begins anew; the largest value that is
    /// known stays, but where `each` value is needed it is not known to be the largest until the window has filled
    /// again.
    pub fn miss(&mut self, measure: Measure, each: bool) {
        if !matches!(measure, Measure::Max(_)) {
            self.values.clear();
        }
        if each {
            self.known_since = None;
        }
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
        let values: Vec<f64> = [(0, 5.0), (10, 18.0), (20, 6.0), (70, 7.0), (71, 7.0)]
            .into_iter()
            .map(|(second, value)| window.measure(measure, at(second), value).unwrap())
            .collect();
        assert_eq!(values, [5.0, 18.0, 18.0, 18.0, 7.0]);
    }

    #[test]
    fn a_maximum_is_known_once_its_window_has_filled_since_the_listening_began() {
        let (mut window, measure) = (Window::since(at(100)), Measure::Max(Duration::from_secs(60)));
        assert_eq!(window.measure(measure, at(110), 5.0), Ok(5.0));
        let unknown_s = |window: &Window, second| window.unknown_for(measure, at(second)).as_secs();
        assert_eq!((unknown_s(&window, 110), unknown_s(&window, 159), unknown_s(&window, 160)), (50, 1, 0));
        assert_eq!(window.unknown_for(Measure::Value, at(100)), Duration::ZERO);
        // For an input that is not needed at each poll, a hole hides nothing more than its silence did.
        window.miss(measure, false);
        assert_eq!(unknown_s(&window, 160), 0);
        window.miss(measure, true);
        assert_eq!(window.measure(measure, at(170), 4.0), Ok(5.0), "what is known stays known");
        assert_eq!((unknown_s(&window, 170), unknown_s(&window, 230)), (60, 0));
    }

    #[test]
    fn a_rate_needs_its_whole_window_without_a_hole() {
        let (mut window, measure) = (Window::default(), Measure::Rate(Duration::from_secs(120)));
        assert_eq!(window.measure(measure, at(0), 10.0).unwrap_err(), "values for 0.0 of the 2.0 min that are needed");
        assert!(window.measure(measure, at(60), 11.0).is_err());
        assert_eq!(window.measure(measure, at(120), 14.0), Ok(2.0));
        assert_eq!(window.measure(measure, at(180), 11.0), Ok(0.0));
        window.miss(measure, true);
        assert!(window.measure(measure, at(240), 30.0).is_err());
    }
}
