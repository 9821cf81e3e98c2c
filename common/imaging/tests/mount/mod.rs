//! A mount that is not there: drift, worm, Dec backlash, a camera at any angle, pulses that take their time.
#![allow(dead_code)] // each test file uses its part

use std::f64::consts::TAU;

use imaging::guide::{Calibration, Exposure, Guider, Pier, Pulses};
use imaging::shift::{Method, NoShift, Shift};
use rand::{SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, StandardNormal};

/// Sidereal rate, arcsec/s; pulses run at half of it.
pub const GUIDE_RATE_ARCSEC_S: f64 = 0.5 * 15.041;
/// Standard error of a measurement, px.
pub const MEASURED_PX: f64 = 0.05;

#[derive(Debug)]
pub struct Mount {
    pub scale_arcsec_px: f64,
    pub rotation_deg: f64,
    pub mirrored: bool,
    /// Of a star along East and North, px/s on the detector's scale.
    pub drift_px_s: [f64; 2],
    /// Half of the worm's peak-to-peak error, px, and its period, s.
    pub worm: (f64, f64),
    /// Play of the Dec gear, s of pulse, and how much of it is free towards north.
    pub play_s: f64,
    pub free_north_s: f64,
    /// Whether North pulses go south.
    pub dec_reversed: bool,
    /// Pulses: axis, time at which motion begins and ends, signed speed (px/s along the axis).
    moves: Vec<(usize, f64, f64, f64)>,
    /// Motion by pulses before all of `moves`, px.
    before_px: [f64; 2],
    rng: StdRng,
}

impl Mount {
    pub fn new(rotation_deg: f64, seed: u64) -> Self {
        Self {
            scale_arcsec_px: 0.35,
            rotation_deg,
            mirrored: false,
            drift_px_s: [0.0; 2],
            worm: (0.0, 480.0),
            play_s: 0.0,
            free_north_s: 0.0,
            dec_reversed: false,
            moves: Vec::new(),
            before_px: [0.0; 2],
            rng: StdRng::seed_from_u64(seed),
        }
    }

    pub fn speed_px_s(&self) -> f64 {
        GUIDE_RATE_ARCSEC_S / self.scale_arcsec_px
    }

    /// CD matrix of the camera, deg/px.
    pub fn cd(&self) -> [[f64; 2]; 2] {
        let (sin, cos) = self.rotation_deg.to_radians().sin_cos();
        let (scale, parity) = (self.scale_arcsec_px / 3600.0, if self.mirrored { 1.0 } else { -1.0 });
        [[parity * scale * cos, -parity * scale * sin], [scale * sin, scale * cos]]
    }

    /// As a plate solution and the mount's guide rates show it.
    pub fn calibration(&self, pier: Option<Pier>) -> Calibration {
        let rates = [GUIDE_RATE_ARCSEC_S / 3600.0; 2];
        let calibration = Calibration::from_wcs(self.cd(), rates, pier).unwrap();
        Calibration { backlash_s: Some(self.play_s), ..calibration }
    }

    /// Begins pulses at a time, s.
    pub fn pulse(&mut self, begun_s: f64, pulses: Pulses) {
        for (axis, ms) in [pulses.east_ms, pulses.north_ms].into_iter().enumerate() {
            let (side, length_s) = (f64::from(ms.signum()), f64::from(ms.abs()) / 1000.0);
            let mut lost_s = 0.0;
            if axis == 1 {
                lost_s = if side > 0.0 { self.free_north_s } else { self.play_s - self.free_north_s }.min(length_s);
                self.free_north_s -= side * lost_s;
            }
            let reversed = if axis == 1 && self.dec_reversed { -1.0 } else { 1.0 };
            self.moves.push((axis, begun_s + lost_s, begun_s + length_s, reversed * side * self.speed_px_s()));
        }
    }

    /// Slews so that the star moves by this, px on the detector.
    pub fn slew(&mut self, dx_px: f64, dy_px: f64) {
        let cd = self.cd();
        let scale = self.scale_arcsec_px / 3600.0;
        // motion of the star towards west and south is positive along East and North
        let along = cd.map(|[a, b]| -(a * dx_px + b * dy_px) / scale);
        (0..2).for_each(|n| self.before_px[n] += along[n]);
    }

