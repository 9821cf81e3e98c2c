//! The verdicts of the last day, each with when it began, when it ended, and why.

use std::collections::VecDeque;

use contract::observatory::{Interval, Unsafe, Verdict};
use units::Utc;

/// So many are published.
const SHOWN: usize = 20;

/// The intervals, the newest last.
#[derive(Debug, Default)]
pub struct Intervals {
    listed: VecDeque<Interval>,
    /// Begun and not ended, so not on disk.
    now: Option<Interval>,
}

impl Intervals {
    /// Those that ended in earlier incarnations, one in each line. It skips lines that cannot be read: the file is for
    /// people.
    pub fn of_lines(lines: &[&str]) -> Self {
        let listed = lines.iter().filter_map(|line| serde_json::from_str(line).ok()).collect::<Vec<Interval>>();
        let listed = listed.into_iter().rev().take(SHOWN).rev().collect();
        Self { listed, now: None }
    }

    /// Takes in a verdict; returns the interval that it ended, to be kept.
    pub fn judge(&mut self, verdict: Verdict, reasons: &[Unsafe], now: Utc) -> Option<Interval> {
        let words = |reason: &Unsafe| format!("{}: {}", reason.input, reason.why);
        match &mut self.now {
            Some(current) if current.verdict == verdict => {
                // Reasons that join later are listed too, by input: values change every second.
                for reason in reasons {
                    let begins = format!("{}: ", reason.input);
                    if !current.reasons.iter().any(|known| known.starts_with(&begins)) {
                        current.reasons.push(words(reason));
                    }
                }
                None
            }
            current => {
                let begun =
                    Interval { verdict, from_utc: now, until_utc: None, reasons: reasons.iter().map(words).collect() };
                let ended = current.replace(begun).map(|ended| Interval { until_utc: Some(now), ..ended })?;
                self.listed.push_back(ended.clone());
                if self.listed.len() > SHOWN {
                    self.listed.pop_front();
                }
                Some(ended)
            }
        }
    }

    /// The newest ones, with the one that lasts.
    pub fn published(&self) -> Vec<Interval> {
        self.listed.iter().chain(&self.now).cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reason(input: &str, why: &str) -> Unsafe {
        Unsafe { input: input.to_owned(), why: why.to_owned(), clears_in_s: None }
    }

    #[test]
    fn intervals_are_reported_with_all_their_reasons_and_outlive_a_restart() {
        let mut intervals = Intervals::default();
        let at = Utc::from_seconds;
        assert_eq!(intervals.judge(Verdict::Unsafe, &[reason("wx/Humidity", "91 is above 80")], at(0.0)), None);
        let later = [reason("wx/Humidity", "92 is above 80"), reason("wx/RainRate", "2 is above 0")];
        assert_eq!(intervals.judge(Verdict::Unsafe, &later, at(10.0)), None);
        let ended = intervals.judge(Verdict::Safe, &[], at(900.0)).unwrap();
        assert_eq!(ended.reasons, ["wx/Humidity: 91 is above 80", "wx/RainRate: 2 is above 0"]);
        assert_eq!((ended.from_utc, ended.until_utc), (at(0.0), Some(at(900.0))));
        let line = serde_json::to_string(&ended).unwrap();
        assert_eq!(Intervals::of_lines(&[&line, "{half a li"]).published(), std::slice::from_ref(&ended));
        assert_eq!(intervals.published().len(), 2);
        assert_eq!(intervals.published()[1].until_utc, None);
    }
}
