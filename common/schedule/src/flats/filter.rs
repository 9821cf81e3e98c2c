//! The filters of a row of flats: for each the wanted frames, the frames that count, and its light as far as it is
//! known.

use units::Utc;

use super::exposure::Light;
use super::order::Candidate;

/// Why a row ends before its frames are taken, where nothing else is wrong.
pub const WINDOW_ENDED: &str = "the row's window ended";
/// Looks at one filter at a moment, at most.
pub const LOOKS: u32 = 3;
/// A brightness that was measured so long ago is a guess, sky s.
const FRESH_S: f64 = 90.0;
/// Largest value of a camera that does not report its own, ADU.
pub const MAX_ADU: f64 = 65_535.0;
/// An exposure that a panel's brightness is chosen for, s, within the camera's limits: long enough that no shutter
/// shows.
pub const GOOD_S: f64 = 5.0;
/// The Sun's motion is predicted over so long, s.
pub const AHEAD_S: f64 = 300.0;

/// One filter of a row.
#[derive(Debug, Clone)]
pub struct Filter {
    /// Its name; where absent, whatever is in the beam.
    pub name: Option<String>,
    /// Frames wanted.
    pub wanted: u32,
    /// Frames that count.
    pub taken: u32,
    /// Frames since the last that counted.
    pub refused: u32,
    /// Why no more of it are taken.
    pub given_up: Option<&'static str>,
}

impl Filter {
    /// Of so many frames.
    pub fn new(name: Option<String>, wanted: u32) -> Self {
        Self { name, wanted, taken: 0, refused: 0, given_up: None }
    }

    /// Are more of it wanted, and to be had?
    pub fn is_wanted(&self) -> bool {
        self.taken < self.wanted && self.given_up.is_none()
    }

    /// Its name for people.
    pub fn words(&self) -> String {
        self.name.clone().unwrap_or_else(|| "the filter in the beam".to_owned())
    }
}

/// The result of a row, and why it ended: empty where all frames were taken.
pub fn summary(filters: &[Filter], why: Option<&str>) -> String {
    if filters.iter().all(|filter| filter.taken >= filter.wanted) {
        return String::new();
    }
    let each = filters.iter().map(|filter| {
        let why = filter.given_up.map(|why| format!(" ({why})")).unwrap_or_default();
        format!("{} {} of {}{why}", filter.words(), filter.taken, filter.wanted)
    });
    let each = each.collect::<Vec<_>>().join(", ");
    why.map_or(each.clone(), |why| format!("{each}; {why}"))
}

/// The state of one filter now.
pub fn candidate(is_wanted: bool, light: &Light, index: usize, now: Utc) -> Candidate {
    Candidate {
        is_wanted,
        ready: light.ready(index, now),
        is_fresh: light.age_s(index, now).is_some_and(|age_s| age_s <= FRESH_S),
        wait_s: light.wait_s(index, now),
    }
}

/// An exposure as cameras take it, s.
pub fn to_ms(exposure_s: f64) -> f64 {
    (1000.0 * exposure_s).round() / 1000.0
}