    /// Where the star is at a time, px along East and North.
    fn along(&self, time_s: f64) -> [f64; 2] {
        let worm_px = self.worm.0 * (TAU * time_s / self.worm.1).sin();
        let mut at = [0, 1].map(|n| self.before_px[n] + self.drift_px_s[n] * time_s);
        at[0] += worm_px;
        for (axis, from_s, to_s, speed) in &self.moves {
            at[*axis] += speed * (time_s.min(*to_s) - from_s).max(0.0);
        }
        at
    }

    /// Where a frame sees the star, px on the detector.
    pub fn seen(&self, exposure: Exposure) -> [f64; 2] {
        let step = exposure.length_s / 20.0;
        let start_s = exposure.mid_s - 0.5 * exposure.length_s;
        let times = (0..20).map(|n| start_s + (f64::from(n) + 0.5) * step);
        let sum = times.map(|t| self.along(t)).fold([0.0; 2], |sum, at| [sum[0] + at[0], sum[1] + at[1]]);
        let [[a, b], [c, d]] = self.cd();
        let scale = self.scale_arcsec_px / 3600.0;
        let (xi, eta) = (-sum[0] / 20.0 * scale, -sum[1] / 20.0 * scale);
        let determinant = a * d - b * c;
        [(d * xi - b * eta) / determinant, (a * eta - c * xi) / determinant]
    }

    /// The same, as it is measured.
    pub fn measured(&mut self, exposure: Exposure) -> Shift {
        let seen = self.seen(exposure);
        let mut noise = || MEASURED_PX * Distribution::<f64>::sample(&StandardNormal, &mut self.rng);
        shift(seen[0] + noise(), seen[1] + noise())
    }

    /// Forgets pulses that are over, so that long nights stay cheap.
    pub fn tidy(&mut self, now_s: f64) {
        for (axis, from_s, to_s, speed) in self.moves.extract_if(.., |(_, _, to_s, _)| *to_s < now_s - 300.0) {
            self.before_px[axis] += speed * (to_s - from_s).max(0.0);
        }
    }
}

pub fn shift(dx_px: f64, dy_px: f64) -> Shift {
    let variance = MEASURED_PX * MEASURED_PX;
    Shift {
        dx_px,
        dy_px,
        rotation_deg: 0.0,
        covariance: [[variance, 0.0, 0.0], [0.0, variance, 0.0], [0.0; 3]],
        stars: 20,
        transparency: Some(1.0),
        method: Method::Stars,
    }
}

/// Exposures at a cadence, the last part of which is read-out; pulses are given after it.
pub fn exposure(n: usize, cadence_s: f64) -> Exposure {
    let length_s = (cadence_s - 1.0).max(0.5 * cadence_s);
    Exposure { mid_s: n as f64 * cadence_s + 0.5 * length_s, length_s }
}

/// Guides for so many frames; `see` may hide a frame. Answers where the star was in each, px from the reference.
pub fn guide(
    mount: &mut Mount,
    guider: &mut Guider,
    cadence_s: f64,
    frames: std::ops::Range<usize>,
    see: impl Fn(usize) -> bool,
) -> Vec<[f64; 2]> {
    // measured while the camera reads out
    let read_out_s = cadence_s - exposure(0, cadence_s).length_s;
    guide_late(mount, guider, cadence_s, 0.2 * read_out_s, frames, see)
}

/// The same with pulses that begin so late after the end of an exposure, s.
pub fn guide_late(
    mount: &mut Mount,
    guider: &mut Guider,
    cadence_s: f64,
    late_s: f64,
    frames: std::ops::Range<usize>,
    see: impl Fn(usize) -> bool,
) -> Vec<[f64; 2]> {
    let clouds = NoShift::TooFewStars { reference: 20, check: 0 };
    let mut places = Vec::new();
    for n in frames {
        let exposure = exposure(n, cadence_s);
        places.push(mount.seen(exposure));
        let shift = mount.measured(exposure);
        let decision = guider.step(exposure, if see(n) { Ok(&shift) } else { Err(&clouds) });
        let begun_s = exposure.mid_s + 0.5 * exposure.length_s + late_s;
        mount.pulse(begun_s, decision.pulses);
        guider.report([decision.pulses.east_ms, decision.pulses.north_ms].map(|ms| Some((begun_s, ms))));
        mount.tidy(exposure.mid_s);
    }
    places
}

/// Root of the mean square distance from the reference, px.
pub fn rms(places: &[[f64; 2]]) -> f64 {
    (places.iter().map(|[x, y]| x * x + y * y).sum::<f64>() / places.len() as f64).sqrt()
}
