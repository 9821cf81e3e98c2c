//! Shift, rotation, scale and parity: how the sky lies in the frame.
//!
//! Both planes are complex numbers: `z` is a place in the frame (px from its centre), `w` one on a tile (px of the
//! hinted scale), whose east is turned about where the frame is a mirror image. Then `z = s w + t`.

use super::hint::LearnedOptics;

/// A place on a plane, px.
pub(super) type Place = (f64, f64);
/// A place of the tile and a place in the frame that agree.
pub(super) type PlacePair = (Place, Place);

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Similarity {
    /// Scale and rotation, a complex number.
    pub(super) s: (f64, f64),
    /// Where the tile's centre falls, px.
    pub(super) t: (f64, f64),
    pub(super) mirrored: bool,
}

pub(super) fn multiply(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0)
}

pub(super) fn divide(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    let squared = b.0 * b.0 + b.1 * b.1;
    ((a.0 * b.0 + a.1 * b.1) / squared, (a.1 * b.0 - a.0 * b.1) / squared)
}

/// A place of the tile as a number `w`; its own inverse.
pub(super) fn turned((xi, eta): (f64, f64), mirrored: bool) -> (f64, f64) {
    (if mirrored { -xi } else { xi }, eta)
}

impl Similarity {
    /// The one that has the learned scale, rotation and parity, without a shift; `scale_arcsec_px` is the tile's.
    pub(super) fn learned(learned: &LearnedOptics, scale_arcsec_px: f64) -> Self {
        let angle = learned.rotation_deg.to_radians() * if learned.mirrored { -1.0 } else { 1.0 };
        let (sin, cos) = angle.sin_cos();
        let size = scale_arcsec_px / learned.scale_arcsec_px;
        Self { s: (size * cos, size * sin), t: (0.0, 0.0), mirrored: learned.mirrored }
    }

    /// Where a place of the tile falls in the frame.
    pub(super) fn apply(&self, place: (f64, f64)) -> (f64, f64) {
        let z = multiply(self.s, turned(place, self.mirrored));
        (z.0 + self.t.0, z.1 + self.t.1)
    }

    /// The place of the tile that falls on a place in the frame.
    pub(super) fn invert(&self, z: (f64, f64)) -> (f64, f64) {
        turned(divide((z.0 - self.t.0, z.1 - self.t.1), self.s), self.mirrored)
    }

    /// Size of a tile's px in the frame, px: 1 where the hinted scale is right.
    pub(super) fn size(&self) -> f64 {
        self.s.0.hypot(self.s.1)
    }

    /// The best similarity for pairs (place of the tile, place in the frame); `fixed` keeps scale and rotation and
    /// fits the shift alone. None when the pairs do not fix it.
    pub(super) fn fitted(&self, pairs: &[PlacePair], fixed: bool) -> Option<Self> {
        let n = pairs.len() as f64;
        let (mut w_mean, mut z_mean) = ((0.0, 0.0), (0.0, 0.0));
        for (place, z) in pairs {
            let w = turned(*place, self.mirrored);
            w_mean = (w_mean.0 + w.0 / n, w_mean.1 + w.1 / n);
            z_mean = (z_mean.0 + z.0 / n, z_mean.1 + z.1 / n);
        }
        let mut s = self.s;
        if !fixed {
            let (mut product, mut squared) = ((0.0, 0.0), 0.0);
            for (place, z) in pairs {
                let w = turned(*place, self.mirrored);
                let (u, v) = (w.0 - w_mean.0, w_mean.1 - w.1);
                let term = multiply((z.0 - z_mean.0, z.1 - z_mean.1), (u, v));
                product = (product.0 + term.0, product.1 + term.1);
                squared += u * u + v * v;
            }
            s = (product.0 / squared, product.1 / squared);
        }
        let turned_mean = multiply(s, w_mean);
        let t = (z_mean.0 - turned_mean.0, z_mean.1 - turned_mean.1);
        let sound = [s.0, s.1, t.0, t.1].iter().all(|v| v.is_finite()) && s.0.hypot(s.1) > 0.0;
        sound.then_some(Self { s, t, mirrored: self.mirrored })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_similarity_is_found_from_its_pairs() {
        for mirrored in [false, true] {
            let truth = Similarity { s: (0.6, -0.81), t: (40.0, -7.0), mirrored };
            let places = [(10.0, 20.0), (-300.0, 5.0), (70.0, -900.0)];
            let pairs: Vec<_> = places.iter().map(|place| (*place, truth.apply(*place))).collect();
            let start = Similarity { s: (1.0, 0.0), t: (0.0, 0.0), mirrored };
            let found = start.fitted(&pairs, false).unwrap();
            assert!((found.s.0 - truth.s.0).abs() < 1e-12 && (found.s.1 - truth.s.1).abs() < 1e-12);
            let back = found.invert(pairs[1].1);
            assert!((back.0 + 300.0).abs() < 1e-9 && (back.1 - 5.0).abs() < 1e-9);
            let shifted = Similarity { t: (0.0, 0.0), ..truth }.fitted(&pairs, true).unwrap();
            assert!((shifted.t.0 - 40.0).abs() < 1e-9 && (shifted.t.1 + 7.0).abs() < 1e-9);
            assert!(start.fitted(&[pairs[0], pairs[0]], false).is_none());
        }
    }
}
