//! How far the stars moved from one frame to another, from their measured places.
//!
//! Star lists are paired by voting for the most frequent difference of places, then a shift and a small rotation about
//! the frame's centre are fitted by weighted least squares with Huber's weights (Huber 1964, Ann. Math. Statist. 35,
//! 73). The errors follow from the stars' own centroid errors. dx and dy are *check minus reference*: a star that
//! stood at x stands at x + dx now. Rotation is positive from +x towards +y.

pub(crate) mod chance;
mod fit;
mod pair;

pub(crate) use pair::most_frequent_difference;

use crate::star::Star;

/// A shift with a standard error above this is no shift, px.
const GREATEST_ERROR_PX: f64 = 0.5;
/// Shifts above this need at least three stars, px.
const FEW_STARS_PX: f64 = 5.0;
/// Stars that take part, spread over the frame.
const STARS: usize = 50;

/// Stars of a pair are this near in the end, px.
const LAST_REACH_PX: f64 = 3.0;

/// How a shift was measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// By the places of stars.
    Stars,
    /// By the sums over rows and columns.
    Projections,
}

/// How far the stars moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shift {
    /// Along x, at the frame's centre, px.
    pub dx_px: f64,
    /// Along y, at the frame's centre, px.
    pub dy_px: f64,
    /// Rotation about the frame's centre from +x towards +y, degrees; 0 where it was not fitted.
    pub rotation_deg: f64,
    /// Covariance of dx (px), dy (px) and rotation (deg); rotation's row is zero where it was not fitted.
    pub covariance: [[f64; 3]; 3],
    /// Stars that were used; 0 for projections.
    pub stars: usize,
    /// Median flux in check over flux in reference; None for projections.
    pub transparency: Option<f64>,
    /// How it was measured.
    pub method: Method,
}

impl Shift {
    /// Standard errors of dx and dy, px.
    pub fn error_px(&self) -> (f64, f64) {
        (self.covariance[0][0].sqrt(), self.covariance[1][1].sqrt())
    }

    /// Where a star of the reference at (x, y) px stands now, in frames of this many columns and rows.
    pub fn apply(&self, x_px: f64, y_px: f64, width: usize, height: usize) -> (f64, f64) {
        let (middle_x, middle_y) = (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
        let (sin, cos) = self.rotation_deg.to_radians().sin_cos();
        let (u, v) = (x_px - middle_x, y_px - middle_y);
        (middle_x + cos * u - sin * v + self.dx_px, middle_y + sin * u + cos * v + self.dy_px)
    }
}

/// Why no shift can be measured.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoShift {
    /// No stars, or none that is good enough, in one of the frames.
    #[error("too few stars to compare: {reference} in the reference, {check} in the check frame")]
    TooFewStars {
        /// Usable stars in the reference.
        reference: usize,
        /// Usable stars in the check frame.
        check: usize,
    },
    /// The star lists have too little in common.
    #[error("the frames do not match: only {matched} stars agree on a shift of {dx_px:.1}, {dy_px:.1} px")]
    NoMatch {
        /// Stars that agree.
        matched: usize,
        /// The best shift found, px.
        dx_px: f64,
        /// The best shift found, px.
        dy_px: f64,
    },
    /// A shift was found, but its error is too great to be used.
    #[error("the shift is uncertain by {error_px:.2} px, more than 0.5 px")]
    Uncertain {
        /// Greater one of the standard errors, px.
        error_px: f64,
    },
    /// The frames have different shapes.
    #[error("frames of {0} x {1} px and {2} x {3} px cannot be compared")]
    Shapes(usize, usize, usize, usize),
    /// No shift is clearly better than any other.
    #[error(
        "no shift is clear: of {reference} bright patches in the reference and {check} in the check frame {agree} agree \
         on one, as they would by chance or on another shift; give frames of one field with more stars"
    )]
    NoPeak {
        /// Patches in the reference.
        reference: usize,
        /// Patches in the check frame.
        check: usize,
        /// Those that agree on the best shift.
        agree: usize,
    },
}

