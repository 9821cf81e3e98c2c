//! `starmesh schedule compress`: a long night as a short one, to try a schedule.

use std::path::PathBuf;

use anyhow::{Context as _, ensure};
use clap::Args;
use schedule::times;
use serde_json::Value;
use units::Utc;

use crate::console::line;
use crate::import::schedule::{Piece, pieces};

/// Options of `starmesh schedule compress`.
#[derive(Debug, Args)]
pub struct Options {
    /// The schedule.
    file: PathBuf,
    /// Gaps between starts, and windows, become so many times shorter.
    factor: f64,
    /// When its first row begins, UTC; now where absent.
    #[arg(long)]
    start: Option<Utc>,
    /// The new file, which must not be there yet.
    #[arg(long)]
    out: PathBuf,
}

/// Writes the shorter schedule.
pub fn run(options: &Options) -> anyhow::Result<()> {
    let Options { file, factor, start, out } = options;
    ensure!((0.001..=1e6).contains(factor), "factor {factor}: expected 0.001 to 1000000");
    ensure!(!out.exists(), "{} is there already and stays as it is; choose another name", out.display());
    let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    let start = start.unwrap_or_else(|| bus::Clock::machine_clock().utc());
    let short =
        compressed(text.trim_start_matches('\u{feff}'), *factor, start).with_context(|| file.display().to_string())?;
    std::fs::write(out, short).with_context(|| format!("cannot write {}", out.display()))?;
    line(format_args!("wrote {}: the first row begins {}", out.display(), start.to_second()))
}

fn compressed(text: &str, factor: f64, start: Utc) -> anyhow::Result<String> {
    let (pieces, rest) = pieces(text)?;
    let window = |piece: &Piece| -> anyhow::Result<(Value, Utc, Utc)> {
        let about = || format!("line {}: expected a row with start_time and end_time", piece.line);
        let value = piece.value().with_context(about)?;
        let time = |key: &str| Some(times::read(value.get(key)?.as_str()?)?.utc);
        let (from, to) = time("start_time").zip(time("end_time")).with_context(about)?;
        Ok((value, from, to))
    };
    let rows = pieces.iter().map(window).collect::<anyhow::Result<Vec<_>>>()?;
    let first = rows.iter().map(|(_, from, _)| *from).min().context("it has no rows")?;
    let mut short = String::new();
    for (piece, (mut value, from, to)) in pieces.iter().zip(rows) {
        let moved = |at: Utc| start.plus_seconds(at.seconds_since(first) / factor);
        let new = moved(from);
        value["start_time"] = new.to_string().into();
        value["end_time"] = new.plus_seconds(to.seconds_since(from) / factor).to_string().into();
        short += &format!("{}{value}", piece.before);
    }
    short += &rest;
    Ok(short)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_and_windows_become_shorter_and_comments_stay() {
        let row = |from: &str, to: &str| {
            format!(
                "{{\"device_name\": \"c\", \"action_type\": \"close\", \"start_time\": \"{from}\", \"end_time\": \"{to}\"}}\n"
            )
        };
        let text = format!(
            "// a\n{}// b\n{}// c\n",
            row("2026-01-01 00:00", "2026-01-01 02:00"),
            row("2026-01-01 01:00 UTC", "2026-01-01 05:00")
        );
        let short = compressed(&text, 60.0, "2026-06-01T00:00:00Z".parse().unwrap()).unwrap();
        let lines: Vec<&str> = short.lines().collect();
        assert_eq!((lines[0], lines[2], lines[4]), ("// a", "// b", "// c"), "{short}");
        assert!(lines[1].contains("2026-06-01T00:00:00.000000Z") && lines[1].contains("00:02:00.000000Z"), "{short}");
        assert!(lines[3].contains("2026-06-01T00:01:00.000000Z") && lines[3].contains("00:05:00.000000Z"), "{short}");
        assert!(compressed("{\"a\": 1}", 2.0, Utc::EPOCH).unwrap_err().to_string().contains("line 1"));
    }
}
