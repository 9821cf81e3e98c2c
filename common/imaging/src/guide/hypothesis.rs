//! One opinion of how a mount's axis wanders: a Kalman filter with its noise and, perhaps, a worm's period.
//!
//! State: place (px), drift (px/s), and the two components of a sine (px) whose period is part of the opinion.
//! `place' = place + drift dt`; the sine turns by `2 pi dt / period`; what is measured is place + sine. Without a
//! period the last two stay zero. Process noise: random walks of place, drift and sine; the measurement's own error
//! and the air's jitter add. (Kalman 1960, J. Basic Eng. 82, 35.)

use std::f64::consts::TAU;

/// What is assumed of an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Assumption {
    /// Motion of the star by air and wind that is new in every frame, px.
    pub(super) jitter_px: f64,
    /// Random walk of the place, px per square root of a second.
    pub(super) walk_px: f64,
    /// Random walk of the drift, px/s per square root of a second.
    pub(super) drift_walk_px_s: f64,
    /// Period of the worm, s; None where there is none.
    pub(super) period_s: Option<f64>,
}

/// Standard deviations of what is believed before anything was seen: place (px), drift (px/s), sine (px).
const PRIOR: [f64; 4] = [20.0, 0.1, 5.0, 5.0];
/// Random walk of the sine's components, px per square root of a second: a worm's error is not quite a sine.
const SINE_WALK_PX: f64 = 0.01;

/// An assumption with what follows from it.
#[derive(Debug, Clone)]
pub(super) struct Hypothesis {
    assumption: Assumption,
    state: [f64; 4],
    covariance: [[f64; 4]; 4],
}

impl Hypothesis {
    pub(super) fn new(assumption: Assumption, place_px: f64) -> Self {
        let mut covariance = [[0.0; 4]; 4];
        let known = if assumption.period_s.is_some() { 4 } else { 2 };
        (0..known).for_each(|n| covariance[n][n] = PRIOR[n].powi(2));
        Self { assumption, state: [place_px, 0.0, 0.0, 0.0], covariance }
    }

    /// Lets time pass, s. Place and drift do not mix with the sine, so the covariance is moved in blocks of 2 x 2.
    pub(super) fn advance(&mut self, dt_s: f64) {
        let on = [[1.0, dt_s], [0.0, 1.0]];
        self.turn(0, 0, &on, &on);
        [self.state[0], self.state[1]] = times(&on, [self.state[0], self.state[1]]);
        let (walk, drift) = (self.assumption.walk_px.powi(2), self.assumption.drift_walk_px_s.powi(2));
        let noise = &mut self.covariance;
        noise[0][0] += walk * dt_s + drift * dt_s.powi(3) / 3.0;
        noise[0][1] += drift * dt_s.powi(2) / 2.0;
        noise[1][0] += drift * dt_s.powi(2) / 2.0;
        noise[1][1] += drift * dt_s;
        if let Some(period_s) = self.assumption.period_s {
            let (sin, cos) = (TAU * dt_s / period_s).sin_cos();
            let round = [[cos, sin], [-sin, cos]];
            self.turn(0, 2, &on, &round);
            self.turn(2, 2, &round, &round);
            [self.state[2], self.state[3]] = times(&round, [self.state[2], self.state[3]]);
            let noise = &mut self.covariance;
            (noise[2][2], noise[3][3]) =
                (noise[2][2] + SINE_WALK_PX.powi(2) * dt_s, noise[3][3] + SINE_WALK_PX.powi(2) * dt_s);
            for (row, column) in [(0, 2), (0, 3), (1, 2), (1, 3)] {
                noise[column][row] = noise[row][column];
            }
        }
    }

    /// The block of the covariance that begins at (row, column) becomes `a block b^T`.
    fn turn(&mut self, row: usize, column: usize, a: &[[f64; 2]; 2], b: &[[f64; 2]; 2]) {
        let block = [0, 1].map(|i| [0, 1].map(|j| self.covariance[row + i][column + j]));
        // the rows of (block b^T) are b times the rows of the block
        let right = block.map(|line| times(b, line));
        for (i, [from_first, from_second]) in a.iter().enumerate() {
            let first = from_first * right[0][0] + from_second * right[1][0];
            let second = from_first * right[0][1] + from_second * right[1][1];
            (self.covariance[row + i][column], self.covariance[row + i][column + 1]) = (first, second);
        }
    }

    /// What would be measured in `ahead_s` from now, px.
    pub(super) fn expected_px(&self, ahead_s: f64) -> f64 {
        let [place, drift, sine, cosine] = self.state;
        let turned = self.assumption.period_s.map_or((0.0, 1.0), |period_s| (TAU * ahead_s / period_s).sin_cos());
        place + drift * ahead_s + sine * turned.1 + cosine * turned.0
    }

    /// How fast the axis moves now, sine included, px/s, and the variance of the drift.
    pub(super) fn drift_px_s(&self) -> (f64, f64) {
        let turn = self.assumption.period_s.map_or(0.0, |period_s| TAU / period_s);
        (self.state[1] + turn * self.state[3], self.covariance[1][1])
    }

    /// Variance of a measurement now, with this variance of its own, px^2.
    pub(super) fn variance(&self, measured: f64) -> f64 {
        let p = &self.covariance;
        p[0][0] + p[0][2] + p[2][0] + p[2][2] + self.assumption.jitter_px.powi(2) + measured
    }

    /// Learns from a measurement (px, px^2); answers the logarithm of its likelihood.
    pub(super) fn learn(&mut self, place_px: f64, measured: f64) -> f64 {
        let (surprise, variance) = (place_px - self.expected_px(0.0), self.variance(measured));
        let carried: [f64; 4] = std::array::from_fn(|n| self.covariance[n][0] + self.covariance[n][2]);
        for (i, carried_i) in carried.iter().enumerate() {
            self.state[i] += carried_i / variance * surprise;
            for (j, carried_j) in carried.iter().enumerate() {
                self.covariance[i][j] -= carried_i * carried_j / variance;
            }
        }
        -0.5 * ((surprise * surprise / variance).min(9.0) + (TAU * variance).ln())
    }

    /// Something moved by an unknown way, by so many px: the place is less certain; and the drift, if it may be that
    /// within so many s. What is too fast for a drift was a jump.
    pub(super) fn forget(&mut self, spread_px: f64, within_s: f64) {
        self.covariance[0][0] += spread_px.powi(2);
        if spread_px <= PRIOR[1] * within_s {
            self.covariance[1][1] += (spread_px / within_s).powi(2);
        }
    }

    /// Place and drift were false beliefs; the worm stays.
    pub(super) fn begin_anew(&mut self, place_px: f64) {
        let sine_px = self.expected_px(0.0) - self.state[0];
        (self.state[0], self.state[1]) = (place_px - sine_px, 0.0);
        for (n, prior) in PRIOR.iter().enumerate().take(2) {
            for other in 0..4 {
                (self.covariance[n][other], self.covariance[other][n]) = (0.0, 0.0);
            }
            self.covariance[n][n] = prior.powi(2);
        }
    }

    pub(super) fn is_finite(&self) -> bool {
        self.state.iter().chain(self.covariance.iter().flatten()).all(|value| value.is_finite())
    }

    pub(super) fn assumption(&self) -> Assumption {
        self.assumption
    }
}

fn times(matrix: &[[f64; 2]; 2], vector: [f64; 2]) -> [f64; 2] {
    matrix.map(|[a, b]| a * vector[0] + b * vector[1])
}
