//! What is known before a frame is solved, and what a solution teaches for the next one.

use units::Angle;

use crate::wcs::Sip;

/// Scale error before the first solution of a camera, as a share.
pub const FIRST_LIGHT: f64 = 0.05;
/// Scale error of optics that are known, as a share.
pub const KNOWN_OPTICS: f64 = 0.02;

/// Work after which a hopeless frame is refused: less than a second also on a slow core that is shared.
pub const MOST_HYPOTHESES: u64 = 4_500_000;

/// What is known of a frame before it is solved.
#[derive(Debug, Clone, PartialEq)]
pub struct Hint {
    /// ICRS right ascension where the frame's centre should be.
    pub ra: Angle,
    /// ICRS declination where the frame's centre should be.
    pub dec: Angle,
    /// Size of a (binned) pixel on the sky, arcsec.
    pub scale_arcsec_px: f64,
    /// How wrong the scale may be, as a share: [`KNOWN_OPTICS`] or [`FIRST_LIGHT`].
    pub scale_tolerance: f64,
    /// Whether the image is a mirror image ([`crate::wcs::Wcs::mirrored`]); None where not known.
    pub mirrored: Option<bool>,
    /// What the last solution with this camera, filter and pier side taught: it makes level 0 possible.
    pub learned: Option<LearnedOptics>,
    /// How far from the hinted place the frame's centre is looked for when it is not within a frame's size of it
    /// (level 2). Zero: not at all.
    pub furthest: Angle,
    /// Whether other scales are looked for in the hinted field when the hinted one does not fit: up to 43 % off (another
    /// camera or reducer), and half, a third, a quarter, twice, three and four times it (binning). It takes about as
    /// long as a level 1 that finds nothing, so it is for frames whose optics no solution has shown yet.
    pub wrong_scales: bool,
    /// Work after which the search gives up, in hypotheses; 10 to 50 million are tested in a second, and a piece of the sky
    /// that is laid out costs some thousands. It is shared out: the hinted field, other scales and the sky around all get
    /// their part.
    pub most_hypotheses: u64,
    /// Magnitude of the faintest stars that such a frame shows under a clear sky; distinguishes clouds from other
    /// failures.
    pub faintest_mag: Option<f64>,
}

impl Hint {
    /// A hint of place and scale with the usual tolerances: scale 2 % and no other, up to 8 deg off.
    pub fn new(ra: Angle, dec: Angle, scale_arcsec_px: f64) -> Self {
        Self {
            ra,
            dec,
            scale_arcsec_px,
            scale_tolerance: KNOWN_OPTICS,
            mirrored: None,
            learned: None,
            furthest: Angle::from_degrees(8.0),
            wrong_scales: false,
            most_hypotheses: MOST_HYPOTHESES,
            faintest_mag: None,
        }
    }
}

/// What stays the same from frame to frame of one camera, filter and pier side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LearnedOptics {
    /// Size of a pixel, arcsec.
    pub scale_arcsec_px: f64,
    /// Position angle of +y, degrees ([`crate::wcs::Wcs::rotation_deg`]).
    pub rotation_deg: f64,
    /// Whether the image is a mirror image.
    pub mirrored: bool,
    /// Distortion about the frame's centre.
    pub sip: Option<Sip>,
}
