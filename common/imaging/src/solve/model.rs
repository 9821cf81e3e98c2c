//! The model of a frame's geometry: fitted to pairs, with as many terms as they justify.

use crate::least_squares::LeastSquares;
use crate::tangent::TangentPlane;
use crate::wcs::{Sip, Wcs};

/// Pairs from which on the model is more than a similarity, an affine, a radial distortion.
const AFFINE: usize = 8;
const RADIAL: usize = 20;
const CUBIC: usize = 40;
/// Residuals beyond this many rms are left out.
const CLIP: f64 = 3.0;

/// A star of the frame and its place on the tangent plane of the WCS.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// Place in the frame, px from the reference pixel.
    pub(super) u: f64,
    pub(super) v: f64,
    /// Place of the catalogue star on the tangent plane, degrees.
    pub(super) xi: f64,
    pub(super) eta: f64,
    /// One over the variance, px^-2.
    pub(super) weight: f64,
}

/// Coefficients of 1 u v u2 uv v2 u3 u2v uv2 v3 for xi and eta (degrees; u and v over the scale `length`).
#[derive(Debug, Clone, Copy)]
struct Polynomial {
    xi: [f64; 10],
    eta: [f64; 10],
    length: f64,
    /// Distortion that u and v were freed of before.
    before: Option<Sip>,
    unknowns: usize,
}

/// The WCS (reference pixel unchanged, at the frame's centre) that fits best, and the rms of the residuals, px. `known`
/// is a distortion learned before; `bends` allows a new one. None when the pairs do not fix it.
pub(super) fn fit(samples: &[Sample], wcs: &Wcs, known: Option<Sip>, length: f64, bends: bool) -> Option<(Wcs, f64)> {
    let mut retained = samples.to_vec();
    let mut best = choose(&retained, wcs, known, length, bends)?;
    for _ in 0..3 {
        let limit = CLIP * best.rms_px(&retained, wcs).max(0.05);
        let sound: Vec<Sample> = retained.iter().filter(|s| best.residual_px(s, wcs) <= limit).copied().collect();
        if sound.len() == retained.len() || sound.len() < 3 {
            break;
        }
        retained = sound;
        best = choose(&retained, wcs, known, length, bends)?;
    }
    Some((best.wcs(wcs)?, best.rms_px(&retained, wcs)))
}

/// Among the models that so many pairs allow, the one that Schwarz's criterion (1978, Ann. Stat. 6, 461) prefers:
/// distortion that is not there must not be fitted.
fn choose(samples: &[Sample], wcs: &Wcs, known: Option<Sip>, length: f64, bends: bool) -> Option<Polynomial> {
    let plain = if samples.len() < AFFINE { similarity } else { affine };
    let mut models = vec![plain(samples, wcs, known, length)];
    if bends && samples.len() >= RADIAL {
        let straight = affine(samples, wcs, None, length);
        models.extend([straight, straight.and_then(|model| radial(samples, model))]);
    }
    if bends && samples.len() >= CUBIC {
        models.push(cubic(samples, length));
    }
    let n = 2.0 * samples.len() as f64;
    let criterion = |model: &Polynomial| {
        let squares: f64 = samples.iter().map(|s| s.weight * model.residual_px(s, wcs).powi(2)).sum();
        n * (squares / n).max(1e-12).ln() + model.unknowns as f64 * n.ln()
    };
    models.into_iter().flatten().min_by(|a, b| criterion(a).total_cmp(&criterion(b)))
}

fn corrected(sample: &Sample, known: Option<Sip>, length: f64) -> (f64, f64) {
    let (u, v) = known.map_or((sample.u, sample.v), |sip| sip.apply(sample.u, sample.v));
    (u / length, v / length)
}

fn similarity(samples: &[Sample], wcs: &Wcs, known: Option<Sip>, length: f64) -> Option<Polynomial> {
    let side = if wcs.mirrored() { -1.0 } else { 1.0 };
    let mut sums = LeastSquares::<4>::new();
    for s in samples {
        let (u, v) = corrected(s, known, length);
        sums.add([u, -v, 1.0, 0.0], side * s.xi, s.weight);
        sums.add([v, u, 0.0, 1.0], s.eta, s.weight);
    }
    let [a, b, c, d] = sums.solve()?;
    let (mut xi, mut eta) = ([0.0; 10], [0.0; 10]);
    xi[..3].copy_from_slice(&[side * c, side * a, -side * b]);
    eta[..3].copy_from_slice(&[d, b, a]);
    Some(Polynomial { xi, eta, length, before: known, unknowns: 4 })
}

fn affine(samples: &[Sample], _: &Wcs, known: Option<Sip>, length: f64) -> Option<Polynomial> {
    let mut sums = [LeastSquares::<3>::new(), LeastSquares::<3>::new()];
    for s in samples {
        let (u, v) = corrected(s, known, length);
        sums[0].add([1.0, u, v], s.xi, s.weight);
        sums[1].add([1.0, u, v], s.eta, s.weight);
    }
    let (mut xi, mut eta) = ([0.0; 10], [0.0; 10]);
    xi[..3].copy_from_slice(&sums[0].solve()?);
    eta[..3].copy_from_slice(&sums[1].solve()?);
    Some(Polynomial { xi, eta, length, before: known, unknowns: 6 })
}

