//! Star lists of frames that were never taken: a random sky, a telescope that is known, and what goes wrong.
#![allow(dead_code)] // each test file uses its part
#![allow(clippy::unwrap_used, clippy::panic)] // helpers of tests are tests too

use imaging::catalogue::{Catalogue, Entry, build};
use imaging::solve::{Detected, Hint, LearnedOptics};
use imaging::tangent::TangentPlane;
use imaging::{Flags, Star, Wcs};
use rand::{RngExt, SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, StandardNormal};
use units::Angle;

/// Epoch of the catalogue, and of the frames.
pub const EPOCHS: (f64, f64) = (2016.0, 2026.9);

pub fn deg(degrees: f64) -> Angle {
    Angle::from_degrees(degrees)
}

/// What a frame is like.
#[derive(Debug, Clone, Copy)]
pub struct Kind {
    /// Declinations of the centre, deg; right ascension is random, or around 0 h.
    pub dec_deg: (f64, f64),
    pub around_ra_0: bool,
    pub shape: (usize, usize),
    /// Longer side, deg, drawn evenly in its logarithm.
    pub field_deg: (f64, f64),
    /// Real stars in the frame.
    pub stars: (usize, usize),
    /// Share of the detections that are no stars.
    pub spurious: f64,
    /// Offset of the hint, in longer sides.
    pub offset_fields: f64,
    /// ... or in deg, whichever is more.
    pub offset_deg: f64,
    /// Error of the hinted scale, as a share.
    pub scale_error: f64,
    /// Standard error of a centroid, px.
    pub centroid_px: f64,
    /// Share of the stars that the catalogue does not have.
    pub missing: f64,
    /// Standard deviation of proper motions, mas/yr.
    pub motion_mas: f64,
    /// Radial distortion in the corner, px.
    pub corner_px: f64,
    /// Rotation, scale and parity are known.
    pub learned: bool,
}

pub const PLAIN: Kind = Kind {
    dec_deg: (-80.0, 80.0),
    around_ra_0: false,
    shape: (2048, 2048),
    field_deg: (0.1, 2.0),
    stars: (8, 40),
    spurious: 0.0,
    offset_fields: 1.0,
    offset_deg: 0.0,
    scale_error: 0.02,
    centroid_px: 0.1,
    missing: 0.05,
    motion_mas: 10.0,
    corner_px: 0.0,
    learned: false,
};

/// A frame with its truth.
pub struct DrawnFrame {
    pub stars: Vec<Star>,
    pub shape: (usize, usize),
    pub truth: Wcs,
    pub hint: Hint,
    pub catalogue: Catalogue<Vec<u8>>,
}

impl DrawnFrame {
    pub fn detected(&self) -> Detected<'_> {
        Detected { stars: &self.stars, width: self.shape.0, height: self.shape.1, quality: None }
    }

    /// Distance of another WCS at the centre and at the worst corner, px.
    pub fn errors_px(&self, wcs: &Wcs) -> (f64, f64) {
        let error = |x: f64, y: f64| {
            let (ra, dec) = wcs.pixel_to_sky(x, y);
            self.truth.sky_to_pixel(ra, dec).map_or(f64::INFINITY, |(tx, ty)| (tx - x).hypot(ty - y))
        };
        let (right, top) = (self.shape.0 as f64 - 1.0, self.shape.1 as f64 - 1.0);
        let corners = [(0.0, 0.0), (right, 0.0), (0.0, top), (right, top)];
        (error(0.5 * right, 0.5 * top), corners.iter().map(|(x, y)| error(*x, *y)).fold(0.0, f64::max))
    }
}

pub fn star(x_px: f64, y_px: f64, flux_adu: f64, error_px: f64) -> Star {
    Star {
        x_px,
        y_px,
        x_error_px: error_px,
        y_error_px: error_px,
        flux_adu,
        flux_error_adu: 0.1 * flux_adu,
        snr: 10.0,
        significance: 10.0,
        peak_adu: 0.1 * flux_adu,
        fwhm_px: 3.0,
        ellipticity: 0.0,
        angle_deg: 0.0,
        flags: Flags::default(),
    }
}

pub fn normal(rng: &mut StdRng) -> f64 {
    StandardNormal.sample(rng)
}

/// A WCS by its meaning.
pub fn wcs(ra: Angle, dec: Angle, shape: (usize, usize), scale_arcsec: f64, rotation: Angle, mirrored: bool) -> Wcs {
    let (s, side) = (scale_arcsec / 3600.0, if mirrored { -1.0 } else { 1.0 });
    Wcs {
        ra,
        dec,
        x_px: 0.5 * (shape.0 as f64 - 1.0),
        y_px: 0.5 * (shape.1 as f64 - 1.0),
        cd_deg_px: [[s * side * rotation.cos(), s * rotation.sin()], [-s * side * rotation.sin(), s * rotation.cos()]],
        sip: None,
    }
}

/// Magnitudes from 6 on, three times more stars per magnitude: as a power law of the rank.
fn magnitude(rng: &mut StdRng, faintest: f64) -> f64 {
    faintest + rng.random_range(1e-6_f64..1.0).log10() / 3.0_f64.log10()
}

/// The frame of a seed; the sky is drawn again where it has too few stars in the frame.
pub fn draw(kind: &Kind, seed: u64) -> DrawnFrame {
    let mut rng = StdRng::seed_from_u64(seed);
    (0..100).find_map(|_| try_to_draw(kind, &mut rng)).unwrap()
}

