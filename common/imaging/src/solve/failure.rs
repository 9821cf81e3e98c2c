//! Why a frame could not be solved, in classes that call for different remedies.

use units::Angle;

use super::hint::Hint;
use super::source::Stars;
use super::{Detected, field, scales, trail};

/// Fewest stars that can be solved at all: with rotation and scale known.
pub(super) const FEWEST_KNOWN: usize = 3;
/// Fewest stars that can be solved without.
pub(super) const FEWEST: usize = 4;
/// Stars that a catalogue should have in a field that is to be solved with it.
const SHALLOW: f64 = 6.0;
/// Fewer detected stars than this share of the expected ones are clouds: chosen, not measured.
const CLOUDY: f64 = 0.3;
/// More than this share of pixels or of stars saturated.
const SATURATED: f64 = 0.25;

/// Why there is no solution, and with what figures.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoSolution {
    /// The hint makes no sense.
    #[error("hint cannot be used: {what} is {value}; expected {expected}")]
    Hint {
        /// Which number.
        what: &'static str,
        /// What it is.
        value: f64,
        /// What it should be.
        expected: &'static str,
    },
    /// Not enough stars: expose longer (twice as long, at most three times).
    #[error("too few stars: {stars} in the frame, {needed} are needed; expose longer")]
    TooFewStars {
        /// Usable stars in the frame.
        stars: usize,
        /// How many it takes.
        needed: usize,
    },
    /// Far fewer stars than the catalogue has for such a frame: wait.
    #[error("clouds: {stars} stars in the frame where the catalogue has {expected} to magnitude {limit_mag:.1}")]
    Clouds {
        /// Usable stars in the frame.
        stars: usize,
        /// Stars that a clear sky shows.
        expected: usize,
        /// Magnitude to which they are counted.
        limit_mag: f64,
    },
    /// The stars are drawn out in one direction: check tracking and wind.
    #[error(
        "trailed: the {stars} stars are drawn out in one direction{}; check tracking and wind, or expose for a shorter time",
        length_text(*length_px)
    )]
    Trailed {
        /// Usable stars in the frame.
        stars: usize,
        /// Length of the trails, as far as their pieces show it, px.
        length_px: f64,
    },
    /// Too much of the frame is saturated: expose for a shorter time.
    #[error("saturated: {stars} of the stars and {pixels_percent:.1} % of the pixels; shorten the exposure")]
    Saturated {
        /// Saturated stars.
        stars: usize,
        /// Saturated pixels, percent.
        pixels_percent: f64,
    },
    /// The catalogue has too few stars there for so small a field: take a deeper one.
    #[error("catalogue too shallow: {stars} stars in this field of {:.3} deg; take a deeper catalogue", field.degrees())]
    CatalogueTooShallow {
        /// Catalogue stars that such a frame holds there on average.
        stars: usize,
        /// Longer side of the frame.
        field: Angle,
    },
    /// Two places fit equally well.
    #[error(
        "ambiguous: places {:.3} deg apart fit with {matched} stars each; expose longer or point elsewhere", apart.degrees()
    )]
    Ambiguous {
        /// How far the two places are apart.
        apart: Angle,
        /// Stars that agree with the worse one.
        matched: usize,
    },
    /// Nothing fits: wrong place, wrong scale, or no stars of the catalogue.
    #[error(
        "no match: {stars} stars against {catalogue_stars} of the catalogue, {hypotheses} hypotheses up to \
         {:.2} deg from the hint at {scale_arcsec_px:.3} arcsec/px{}", searched.degrees(), scales::text_of(others_arcsec_px)
    )]
    NoMatch {
        /// Stars of the frame that took part.
        stars: usize,
        /// Catalogue stars that such a frame holds on average.
        catalogue_stars: usize,
        /// Hypotheses that were tested.
        hypotheses: u64,
        /// How far from the hint the frame's centre was looked for.
        searched: Angle,
        /// The scale that was assumed.
        scale_arcsec_px: f64,
        /// The other scales that were tried in the hinted field, ascending ([`Hint::wrong_scales`]).
        others_arcsec_px: Vec<f64>,
    },
    /// Nothing on the whole sky fits.
    #[error(
        "no match on the whole sky: {stars} stars, {candidates} likenesses among {patterns} patterns of four bright \
         stars{}; a blind search needs a field of about 1 deg and more", scales::range_text(*scales_arcsec_px)
    )]
    Blind {
        /// Stars of the frame that took part.
        stars: usize,
        /// Patterns of the sky that were looked through.
        patterns: usize,
        /// Patterns that looked like one of the frame and were laid over its other stars.
        candidates: u64,
        /// The scales that were allowed.
        scales_arcsec_px: Option<(f64, f64)>,
    },
}

