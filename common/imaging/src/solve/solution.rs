//! What a solved frame shows.

use units::Angle;

use super::hint::LearnedOptics;
use crate::catalogue;
use crate::star::Star;
use crate::wcs::Wcs;

/// How much had to be searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Rotation, scale and parity were known.
    Shift,
    /// The scale was known, and the place to one field.
    Field,
    /// The place was known to one field; the scale was not the given one ([`super::Hint::wrong_scales`]).
    Scale,
    /// The scale was known; the place was further off than one field.
    Around,
    /// Nothing was known ([`super::AllSky`]).
    Blind,
}

/// A star of the frame and the catalogue's star that it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// As it was detected.
    pub star: Star,
    /// As the catalogue has it.
    pub known: catalogue::CatalogueStar,
    /// Measured minus expected column, px.
    pub dx_px: f64,
    /// Measured minus expected row, px.
    pub dy_px: f64,
}

/// Where a frame points.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// ICRS right ascension of the frame's geometric centre, `((width - 1) / 2, (height - 1) / 2)`.
    pub ra: Angle,
    /// ICRS declination of the same.
    pub dec: Angle,
    /// Size of a pixel at the centre, arcsec.
    pub scale_arcsec_px: f64,
    /// Position angle of +y, from north through east, degrees in [-180, 180) ([`Wcs::rotation_deg`]).
    pub rotation_deg: f64,
    /// Whether the image is a mirror image ([`Wcs::mirrored`]).
    pub mirrored: bool,
    /// Stars that agree with the catalogue after refinement.
    pub matched: usize,
    /// Root of their mean squared distance from their places, both axes together, px.
    pub rms_px: f64,
    /// Probability that the solution is false, an upper bound.
    pub false_alarm: f64,
    /// Pixels to sky; its reference pixel is the frame's centre.
    pub wcs: Wcs,
    /// How much had to be searched.
    pub level: Level,
    /// Hypotheses that were tested on the way.
    pub hypotheses: u64,
    /// The stars that agree.
    pub matches: Vec<Match>,
}

impl Solution {
    /// What makes level 0 possible for the next frame with this camera, filter and pier side.
    pub fn learned(&self) -> LearnedOptics {
        LearnedOptics {
            scale_arcsec_px: self.scale_arcsec_px,
            rotation_deg: self.rotation_deg,
            mirrored: self.mirrored,
            sip: self.wcs.sip,
        }
    }

    /// Magnitude of the faintest stars that were recognised (95 % of them are brighter): the next frame's
    /// [`super::Hint::faintest_mag`] at the same exposure; 1.25 mag more for ten times the exposure on a sky-limited
    /// frame. None without a star.
    pub fn faintest_mag(&self) -> Option<f64> {
        let mut mags: Vec<f64> = self.matches.iter().map(|m| m.known.mag).collect();
        mags.sort_by(f64::total_cmp);
        mags.get((mags.len() * 19 / 20).min(mags.len().saturating_sub(1))).copied()
    }
}
