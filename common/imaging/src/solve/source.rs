//! Where the solver takes its stars from.

use units::Angle;

use crate::catalogue::{Catalogue, CatalogueStar};

/// Anything that knows stars: a catalogue file, a table in memory, a simulator.
pub trait Stars {
    /// The stars within `radius` of an ICRS direction that are not fainter than `faintest_mag`, at the epoch of the
    /// frame, in any order.
    fn cone(&self, ra: Angle, dec: Angle, radius: Angle, faintest_mag: f64) -> Vec<CatalogueStar>;
}

impl<F: Fn(Angle, Angle, Angle, f64) -> Vec<CatalogueStar>> Stars for F {
    fn cone(&self, ra: Angle, dec: Angle, radius: Angle, faintest_mag: f64) -> Vec<CatalogueStar> {
        self(ra, dec, radius, faintest_mag)
    }
}

/// A catalogue as it stands at one epoch (Julian year, such as 2026.89): that of the frame.
pub fn at_epoch<B: AsRef<[u8]>>(catalogue: &Catalogue<B>, epoch_year: f64) -> impl Stars {
    move |ra, dec, radius, faintest_mag| catalogue.cone(ra, dec, radius, faintest_mag, epoch_year)
}

/// Limits tried one after the other, so that a wide cone of a deep catalogue is not read to its end.
const LIMITS_MAG: [f64; 8] = [7.0, 9.0, 10.5, 12.0, 13.5, 15.0, 17.0, 99.0];
/// From one limit to the next there are not so many times more stars: what lacks more than that skips a limit.
const GROWTH: usize = 12;

/// The `count` brightest stars of a cone, the brightest first; fewer when it holds fewer.
pub(super) fn brightest(stars: &impl Stars, ra: Angle, dec: Angle, radius: Angle, count: usize) -> Vec<CatalogueStar> {
    let mut limits = LIMITS_MAG.into_iter();
    let mut found = Vec::new();
    while let Some(limit) = limits.next() {
        found = stars.cone(ra, dec, radius, limit);
        // stars of another's making: what is not a number has no place on the sky
        found.retain(|star| star.ra.is_finite() && star.dec.is_finite() && !star.mag.is_nan());
        if found.len() >= count {
            break;
        }
        if GROWTH * found.len() < count && limits.len() > 1 {
            limits.next();
        }
    }
    found.sort_by(|a, b| a.mag.total_cmp(&b.mag));
    found.truncate(count);
    found
}
