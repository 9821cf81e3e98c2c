//! Plate solving: which piece of the sky a list of stars shows.
//!
//! What is known shortens the search, and each level knows less than the one before:
//!
//! | level | known | method |
//! |---|---|---|
//! | 0 | rotation, scale, parity ([`LearnedOptics`]) | one shift (`differences`) |
//! | 1 | scale to some percent, place to one field | pairs of stars (`votes`) |
//! | | place to one field | the same at other scales, where asked for ([`Hint::wrong_scales`]) |
//! | 2 | scale, place to `furthest` | the same on tiles around the hint |
//! | 3 | nothing, or place to more than 60 deg ([`AllSky`]) | shapes of four stars (`pattern`) |
//!
//! A solution is believed by the probability that so many stars agree by chance, times the number of hypotheses that
//! were tried, never by a count of stars. It is then refined on all stars, with distortion where many prove it.

mod all_sky;
mod candidate;
mod chance;
mod differences;
mod failure;
mod field;
mod hint;
mod mask;
mod model;
mod pattern;
mod pattern_table;
mod refine;
mod scales;
mod search;
mod seen;
mod similarity;
mod solution;
mod source;
mod tile;
mod trail;
mod votes;

pub use all_sky::{AllSky, Blind, Within};
pub use failure::NoSolution;
pub use hint::{FIRST_LIGHT, Hint, KNOWN_OPTICS, LearnedOptics};
pub use solution::{Level, Match, Solution};
pub use source::{Stars, at_epoch};

use units::Angle;

use crate::quality::Quality;
use crate::star::Star;

/// The stars of a frame, as they were detected.
#[derive(Debug, Clone, Copy)]
pub struct Detected<'a> {
    /// All stars, in any order, flagged ones included.
    pub stars: &'a [Star],
    /// Columns of the frame.
    pub width: usize,
    /// Rows of the frame.
    pub height: usize,
    /// The frame as a whole; without it trailed and saturated frames are recognised by their stars alone.
    pub quality: Option<&'a Quality>,
}

/// Finds which piece of the sky the stars show.
///
/// # Errors
/// [`NoSolution`] with the most probable reason; [`NoSolution::Hint`] when the hint's numbers make no sense.
pub fn solve(detected: &Detected, hint: &Hint, source: &impl Stars) -> Result<Solution, NoSolution> {
    searched(detected, hint, &Any(source))
}

/// Any source as one type: the search is compiled here, with this crate's optimisation, and once.
struct Any<'a>(&'a dyn Stars);

impl Stars for Any<'_> {
    fn cone(&self, ra: Angle, dec: Angle, radius: Angle, faintest_mag: f64) -> Vec<crate::catalogue::CatalogueStar> {
        self.0.cone(ra, dec, radius, faintest_mag)
    }
}

fn searched(detected: &Detected, hint: &Hint, source: &Any<'_>) -> Result<Solution, NoSolution> {
    failure::check(detected, hint)?;
    failure::check_trails(detected)?;
    let mut search = search::SolveSearch::new(detected, hint, source);
    match search.run() {
        Some(solution) => Ok(solution),
        None => Err(failure::classify(detected, hint, source, search.attempt())),
    }
}