/// Refuses numbers with which a search makes no sense.
pub(super) fn check(detected: &Detected, hint: &Hint) -> Result<(), NoSolution> {
    let side = detected.width.max(detected.height) as f64;
    let field_deg = side * hint.scale_arcsec_px / 3600.0;
    let rules = [
        ("ra, deg", hint.ra.degrees(), hint.ra.is_finite(), "a number"),
        ("dec, deg", hint.dec.degrees(), hint.dec.degrees().abs() <= 90.0, "-90 to 90"),
        ("scale, arcsec/px", hint.scale_arcsec_px, hint.scale_arcsec_px > 0.0, "greater than 0"),
        ("scale tolerance", hint.scale_tolerance, (0.0..=0.2).contains(&hint.scale_tolerance), "0 to 0.2"),
        ("frame, px", side, detected.width.min(detected.height) >= 16, "at least 16 in both directions"),
        (
            "longer side of the frame, deg",
            field_deg,
            field_deg <= 60.0,
            "60 at most; wider lenses are not solved, or the scale is wrong",
        ),
        (
            "distance from the hint up to which the frame is looked for, deg",
            hint.furthest.degrees(),
            (0.0..=60.0).contains(&hint.furthest.degrees()),
            "0 to 60; AllSky::solve with Blind::within looks further",
        ),
    ];
    let learned = hint.learned.map(|learned| {
        let ratio = learned.scale_arcsec_px / hint.scale_arcsec_px;
        let fits = learned.rotation_deg.is_finite() && (0.5..2.0).contains(&ratio);
        ("learned scale over hinted scale", ratio, fits, "0.5 to 2, and a rotation that is a number")
    });
    let broken = rules.into_iter().chain(learned).find(|(_, _, holds, _)| !holds);
    broken.map_or(Ok(()), |(what, value, _, expected)| Err(NoSolution::Hint { what, value, expected }))
}

/// Refuses trails that are too long for any place: stars would agree, all off by the same part of a trail.
pub(super) fn check_trails(detected: &Detected) -> Result<(), NoSolution> {
    match trail::of(detected) {
        Some(trail) if trail.is_too_long => {
            Err(NoSolution::Trailed { stars: field::usable(detected).len(), length_px: trail.length_px })
        }
        _ => Ok(()),
    }
}

/// The length of trails, where there is one.
fn length_text(length_px: f64) -> String {
    if length_px >= 1.0 { format!(" by about {length_px:.0} px or more") } else { String::new() }
}

/// What the search did before it failed.
pub(super) struct FailedSearch {
    pub(super) stars: usize,
    pub(super) hypotheses: u64,
    pub(super) searched: Angle,
    pub(super) others_arcsec_px: Vec<f64>,
    pub(super) ambiguous: Option<NoSolution>,
}

/// The class of a failure: what most probably stood in the way, the plainest first.
pub(super) fn classify(detected: &Detected, hint: &Hint, source: &impl Stars, attempt: FailedSearch) -> NoSolution {
    if let Some(ambiguous) = attempt.ambiguous {
        return ambiguous;
    }
    let usable = field::usable(detected);
    let stars = usable.len();
    let saturated = usable.iter().filter(|star| star.flags.saturated).count();
    let pixels = detected.quality.map_or(0.0, |quality| quality.saturated_fraction);
    if pixels > SATURATED || (saturated >= FEWEST && saturated as f64 > 2.0 * SATURATED * stars as f64) {
        return NoSolution::Saturated { stars: saturated, pixels_percent: 100.0 * pixels };
    }
    if let Some(trail) = trail::of(detected) {
        return NoSolution::Trailed { stars, length_px: trail.length_px };
    }
    let sky = CatalogueMagnitudes::around(detected, hint, source);
    if let Some(limit_mag) = hint.faintest_mag {
        let expected = sky.in_frame(limit_mag);
        if expected >= SHALLOW && (stars as f64) < CLOUDY * expected {
            return NoSolution::Clouds { stars, expected: expected.round() as usize, limit_mag };
        }
    }
    let needed = if hint.learned.is_some() { FEWEST_KNOWN } else { FEWEST };
    if stars < needed {
        return NoSolution::TooFewStars { stars, needed };
    }
    let catalogue = sky.in_frame(f64::INFINITY);
    if catalogue < SHALLOW {
        return NoSolution::CatalogueTooShallow { stars: catalogue.round() as usize, field: sky.longer_side };
    }
    NoSolution::NoMatch {
        stars: attempt.stars,
        catalogue_stars: catalogue.round() as usize,
        hypotheses: attempt.hypotheses,
        searched: attempt.searched,
        scale_arcsec_px: hint.scale_arcsec_px,
        others_arcsec_px: attempt.others_arcsec_px,
    }
}

/// The catalogue's magnitudes around the hint.
struct CatalogueMagnitudes {
    mags: Vec<f64>,
    /// Area of the frame over that of the cone.
    share: f64,
    longer_side: Angle,
}

impl CatalogueMagnitudes {
    /// Enough of the catalogue to be counted, not all of it.
    const COUNTED: usize = 3000;

    fn around(detected: &Detected, hint: &Hint, source: &impl Stars) -> Self {
        let side = |px: usize| Angle::from_arcseconds(px as f64 * hint.scale_arcsec_px);
        let (width, height) = (side(detected.width), side(detected.height));
        // a circle of twice the frame's area: stars of its neighbourhood show more than chance within
        let square_deg = width.degrees() * height.degrees();
        let radius = Angle::from_degrees((2.0 * square_deg / std::f64::consts::PI).sqrt().min(90.0));
        let found = super::source::brightest(source, hint.ra, hint.dec, radius, Self::COUNTED);
        let longer_side = if width > height { width } else { height };
        Self { mags: found.iter().map(|star| star.mag).collect(), share: 0.5, longer_side }
    }

    /// Stars not fainter than a magnitude in an area as large as the frame.
    fn in_frame(&self, limit_mag: f64) -> f64 {
        self.mags.iter().filter(|mag| **mag <= limit_mag).count() as f64 * self.share
    }
}