/// An affine with `1 + k r^2` about the frame's centre; `start` is the affine without.
fn radial(samples: &[Sample], start: Polynomial) -> Option<Polynomial> {
    let mut model = start;
    // k multiplies the linear terms, which change with it: two rounds are enough for any lens
    for _ in 0..2 {
        let (x, y) = (model.xi, model.eta);
        let mut sums = LeastSquares::<7>::new();
        for s in samples {
            let (u, v) = corrected(s, None, start.length);
            let r2 = u * u + v * v;
            sums.add([1.0, u, v, 0.0, 0.0, 0.0, r2 * (x[1] * u + x[2] * v)], s.xi, s.weight);
            sums.add([0.0, 0.0, 0.0, 1.0, u, v, r2 * (y[1] * u + y[2] * v)], s.eta, s.weight);
        }
        let [x0, x1, x2, y0, y1, y2, k] = sums.solve()?;
        let row = |linear: [f64; 3], old: [f64; 10]| {
            let (a, b) = (k * old[1], k * old[2]);
            [linear[0], linear[1], linear[2], 0.0, 0.0, 0.0, a, b, a, b]
        };
        (model.xi, model.eta) = (row([x0, x1, x2], x), row([y0, y1, y2], y));
        model.unknowns = 7;
    }
    Some(model)
}

fn cubic(samples: &[Sample], length: f64) -> Option<Polynomial> {
    let mut sums = [LeastSquares::<10>::new(), LeastSquares::<10>::new()];
    for s in samples {
        let (u, v) = corrected(s, None, length);
        sums[0].add(terms(u, v), s.xi, s.weight);
        sums[1].add(terms(u, v), s.eta, s.weight);
    }
    Some(Polynomial { xi: sums[0].solve()?, eta: sums[1].solve()?, length, before: None, unknowns: 20 })
}

fn terms(u: f64, v: f64) -> [f64; 10] {
    [1.0, u, v, u * u, u * v, v * v, u * u * u, u * u * v, u * v * v, v * v * v]
}

impl Polynomial {
    /// Distance of a star from its place, px.
    fn residual_px(&self, sample: &Sample, wcs: &Wcs) -> f64 {
        let (u, v) = corrected(sample, self.before, self.length);
        let sum = |c: &[f64; 10]| c.iter().zip(terms(u, v)).map(|(c, t)| c * t).sum::<f64>();
        let far = (sum(&self.xi) - sample.xi).hypot(sum(&self.eta) - sample.eta);
        far * 3600.0 / wcs.scale_arcsec_px()
    }

    fn rms_px(&self, samples: &[Sample], wcs: &Wcs) -> f64 {
        let squares: f64 = samples.iter().map(|sample| self.residual_px(sample, wcs).powi(2)).sum();
        (squares / samples.len().max(1) as f64).sqrt()
    }

    /// The WCS with its reference direction moved to the frame's centre. None when x and y cannot be distinguished.
    fn wcs(&self, old: &Wcs) -> Option<Wcs> {
        let plane = TangentPlane::new(old.ra, old.dec);
        let (x0, y0) = (self.xi[0].to_radians(), self.eta[0].to_radians());
        let (ra, dec) = plane.direction(x0, y0);
        // north of the new plane seen from the old one: near a pole a small step turns it
        let step = 1e-5;
        let (north_ra, north_dec) = plane.direction(x0, y0 + step);
        let (east, north) = TangentPlane::new(ra, dec).project(north_ra, north_dec)?;
        let (sin, cos) = (east / east.hypot(north), north / east.hypot(north));
        let [a, b] = [self.xi[1] / self.length, self.xi[2] / self.length];
        let [c, d] = [self.eta[1] / self.length, self.eta[2] / self.length];
        let determinant = a * d - b * c;
        if !determinant.is_finite() || determinant.abs() < 1e-20 {
            return None;
        }
        let mut sip = self.before;
        if self.unknowns > 6 {
            let mut fitted = Sip { a: [0.0; 7], b: [0.0; 7] };
            for n in 0..7 {
                let scale = self.length.powi(if n < 3 { 2 } else { 3 });
                let (xi, eta) = (self.xi[n + 3] / scale, self.eta[n + 3] / scale);
                fitted.a[n] = (d * xi - b * eta) / determinant;
                fitted.b[n] = (a * eta - c * xi) / determinant;
            }
            sip = Some(fitted);
        }
        let cd_deg_px = [[cos * a + sin * c, cos * b + sin * d], [cos * c - sin * a, cos * d - sin * b]];
        Some(Wcs { ra, dec, cd_deg_px, sip, ..*old })
    }
}
