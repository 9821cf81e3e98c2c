//! One exposure, and whether it fits into the window of its row.

use units::Utc;

/// One frame to take.
#[derive(Debug, Clone, PartialEq)]
pub struct Shot {
    /// Seconds.
    pub exposure_s: f64,
    /// IMAGETYP.
    pub image_type: &'static str,
    /// The activity, in words: `exposing 3 of 10, 30 s, V`.
    pub words: String,
}

/// May an exposure start now? Only if it ends within the row's window.
pub fn fits(now: Utc, exposure_s: f64, end: Utc) -> bool {
    now.plus_seconds(exposure_s) <= end
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exposure_starts_only_if_it_ends_within_the_window() {
        let at = |text: &str| -> Utc { text.parse().unwrap() };
        let end = at("2026-11-21T04:00:00Z");
        assert!(fits(at("2026-11-21T03:59:00Z"), 60.0, end));
        assert!(!fits(at("2026-11-21T03:59:00.001Z"), 60.0, end));
    }
}
