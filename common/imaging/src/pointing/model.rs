//! The pointing model: a mount's error over the sky, learned from where it was seen to look.
//!
//! Per axis a sum of the terms that the geometry of an equatorial mount gives (index, collimation, the two axes not
//! square, a polar axis next to the pole, a bending tube), in hour angle h and declination d. East: `cos d`,
//! `1`, `sin d`,
//! `sin h sin d`, `cos h sin d`, `sin h`; north: `1`, `cos h`, `sin h`, `sin d`, `cos d`, `cos h sin d`. Each coefficient
//! is held to a size that mounts have (ridge regression), so that a few points in one corner of the sky say little about
//! the others; points that do not fit weigh less (Huber), and wild ones nothing.

use units::Angle;

use super::Miss;
use crate::least_squares::LeastSquares;

/// A mount's error at one place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MountErrorPoint {
    /// Hour angle of the commanded direction.
    pub hour_angle: Angle,
    /// Declination of the commanded direction.
    pub dec: Angle,
    /// What the telescope missed it by.
    pub miss: Miss,
}

/// Terms per axis.
const TERMS: usize = 6;
/// Fewest points that make a model.
pub const FEWEST: usize = 3;
/// What an index may be off, arcmin; wide, so that the first points fix it.
const INDEX_ARCMIN: f64 = 120.0;
/// What the other terms may be, arcmin: a polar axis of an amateur's mount, or a tube that bends.
const OTHER_ARCMIN: f64 = 10.0;
/// What no model can know, arcmin: repeatability, refraction, the solve itself.
const NOISE_ARCMIN: f64 = 0.1;
/// From so many times the usual residual on, a point weighs less (Huber 1964: 1.345 keeps 95 % efficiency).
const HUBER: f64 = 1.345;
/// From so many times on, it is of another field, and does not count.
const WILD: f64 = 5.0;
/// Rounds of weighing anew; in the second half wild points are left out.
const ROUNDS: usize = 10;

/// A mount's error over the sky, on one side of its pier.
#[derive(Debug, Clone, PartialEq)]
pub struct MountErrorModel {
    east_arcmin: [f64; TERMS],
    north_arcmin: [f64; TERMS],
    rms_arcmin: f64,
}

impl MountErrorModel {
    /// Learns from points; None from fewer than [`FEWEST`], and where numbers are not finite.
    pub fn fit(points: &[MountErrorPoint]) -> Option<Self> {
        if points.len() < FEWEST {
            return None;
        }
        let mut weights = vec![1.0; points.len()];
        let mut model = Self::weighted(points, &weights)?;
        for round in 0..ROUNDS {
            let residuals: Vec<f64> = points.iter().map(|point| model.residual(point).size_arcmin()).collect();
            let mut sorted = residuals.clone();
            sorted.sort_by(f64::total_cmp);
            // of two axes together the median is 1.18 sigma of one
            let usual = (sorted[sorted.len() / 2] / 1.18).max(NOISE_ARCMIN);
            for (weight, residual) in weights.iter_mut().zip(&residuals) {
                let is_wild = round >= ROUNDS / 2 && *residual > WILD * usual;
                *weight = if is_wild { 0.0 } else { (HUBER * usual / residual.max(1e-9)).min(1.0) };
            }
            model = Self::weighted(points, &weights)?;
        }
        let total: f64 = weights.iter().sum();
        let squares = points.iter().zip(&weights).map(|(point, w)| w * model.residual(point).size_arcmin().powi(2));
        model.rms_arcmin = (squares.sum::<f64>() / total).sqrt();
        model.rms_arcmin.is_finite().then_some(model)
    }

    fn weighted(points: &[MountErrorPoint], weights: &[f64]) -> Option<Self> {
        let (mut east, mut north) = (LeastSquares::new(), LeastSquares::new());
        for term in 0..TERMS {
            let size = if term == 0 { INDEX_ARCMIN } else { OTHER_ARCMIN };
            let mut row = [0.0; TERMS];
            row[term] = 1.0;
            east.add(row, 0.0, (NOISE_ARCMIN / size).powi(2));
            north.add(row, 0.0, (NOISE_ARCMIN / size).powi(2));
        }
        for (point, weight) in points.iter().zip(weights) {
            let (east_row, north_row) = terms(point.hour_angle, point.dec);
            east.add(east_row, point.miss.east.degrees() * 60.0, *weight);
            north.add(north_row, point.miss.north.degrees() * 60.0, *weight);
        }
        Some(Self { east_arcmin: east.solve()?, north_arcmin: north.solve()?, rms_arcmin: 0.0 })
    }

    /// What the telescope is expected to miss a commanded direction by.
    pub fn miss(&self, hour_angle: Angle, dec: Angle) -> Miss {
        let (east, north) = terms(hour_angle, dec);
        let sum = |row: [f64; TERMS], of: &[f64; TERMS]| row.iter().zip(of).map(|(a, b)| a * b).sum::<f64>() / 60.0;
        Miss {
            east: Angle::from_degrees(sum(east, &self.east_arcmin)),
            north: Angle::from_degrees(sum(north, &self.north_arcmin)),
        }
    }

