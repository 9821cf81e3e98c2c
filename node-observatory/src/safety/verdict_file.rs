//! The verdicts that ended, one in each line of a file: kept over restarts, and for people to read.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use contract::observatory::Interval;
use safety::intervals::Intervals;

/// Lines of the file that are read back, and beyond which it is written anew at the next start.
const MOST_STORED: usize = 1000;

/// Reads those that ended in earlier incarnations. It skips lines that cannot be read: the file is for people.
pub fn read(path: &Path) -> Intervals {
    // Half a line of a crash may end within a character.
    let text = String::from_utf8_lossy(&std::fs::read(path).unwrap_or_default()).into_owned();
    let lines: Vec<&str> = text.lines().collect();
    let stored = lines.get(lines.len().saturating_sub(MOST_STORED)..).unwrap_or_default();
    if stored.len() < lines.len()
        && let Err(error) = std::fs::write(path, format!("{}\n", stored.join("\n")))
    {
        tracing::warn!(file = %path.display(), %error, "the old verdicts could not be cut down");
    }
    Intervals::of_lines(stored)
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
    use contract::observatory::Verdict;
    use units::Utc;

    use super::*;

    #[test]
    fn verdicts_that_ended_outlive_a_restart_and_a_crash_within_a_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("verdicts.jsonl");
        assert_eq!(read(&path).published(), []);
        let ended = Interval {
            verdict: Verdict::Unsafe,
            from_utc: Utc::from_seconds(0.0),
            until_utc: Some(Utc::from_seconds(900.0)),
            reasons: vec!["wx/Humidity: 91 is above 80".to_owned()],
        };
        append(&path, &ended).unwrap();
        std::fs::OpenOptions::new().append(true).open(&path).unwrap().write_all(b"{half a li").unwrap();
        assert_eq!(read(&path).published(), [ended]);
    }
}