/// The shift between two lists of stars of frames with this many columns and rows.
///
/// # Errors
/// [`NoShift`] when too few stars are good, too few agree, or the result is too uncertain: with fewer than three
/// common stars only shifts up to 5 px are believed.
pub fn from_stars(reference: &[Star], check: &[Star], width: usize, height: usize) -> Result<Shift, NoShift> {
    let chosen = |stars: &[Star]| {
        let good: Vec<Star> = stars.iter().filter(|s| !(s.flags.saturated || s.flags.edge)).copied().collect();
        crate::star::spread_evenly(&good, width, height, STARS)
    };
    let (reference, check) = (chosen(reference), chosen(check));
    if reference.is_empty() || check.is_empty() {
        return Err(NoShift::TooFewStars { reference: reference.len(), check: check.len() });
    }
    let centre = (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
    let differences = reference.iter().flat_map(|r| check.iter().map(|c| (c.x_px - r.x_px, c.y_px - r.y_px)));
    let start = most_frequent_difference(differences).unwrap_or_default();
    let mut motion = fit::FieldMotion::shifted(start, centre);
    let mut pairs = Vec::new();
    // the vote is good to a few px; the fit then closes in
    for reach in [6.0, 4.0, LAST_REACH_PX, LAST_REACH_PX] {
        pairs = pair::mutual(&reference, &check, &motion, reach);
        let no_match = NoShift::NoMatch { matched: pairs.len(), dx_px: motion.dx, dy_px: motion.dy };
        motion = fit::fit(pair::moving(&pairs).as_deref().unwrap_or(&pairs), centre).ok_or(no_match)?;
    }
    let (dx, dy) = (motion.dx.abs(), motion.dy.abs());
    let agreement = chance::Agreement {
        agree: pairs.len(),
        pairs: reference.len() * check.len(),
        area_px2: (width as f64 - dx) * (height as f64 - dy),
        reach_px: LAST_REACH_PX,
        shift_px: dx.hypot(dy),
    };
    // a field hardly moves from frame to frame: then most of a few stars are enough
    let stays = dx.hypot(dy) <= FEW_STARS_PX && 2 * pairs.len() > reference.len().max(check.len());
    if !(stays || agreement.is_sure()) {
        return Err(NoShift::NoMatch { matched: pairs.len(), dx_px: motion.dx, dy_px: motion.dy });
    }
    of_motion(&motion, &pairs)
}

/// The same for frames that may be upside down to each other, as a German mount leaves them after a meridian flip. Then
/// the rotation is near 180 degrees, and the shift is that of the middle of the frame after a turn about it.
///
/// # Errors
/// [`NoShift`] as [`from_stars`].
pub fn from_stars_either_way(
    reference: &[Star],
    check: &[Star],
    width: usize,
    height: usize,
) -> Result<Shift, NoShift> {
    let upright = from_stars(reference, check, width, height);
    let Err(NoShift::NoMatch { .. }) = upright else { return upright };
    let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
    let turn = |star: &Star| Star { x_px: right - star.x_px, y_px: bottom - star.y_px, ..*star };
    let turned: Vec<Star> = reference.iter().map(turn).collect();
    let Ok(mut shift) = from_stars(&turned, check, width, height) else { return upright };
    shift.rotation_deg += if shift.rotation_deg > 0.0 { -180.0 } else { 180.0 };
    Ok(shift)
}

/// The shift of stars of which it is known which is which, of `reference` and `check` stars in the two frames. Pairs
/// that do not agree with the most are left out.
pub(crate) fn from_pairs(
    pairs: &[(&Star, &Star)],
    reference: usize,
    check: usize,
    width: usize,
    height: usize,
) -> Result<Shift, NoShift> {
    let centre = (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
    let too_few = NoShift::TooFewStars { reference, check };
    let mut retained = pairs.to_vec();
    let mut motion = fit::fit(pair::moving(&retained).as_deref().unwrap_or(&retained), centre).ok_or(too_few)?;
    for _ in 0..2 {
        retained = pairs.iter().copied().filter(|pair| motion.explains(pair)).collect();
        let (matched, dx_px, dy_px) = (retained.len(), motion.dx, motion.dy);
        // what most stars do not follow is no motion of the field
        if 2 * matched < pairs.len().min(reference) || matched == 0 {
            return Err(NoShift::NoMatch { matched, dx_px, dy_px });
        }
        let no_match = NoShift::NoMatch { matched, dx_px, dy_px };
        motion = fit::fit(pair::moving(&retained).as_deref().unwrap_or(&retained), centre).ok_or(no_match)?;
    }
    of_motion(&motion, &retained)
}

/// The shift of a motion that these pairs gave, if it can be believed.
fn of_motion(motion: &fit::FieldMotion, pairs: &[(&Star, &Star)]) -> Result<Shift, NoShift> {
    let (dx_px, dy_px) = (motion.dx, motion.dy);
    let far = dx_px.hypot(dy_px) > FEW_STARS_PX;
    if far && pairs.len() < 3 {
        return Err(NoShift::NoMatch { matched: pairs.len(), dx_px, dy_px });
    }
    let error_px = motion.covariance[0][0].max(motion.covariance[1][1]).sqrt();
    if !(error_px <= GREATEST_ERROR_PX && dx_px.is_finite() && dy_px.is_finite()) {
        return Err(NoShift::Uncertain { error_px });
    }
    let mut ratios: Vec<f32> = pairs.iter().map(|(r, c)| (c.flux_adu / r.flux_adu) as f32).collect();
    Ok(Shift {
        dx_px,
        dy_px,
        rotation_deg: motion.rotation.to_degrees(),
        covariance: motion.covariance_in_degrees(),
        stars: pairs.len(),
        transparency: crate::background::median_in_place(&mut ratios).map(f64::from),
        method: Method::Stars,
    })
}

#[cfg(test)]
mod tests;