    /// Root of the mean squared distance of the points from the model, both axes together, arcmin; points that do not
    /// fit count less or not at all.
    pub fn rms_arcmin(&self) -> f64 {
        self.rms_arcmin
    }

    fn residual(&self, point: &MountErrorPoint) -> Miss {
        let expected = self.miss(point.hour_angle, point.dec);
        Miss { east: point.miss.east - expected.east, north: point.miss.north - expected.north }
    }
}

impl Miss {
    fn size_arcmin(&self) -> f64 {
        self.size().degrees() * 60.0
    }
}

fn terms(hour_angle: Angle, dec: Angle) -> ([f64; TERMS], [f64; TERMS]) {
    let (sin_h, cos_h) = hour_angle.radians().sin_cos();
    let (sin_d, cos_d) = dec.radians().sin_cos();
    ([cos_d, 1.0, sin_d, sin_h * sin_d, cos_h * sin_d, sin_h], [1.0, cos_h, sin_h, sin_d, cos_d, cos_h * sin_d])
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    /// A mount with all usual faults, some 5 arcmin in size.
    fn truth(h_deg: f64, d_deg: f64) -> (f64, f64) {
        let (sin_h, cos_h) = h_deg.to_radians().sin_cos();
        let (sin_d, cos_d) = d_deg.to_radians().sin_cos();
        (3.0 * cos_d + 1.0 + 1.2 * sin_h * sin_d + 0.4 * cos_h * sin_d, -2.5 + 1.2 * cos_h + sin_d - 0.4 * sin_h)
    }

    fn point(h_deg: f64, d_deg: f64, off_arcmin: (f64, f64)) -> MountErrorPoint {
        let (east, north) = truth(h_deg, d_deg);
        let arcmin = |arcmin: f64| Angle::from_degrees(arcmin / 60.0);
        let miss = Miss { east: arcmin(east + off_arcmin.0), north: arcmin(north + off_arcmin.1) };
        MountErrorPoint { hour_angle: Angle::from_degrees(h_deg), dec: Angle::from_degrees(d_deg), miss }
    }

    fn worst(model: &MountErrorModel, h_deg: std::ops::Range<i32>, d_deg: std::ops::Range<i32>) -> f64 {
        let places = h_deg.step_by(10).flat_map(|h| d_deg.clone().step_by(10).map(move |d| (h, d)));
        let off = places.map(|(h, d)| model.residual(&point(f64::from(h), f64::from(d), (0.0, 0.0))).size_arcmin());
        off.fold(0.0, f64::max)
    }

    #[test]
    fn fifty_points_over_the_sky_give_the_error_anywhere_and_wild_ones_do_not_matter() {
        for seed in 0..20 {
            let mut chance = rand::rngs::StdRng::seed_from_u64(seed);
            let mut points: Vec<MountErrorPoint> = Vec::new();
            for n in 0..50 {
                let mut noise = || chance.random_range(-0.15..0.15);
                let off = (noise(), noise());
                // every eighth solve is of another field
                let off = if n % 8 == 0 { (40.0, -25.0) } else { off };
                points.push(point(chance.random_range(-60.0..60.0), chance.random_range(-70.0..30.0), off));
            }
            let model = MountErrorModel::fit(&points).unwrap();
            assert!(worst(&model, -60..61, -70..31) < 0.5, "seed {seed}: {}", worst(&model, -60..61, -70..31));
            assert!(model.rms_arcmin() < 0.3, "seed {seed}: {}", model.rms_arcmin());
        }
    }

    #[test]
    fn a_few_points_help_near_them_and_do_no_harm_elsewhere() {
        let points = [(-20.0, -30.0), (-10.0, -20.0), (-25.0, -10.0)].map(|(h, d)| point(h, d, (0.05, -0.05)));
        let model = MountErrorModel::fit(&points).unwrap();
        assert!(worst(&model, -30..1, -40..1) < 0.7, "{}", worst(&model, -30..1, -40..1));
        // without a model the worst is 5.4 arcmin
        assert!(worst(&model, -60..61, -70..31) < 4.0, "{}", worst(&model, -60..61, -70..31));
    }

    #[test]
    fn too_few_points_or_no_numbers_make_no_model() {
        let two = [point(0.0, 0.0, (0.0, 0.0)), point(10.0, 0.0, (0.0, 0.0))];
        assert_eq!(MountErrorModel::fit(&two), None);
        let nan = point(f64::NAN, 0.0, (0.0, 0.0));
        assert_eq!(MountErrorModel::fit(&[two[0], two[1], nan]), None);
        // all at one place: no more than an index
        let same = MountErrorModel::fit(&[two[0]; 40]).unwrap();
        assert!(same.residual(&two[0]).size_arcmin() < 0.01);
    }
}
