//! What pulses do to the stars on the detector: a 2 x 2 matrix, from pulses ([`pulses`]) or from a plate solution.
//!
//! The columns are the velocities (px/s) of a star's image while the mount is pulsed East and North. East moves the
//! pointing towards greater right ascension, so stars move the other way. The East column shrinks with cos(dec).
//! (docs/formulae.md, "Pulses to pixels".)

mod direction;
mod fit;
mod oddity;
pub mod pulses;

/// The side of the pier on which a German mount carries its tube.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pier {
    /// East of the pier, looking west.
    East,
    /// West of the pier, looking east.
    West,
}

/// What a pulse does to the stars, in px of the frames it was measured on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// A star's velocity (x, y) on the detector during an East pulse at `dec_deg`, px/s.
    pub east_px_s: [f64; 2],
    /// A star's velocity (x, y) on the detector during a North pulse, px/s.
    pub north_px_s: [f64; 2],
    /// Declination for which `east_px_s` holds, degrees.
    pub dec_deg: f64,
    /// Side of the pier for which it holds; None where there is none or nobody knows.
    pub pier: Option<Pier>,
    /// Pulse that is lost when Dec turns round, s; None if nobody measured it.
    pub backlash_s: Option<f64>,
}

/// Why a calibration cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// The numbers show no two directions.
    #[error(
        "calibration: East moves stars by {east_px_s:?} px/s, North by {north_px_s:?}; two different directions \
         with finite speeds are needed, calibrate again"
    )]
    Singular {
        /// East column, px/s.
        east_px_s: [f64; 2],
        /// North column, px/s.
        north_px_s: [f64; 2],
    },
    /// The plate solution or the guide rates cannot be turned round.
    #[error(
        "calibration: no scale in CD matrix {cd_deg:?} with guide rates {rates_deg_s:?} deg/s; give a solved frame's \
         CD matrix and the mount's guide rates"
    )]
    Wcs {
        /// The matrix, deg/px.
        cd_deg: [[f64; 2]; 2],
        /// Guide rates, RA and Dec, deg/s.
        rates_deg_s: [f64; 2],
    },
    /// Calibrated too near to the pole to be used elsewhere.
    #[error("calibrated at dec {calibrated_deg:.1}, too near to the pole for use at {dec_deg:.1}; calibrate below 60")]
    NearPole {
        /// Declination of the calibration, degrees.
        calibrated_deg: f64,
        /// Declination of the field, degrees.
        dec_deg: f64,
    },
    /// Not a declination.
    #[error("declination {0} is not between -90 and 90 degrees")]
    Declination(f64),
}

/// Beyond this a calibration shows nothing about other declinations, degrees (as in PHD2).
const HIGHEST_DEC_DEG: f64 = 60.0;
/// Relative change of cos(dec) that needs no compensation.
const SAME_COSINE: f64 = 0.05;
/// The least cosine that is divided by.
const LEAST_COSINE: f64 = 0.05;
/// Least sine of the angle between the axes.
const LEAST_ANGLE: f64 = 0.1;

impl Calibration {
    /// From a solved frame: the CD matrix (deg/px; rows are towards east and north, columns x and y) and the mount's
    /// guide rates in right ascension and declination, deg/s (ASCOM `GuideRateRightAscension`, `...Declination`).
    ///
    /// # Errors
    /// [`CalibrationError::Wcs`] when the matrix is singular or a rate is not a positive number.
    pub fn from_wcs(
        cd_deg: [[f64; 2]; 2],
        rates_deg_s: [f64; 2],
        pier: Option<Pier>,
    ) -> Result<Self, CalibrationError> {
        let [[a, b], [c, d]] = cd_deg;
        let determinant = a * d - b * c;
        let good = |rate: f64| rate.is_finite() && rate > 0.0;
        // a pixel below a microarcsecond is a fault, not a scale
        if !(determinant.is_finite() && determinant.abs() > 1e-20 && good(rates_deg_s[0]) && good(rates_deg_s[1])) {
            return Err(CalibrationError::Wcs { cd_deg, rates_deg_s });
        }
        let [east, north] = rates_deg_s;
        let calibration = Self {
            // inverse of CD, times the stars' way: (-1, 0) and (0, -1)
            east_px_s: [-d / determinant * east, c / determinant * east],
            north_px_s: [b / determinant * north, -a / determinant * north],
            dec_deg: 0.0,
            pier,
            backlash_s: None,
        };
        calibration.at(0.0).map(|_| calibration)
    }

    /// After the tube went to the other side of the pier: the image turned by 180 degrees. `dec_reversed` says that
    /// the mount leaves its Dec motor as it was, so that North pulses go south there.
    pub fn flipped(&self, dec_reversed: bool) -> Self {
        let [[ex, ey], [nx, ny]] = [self.east_px_s, self.north_px_s];
        let pier = self.pier.map(|pier| if pier == Pier::East { Pier::West } else { Pier::East });
        let north_px_s = if dec_reversed { [nx, ny] } else { [-nx, -ny] };
        Self { east_px_s: [-ex, -ey], north_px_s, pier, ..*self }
    }

