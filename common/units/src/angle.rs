//! An angle that names its unit whenever it is made or read.

use std::ops::{Add, Mul, Neg, Sub};

/// An angle; the unit appears only at constructors and accessors.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Default)]
pub struct Angle {
    degrees: f64,
}

impl Angle {
    /// From degrees.
    pub const fn from_degrees(degrees: f64) -> Self {
        Self { degrees }
    }

    /// From hours of right ascension or hour angle; 1 h = 15 deg.
    pub fn from_hours(hours: f64) -> Self {
        Self::from_degrees(hours * 15.0)
    }

    /// From radians.
    pub fn from_radians(radians: f64) -> Self {
        Self::from_degrees(radians.to_degrees())
    }

    /// From arcseconds.
    pub fn from_arcseconds(arcseconds: f64) -> Self {
        Self::from_degrees(arcseconds / 3600.0)
    }

    /// In degrees.
    pub const fn degrees(self) -> f64 {
        self.degrees
    }

    /// In hours; 15 deg = 1 h.
    pub fn hours(self) -> f64 {
        self.degrees / 15.0
    }

    /// In radians.
    pub fn radians(self) -> f64 {
        self.degrees.to_radians()
    }

    /// In arcseconds.
    pub fn arcseconds(self) -> f64 {
        self.degrees * 3600.0
    }

    /// The same direction in [0, 360) deg, as right ascension and azimuth are written.
    pub fn wrapped_positive(self) -> Self {
        let wrapped = self.degrees.rem_euclid(360.0);
        // rem_euclid of a tiny negative number rounds to 360.0 itself
        Self::from_degrees(if wrapped >= 360.0 { 0.0 } else { wrapped })
    }

    /// The same direction in [-180, 180) deg, as hour angles and differences are written.
    pub fn wrapped_signed(self) -> Self {
        Self::from_degrees((self + Self::from_degrees(180.0)).wrapped_positive().degrees - 180.0)
    }

    /// Size without sign.
    pub fn abs(self) -> Self {
        Self::from_degrees(self.degrees.abs())
    }

    /// Sine.
    pub fn sin(self) -> f64 {
        self.radians().sin()
    }

    /// Cosine.
    pub fn cos(self) -> f64 {
        self.radians().cos()
    }

    /// False for NaN and infinities, which no angle from a device should be.
    pub fn is_finite(self) -> bool {
        self.degrees.is_finite()
    }
}

impl Add for Angle {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self::from_degrees(self.degrees + other.degrees)
    }
}

impl Sub for Angle {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self::from_degrees(self.degrees - other.degrees)
    }
}

impl Neg for Angle {
    type Output = Self;
    fn neg(self) -> Self {
        Self::from_degrees(-self.degrees)
    }
}

impl Mul<f64> for Angle {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        Self::from_degrees(self.degrees * factor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_agree_with_each_other() {
        let angle = Angle::from_hours(5.5);
        assert_eq!(angle.degrees(), 82.5);
        assert_eq!(Angle::from_radians(angle.radians()).degrees(), 82.5);
        assert!((Angle::from_arcseconds(angle.arcseconds()).degrees() - 82.5).abs() < 1e-12);
    }

    #[test]
    fn wrapping_lands_in_the_half_open_interval() {
        assert_eq!(Angle::from_degrees(-1e-18).wrapped_positive().degrees(), 0.0);
        assert_eq!(Angle::from_degrees(725.0).wrapped_positive().degrees(), 5.0);
        assert_eq!(Angle::from_degrees(180.0).wrapped_signed().degrees(), -180.0);
        assert_eq!(Angle::from_degrees(359.0).wrapped_signed().degrees(), -1.0);
    }
}
