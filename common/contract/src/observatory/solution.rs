//! Where a frame points, or why that is not known.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Pixels to sky: the tangent plane of FITS (TAN) with a distortion where many stars prove one.
///
/// Pixel `(0, 0)` is the centre of the first pixel, x counts columns; FITS numbers are greater by one. Calabretta &
/// Greisen 2002, A&A 395, 1077.
#[derive(Debug, Clone, Copy, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FrameWcs {
    /// ICRS right ascension of the reference pixel (CRVAL1), degrees.
    pub ra_deg: f64,
    /// ICRS declination of the reference pixel (CRVAL2), degrees.
    pub dec_deg: f64,
    /// Column of the reference pixel (CRPIX1 - 1).
    pub x_px: f64,
    /// Row of the reference pixel (CRPIX2 - 1).
    pub y_px: f64,
    /// Degrees to the east (first row) and to the north (second row) per pixel of x (first column) and y: CD1_1, CD1_2,
    /// CD2_1, CD2_2.
    pub cd_deg_px: [[f64; 2]; 2],
    /// Distortion; absent where the optics show none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sip: Option<Distortion>,
}

/// Distortion of up to third order as a SIP polynomial about the reference pixel (Shupe et al. 2005, ASP Conf. 347, 491):
/// with u, v px from there, the linear part is given `u + A(u, v)` and `v + B(u, v)`.
#[derive(Debug, Clone, Copy, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Distortion {
    /// Coefficients of A in the order u2 uv v2 u3 u2v uv2 v3, px^(1 - power).
    pub a: [f64; 7],
    /// Coefficients of B, likewise.
    pub b: [f64; 7],
}

/// Why a frame with stars has no solution.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Unsolved {
    /// What calls for one and the same remedy.
    pub class: UnsolvedClass,
    /// The figures, in words.
    pub detail: String,
}

/// Classes of failures (each is followed by what helps).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum UnsolvedClass {
    /// No star catalogue is open: look at the alert.
    NoCatalogue,
    /// The size of a pixel on the sky is not known: set `scale_arcsec_px` of the camera.
    NoScale,
    /// Where the telescope pointed is not known: neither a target nor a mount.
    NoPlace,
    /// The given place and scale make no sense: look at the devices.
    BadHint,
    /// Expose longer.
    TooFewStars,
    /// Wait.
    Clouds,
    /// Look at tracking and wind.
    Trailed,
    /// Shorten the exposure.
    Saturated,
    /// Take a deeper catalogue.
    CatalogueTooShallow,
    /// Two places fit: expose longer.
    Ambiguous,
    /// Nothing fits near the given place: the telescope points elsewhere, or the scale is another.
    NoMatch,
}
