//! Measures FITS files from the command line: each command reads the files given, prints text or JSON, and goes on to
//! the next file when one is bad.

mod blind;
pub mod exposure;
pub mod focus;
mod hint;
pub mod measure;
pub mod shift;
pub mod solve;
mod write_wcs;

use std::path::PathBuf;

use anyhow::bail;
use clap::Args;

use crate::console::{line, reader_has_gone};

/// How the answers look.
#[derive(Debug, Clone, Copy, Args)]
pub struct Output {
    /// One JSON object per line instead of text.
    #[arg(long)]
    pub json: bool,
}

impl Output {
    /// Prints an answer as JSON, or what `text` makes of it.
    pub fn print(self, json: &serde_json::Value, text: impl FnOnce() -> String) -> anyhow::Result<()> {
        if self.json { line(format_args!("{json}")) } else { line(format_args!("{}", text())) }
    }
}

/// Does `work` with each file. A bad file is reported on standard error, and the next one follows; then the whole
/// fails.
pub fn each(files: &[PathBuf], mut work: impl FnMut(&PathBuf) -> anyhow::Result<()>) -> anyhow::Result<()> {
    let mut bad = 0;
    for file in files {
        match work(file) {
            Ok(()) => {}
            Err(error) if reader_has_gone(&error) => return Err(error),
            Err(error) => {
                eprintln!("starmesh: {error:#}");
                bad += 1;
            }
        }
    }
    if bad > 0 {
        bail!("{bad} of {} files could not be used", files.len());
    }
    Ok(())
}

/// A number of an answer, rounded to so many places behind the point; what is not finite is left out.
pub fn rounded(value: f64, places: i32) -> Option<f64> {
    let unit = 10_f64.powi(places);
    let rounded = (value * unit).round() / unit;
    // No minus zero.
    (rounded.is_finite()).then_some(rounded + 0.0)
}

/// A number of an answer, rounded to so many digits: brightness in files may be counts or 1e-9 of a star's.
pub fn significant(value: f64, digits: i32) -> Option<f64> {
    if value == 0.0 {
        return Some(0.0);
    }
    rounded(value, digits - 1 - value.abs().log10().floor() as i32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_rounded_and_stay_numbers() {
        assert_eq!(rounded(-0.00001, 4).map(f64::to_bits), Some(0.0_f64.to_bits()), "no minus zero");
        assert_eq!(rounded(f64::NAN, 4), None);
        assert_eq!(significant(123_456.789, 6), Some(123_457.0));
        assert_eq!(significant(-0.007_123_456, 3), Some(-0.007_12));
        assert_eq!(significant(0.0, 3), Some(0.0));
        assert_eq!(significant(f64::INFINITY, 3), None);
    }
}