fn try_to_draw(kind: &Kind, rng: &mut StdRng) -> Option<DrawnFrame> {
    let (low, high) = kind.field_deg;
    let field = (low.ln() + (high / low).ln() * rng.random_range(0.0..=1.0)).exp();
    let longer = kind.shape.0.max(kind.shape.1) as f64;
    let scale = field * 3600.0 / longer;
    let dec = deg(rng.random_range(kind.dec_deg.0..=kind.dec_deg.1));
    let ra =
        if kind.around_ra_0 { rng.random_range(-0.3..0.3) * field / dec.cos() } else { rng.random_range(0.0..360.0) };
    let ra = deg(ra).wrapped_positive();
    let rotation = deg(rng.random_range(-180.0..180.0));
    let mut truth = wcs(ra, dec, kind.shape, scale, rotation, rng.random_bool(0.5));
    if kind.corner_px != 0.0 {
        let half = 0.5 * (kind.shape.0 as f64).hypot(kind.shape.1 as f64);
        let k = kind.corner_px / half.powi(3);
        truth.sip = Some(imaging::wcs::Sip { a: [0.0, 0.0, 0.0, k, 0.0, k, 0.0], b: [0.0, 0.0, 0.0, 0.0, k, 0.0, k] });
    }
    let offset = (kind.offset_fields * field).max(kind.offset_deg) * rng.random_range(0.0_f64..1.0).sqrt();

    // a sky with three times the stars that the frame shows, wide enough for frame and hint
    let wanted = rng.random_range(kind.stars.0..=kind.stars.1);
    let area = field * field * kind.shape.0.min(kind.shape.1) as f64 / longer;
    let reach = 1.05 * (offset + 2.6 * field) + 0.05;
    let count = (3.0 * wanted as f64 / area * std::f64::consts::PI * reach * reach) as usize;
    let plane = TangentPlane::new(ra, dec);
    let years = EPOCHS.1 - EPOCHS.0;
    let mut entries = Vec::new();
    let mut sky = Vec::new();
    for _ in 0..count.max(40) {
        let (far, bearing) =
            (reach * rng.random_range(0.0_f64..1.0).sqrt(), rng.random_range(0.0..std::f64::consts::TAU));
        let (xi, eta) = (far.to_radians().tan() * bearing.sin(), far.to_radians().tan() * bearing.cos());
        let now = plane.direction(xi, eta);
        let mag = magnitude(rng, 13.0);
        let motion = (kind.motion_mas * normal(rng), kind.motion_mas * normal(rng));
        // back to the catalogue's epoch, on the tangent plane of the star itself
        let own = TangentPlane::new(now.0, now.1);
        let back = |mas: f64| -Angle::from_arcseconds(mas.round() * 1e-3 * years).radians();
        let then = own.direction(back(motion.0), back(motion.1));
        sky.push((now, mag));
        entries.push(Entry { ra: then.0, dec: then.1, pm_ra_mas: motion.0.round(), pm_dec_mas: motion.1.round(), mag });
    }
    // the brightest in the frame are detected; some of them are not in the catalogue
    let mut inside: Vec<(usize, f64, f64)> = Vec::new();
    for (n, ((ra, dec), _)) in sky.iter().enumerate() {
        if let Some((x, y)) = truth.sky_to_pixel(*ra, *dec)
            && (3.0..kind.shape.0 as f64 - 4.0).contains(&x)
            && (3.0..kind.shape.1 as f64 - 4.0).contains(&y)
        {
            inside.push((n, x, y));
        }
    }
    inside.sort_by(|a, b| sky[a.0].1.total_cmp(&sky[b.0].1));
    inside.truncate(wanted);
    if inside.len() < kind.stars.0 {
        return None;
    }
    let mut stars = Vec::new();
    let mut absent = Vec::new();
    for (n, x, y) in &inside {
        let flux = 10_f64.powf(-0.4 * (sky[*n].1 - 13.0 + 0.2 * normal(rng))) * 1000.0;
        let (dx, dy) = (kind.centroid_px * normal(rng), kind.centroid_px * normal(rng));
        stars.push(star(x + dx, y + dy, flux, kind.centroid_px));
        // of the few stars of a sparse field all are needed
        if wanted > 8 && rng.random_bool(kind.missing) {
            absent.push(*n);
        }
    }
    let spurious = (stars.len() as f64 * kind.spurious / (1.0 - kind.spurious)).round() as usize;
    for _ in 0..spurious {
        let flux = 10_f64.powf(-0.4 * (magnitude(rng, 12.0) - 13.0)) * 1000.0;
        let (x, y) =
            (rng.random_range(0.0..kind.shape.0 as f64 - 1.0), rng.random_range(0.0..kind.shape.1 as f64 - 1.0));
        stars.push(star(x, y, flux, kind.centroid_px));
    }
    let retained: Vec<Entry> =
        entries.iter().enumerate().filter(|(n, _)| !absent.contains(n)).map(|(_, e)| *e).collect();
    let catalogue = Catalogue::from_bytes(build(&retained, 6, EPOCHS.0)).unwrap();

    let bearing = rng.random_range(0.0..std::f64::consts::TAU);
    let far = offset.to_radians().tan();
    let (hint_ra, hint_dec) = plane.direction(far * bearing.sin(), far * bearing.cos());
    let error = kind.scale_error * rng.random_range(-0.95..0.95);
    let mut hint = Hint::new(hint_ra, hint_dec, scale * (1.0 + error));
    hint.furthest = deg(if kind.offset_deg > 0.0 { kind.offset_deg } else { 0.0 });
    if kind.learned {
        hint.learned = Some(LearnedOptics {
            scale_arcsec_px: scale * (1.0 + 2e-4 * normal(rng)),
            rotation_deg: truth.rotation_deg() + 0.02 * normal(rng),
            mirrored: truth.mirrored(),
            sip: truth.sip,
        });
    }
    Some(DrawnFrame { stars, shape: kind.shape, truth, hint, catalogue })
}
