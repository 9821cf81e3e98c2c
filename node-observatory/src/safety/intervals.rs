//! The verdicts of the last day, each with when it began, when it ended, and why: kept on disk over restarts.

use std::collections::VecDeque;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use contract::observatory::{Interval, Unsafe, Verdict};
use units::Utc;

/// So many are shown.
const SHOWN: usize = 20;
/// Lines of the file that are read back, and beyond which it is written anew at the next start.
const KEPT: usize = 1000;

/// The intervals, the newest last.
#[derive(Debug, Default)]
pub struct Intervals {
    shown: VecDeque<Interval>,
    /// Begun and not ended, so not on disk.
    now: Option<Interval>,
}

impl Intervals {
    /// Those that ended in earlier lives; lines that cannot be read are passed over, the file is for people.
    pub fn read(path: &Path) -> Self {
        // half a line of a crash may end within a character
        let text = String::from_utf8_lossy(&std::fs::read(path).unwrap_or_default()).into_owned();
        let lines: Vec<&str> = text.lines().collect();
        let kept = lines.get(lines.len().saturating_sub(KEPT)..).unwrap_or_default();
        if kept.len() < lines.len()
            && let Err(error) = std::fs::write(path, format!("{}\n", kept.join("\n")))
        {
            tracing::warn!(file = %path.display(), %error, "the old verdicts could not be cut down");
        }
        let shown = kept.iter().filter_map(|line| serde_json::from_str(line).ok()).collect::<Vec<Interval>>();
        let shown = shown.into_iter().rev().take(SHOWN).rev().collect();
        Self { shown, now: None }
    }

    /// Takes in a verdict; returns the interval that it ended, to be kept.
    pub fn judge(&mut self, verdict: Verdict, reasons: &[Unsafe], now: Utc) -> Option<Interval> {
        let words = |reason: &Unsafe| format!("{}: {}", reason.input, reason.why);
        match &mut self.now {
            Some(current) if current.verdict == verdict => {
                // what joins later is told too, by input: values change every second
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
                self.shown.push_back(ended.clone());
                if self.shown.len() > SHOWN {
                    self.shown.pop_front();
                }
                Some(ended)
            }
        }
    }

    /// The newest ones, with the one that lasts.
    pub fn shown(&self) -> Vec<Interval> {
        self.shown.iter().chain(&self.now).cloned().collect()
    }
}

/// Keeps an interval that ended.
pub fn append(path: &Path, interval: &Interval) -> std::io::Result<()> {
    let mut file = std::fs::OpenOptions::new().create(true).append(true).open(path)?;
    file.write_all(format!("{}\n", serde_json::to_string(interval)?).as_bytes())
}

/// Where the verdicts of a telescope are kept.
pub fn path(config: &config::Observatory) -> PathBuf {
    config.folders.data.join(format!("verdicts-{}.jsonl", config.place.telescope))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reason(input: &str, why: &str) -> Unsafe {
        Unsafe { input: input.to_owned(), why: why.to_owned(), clears_in_s: None }
    }

    #[test]
    fn intervals_are_told_with_all_their_reasons_and_outlive_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("verdicts.jsonl");
        let mut intervals = Intervals::read(&path);
        let at = Utc::from_seconds;
        assert_eq!(intervals.judge(Verdict::Unsafe, &[reason("wx/Humidity", "91 is above 80")], at(0.0)), None);
        let later = [reason("wx/Humidity", "92 is above 80"), reason("wx/RainRate", "2 is above 0")];
        assert_eq!(intervals.judge(Verdict::Unsafe, &later, at(10.0)), None);
        let ended = intervals.judge(Verdict::Safe, &[], at(900.0)).unwrap();
        assert_eq!(ended.reasons, ["wx/Humidity: 91 is above 80", "wx/RainRate: 2 is above 0"]);
        assert_eq!((ended.from_utc, ended.until_utc), (at(0.0), Some(at(900.0))));
        append(&path, &ended).unwrap();
        std::fs::OpenOptions::new().append(true).open(&path).unwrap().write_all(b"{half a li").unwrap();
        assert_eq!(Intervals::read(&path).shown(), std::slice::from_ref(&ended));
        assert_eq!(intervals.shown().len(), 2);
        assert_eq!(intervals.shown()[1].until_utc, None);
    }
}