    /// For frames whose pixels are `factor` times as large.
    pub fn rebinned(&self, factor: f64) -> Self {
        let scaled = |v: [f64; 2]| v.map(|component| component / factor);
        Self { east_px_s: scaled(self.east_px_s), north_px_s: scaled(self.north_px_s), ..*self }
    }

    /// The rates at a declination (degrees).
    ///
    /// # Errors
    /// [`CalibrationError::NearPole`] when it was made above 60 degrees and cos(dec) differs by more than 5 %;
    /// [`CalibrationError::Singular`] when the axes are parallel, or a number is not finite.
    pub fn at(&self, dec_deg: f64) -> Result<Rates, CalibrationError> {
        if !(-90.0..=90.0).contains(&dec_deg) {
            return Err(CalibrationError::Declination(dec_deg));
        }
        let cosine = |dec_deg: f64| dec_deg.to_radians().cos().max(LEAST_COSINE);
        let ratio = cosine(dec_deg) / cosine(self.dec_deg);
        if self.dec_deg.abs() > HIGHEST_DEC_DEG && (ratio - 1.0).abs() > SAME_COSINE {
            return Err(CalibrationError::NearPole { calibrated_deg: self.dec_deg, dec_deg });
        }
        Rates::new(self.east_px_s.map(|v| v * ratio), self.north_px_s)
    }
}

/// The calibration for a side of the pier: made there, or on an unknown side, or on the other side and turned round.
pub fn for_side(made: &[Calibration], pier: Option<Pier>, dec_reversed: bool) -> Option<Calibration> {
    // newest last
    let of = |side: Option<Pier>| made.iter().rev().find(|calibration| calibration.pier == side).copied();
    match pier {
        None => made.last().copied(),
        Some(side) => {
            let other = if side == Pier::East { Pier::West } else { Pier::East };
            of(pier).or_else(|| of(None)).or_else(|| of(Some(other)).map(|other| other.flipped(dec_reversed)))
        }
    }
}

/// What pulses do at one declination: from motions on the detector (x, y) to motions along the axes (East, North)
/// and back. Along an axis, px are those by which a pulse in that direction moves a star.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rates {
    /// Unit vectors of the motions by East and by North pulses, as columns.
    directions: [[f64; 2]; 2],
    /// Their inverse.
    inverse: [[f64; 2]; 2],
    speeds: [f64; 2],
}

impl Rates {
    fn new(east_px_s: [f64; 2], north_px_s: [f64; 2]) -> Result<Self, CalibrationError> {
        let speeds = [east_px_s[0].hypot(east_px_s[1]), north_px_s[0].hypot(north_px_s[1])];
        let [e, n] = [east_px_s.map(|v| v / speeds[0]), north_px_s.map(|v| v / speeds[1])];
        let determinant = e[0] * n[1] - e[1] * n[0];
        let is_good = speeds.iter().all(|speed| speed.is_finite() && *speed > 1e-6);
        if !(is_good && determinant.abs() >= LEAST_ANGLE) {
            return Err(CalibrationError::Singular { east_px_s, north_px_s });
        }
        let inverse = [[n[1] / determinant, -n[0] / determinant], [-e[1] / determinant, e[0] / determinant]];
        Ok(Self { directions: [[e[0], n[0]], [e[1], n[1]]], inverse, speeds })
    }

    /// How fast pulses move stars along East and North, px/s.
    pub fn speeds_px_s(&self) -> [f64; 2] {
        self.speeds
    }

    /// Pulses of an axis (0: East, 1: North) go the other way.
    pub(super) fn turn_round(&mut self, axis: usize) {
        self.directions.iter_mut().for_each(|row| row[axis] = -row[axis]);
        self.inverse[axis] = self.inverse[axis].map(|v| -v);
    }

    /// A motion (x, y) on the detector as motions along East and North, px.
    pub fn along_axes(&self, on_detector: [f64; 2]) -> [f64; 2] {
        times(&self.inverse, on_detector)
    }

    /// Motions along East and North as one on the detector (x, y), px.
    pub fn on_detector(&self, along_axes: [f64; 2]) -> [f64; 2] {
        times(&self.directions, along_axes)
    }

    /// Variances along East and North of a motion with this covariance on the detector, px^2.
    pub fn variances(&self, covariance: &[[f64; 3]; 3]) -> [f64; 2] {
        self.inverse.map(|[x, y]| {
            x * x * covariance[0][0] + x * y * (covariance[0][1] + covariance[1][0]) + y * y * covariance[1][1]
        })
    }
}

fn times(matrix: &[[f64; 2]; 2], vector: [f64; 2]) -> [f64; 2] {
    matrix.map(|[a, b]| a * vector[0] + b * vector[1])
}

#[cfg(test)]
mod tests;
