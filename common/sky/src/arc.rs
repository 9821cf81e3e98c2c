//! A stretch of the compass.

use units::Angle;

/// Azimuths from one through east to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arc {
    /// Where it begins, degrees; any turn.
    from_deg: f64,
    /// Its length, [0, 360] deg.
    width_deg: f64,
}

impl Arc {
    /// All directions.
    pub const FULL: Self = Self { from_deg: -180.0, width_deg: 360.0 };

    /// So far to both sides of a middle; all directions from 180 deg on.
    pub fn around(middle: Angle, half_width: Angle) -> Self {
        let half_deg = half_width.degrees().clamp(0.0, 180.0);
        Self { from_deg: middle.degrees() - half_deg, width_deg: 2.0 * half_deg }
    }

    /// Its length, [0, 360] deg.
    pub fn width(&self) -> Angle {
        Angle::from_degrees(self.width_deg)
    }

    /// Its middle, [0, 360) deg.
    pub fn middle(&self) -> Angle {
        Angle::from_degrees(self.middle_deg()).wrapped_positive()
    }

    /// Does a direction lie in it? Both ends do.
    pub fn contains(&self, azimuth: Angle) -> bool {
        // A hair, so that an end found by arithmetic lies in its own arc.
        const HAIR_DEG: f64 = 1e-9;
        let past_deg = Angle::from_degrees(azimuth.degrees() - self.from_deg + HAIR_DEG).wrapped_positive().degrees();
        self.is_full() || past_deg <= self.width_deg + 2.0 * HAIR_DEG
    }

    /// The direction in it that is nearest to another one, [0, 360) deg.
    pub fn nearest(&self, azimuth: Angle) -> Angle {
        if self.contains(azimuth) {
            return azimuth.wrapped_positive();
        }
        let off = (azimuth - Angle::from_degrees(self.middle_deg())).wrapped_signed().degrees();
        Angle::from_degrees(self.middle_deg() + 0.5 * self.width_deg * off.signum()).wrapped_positive()
    }

    /// Without so much at both ends, but never without more than 0.4 of it at each: something is left. All directions
    /// stay all directions.
    pub fn shrunk(&self, by: Angle) -> Self {
        if self.is_full() {
            return *self;
        }
        let by_deg = by.degrees().clamp(0.0, 0.4 * self.width_deg);
        Self { from_deg: self.from_deg + by_deg, width_deg: self.width_deg - 2.0 * by_deg }
    }

    /// The part that both have in common. Two wide arcs may meet at both ends: then the part nearer to this one's
    /// middle.
    pub fn intersection(&self, other: &Self) -> Option<Self> {
        if self.is_full() {
            return Some(*other);
        }
        if other.is_full() {
            return Some(*self);
        }
        let away = Angle::from_degrees(other.middle_deg() - self.middle_deg()).wrapped_signed().degrees();
        let other_from_deg = self.middle_deg() + away - 0.5 * other.width_deg;
        let from_deg = self.from_deg.max(other_from_deg);
        let to_deg = (self.from_deg + self.width_deg).min(other_from_deg + other.width_deg);
        (from_deg <= to_deg).then_some(Self { from_deg, width_deg: to_deg - from_deg })
    }

    fn is_full(&self) -> bool {
        self.width_deg >= 360.0
    }

    fn middle_deg(&self) -> f64 {
        self.from_deg + 0.5 * self.width_deg
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn deg(degrees: f64) -> Angle {
        Angle::from_degrees(degrees)
    }

    #[test]
    fn an_arc_over_north_holds_both_sides_of_it() {
        let arc = Arc::around(deg(355.0), deg(10.0));
        for (azimuth, inside) in [(345.0, true), (0.0, true), (5.0, true), (365.0, true), (5.1, false), (180.0, false)]
        {
            assert_eq!(arc.contains(deg(azimuth)), inside, "{azimuth}");
        }
        assert!((arc.nearest(deg(50.0)) - deg(5.0)).abs().degrees() < 1e-9);
        assert!((arc.nearest(deg(200.0)) - deg(345.0)).abs().degrees() < 1e-9);
        assert!(arc.contains(arc.nearest(deg(123.0))));
    }

    #[test]
    fn arcs_meet_whatever_turn_they_are_written_in() {
        let meet = Arc::around(deg(350.0), deg(20.0)).intersection(&Arc::around(deg(370.0), deg(10.0))).unwrap();
        assert!((meet.middle() - deg(5.0)).abs().degrees() < 1e-9 && (meet.width().degrees() - 10.0).abs() < 1e-9);
        assert_eq!(Arc::around(deg(0.0), deg(10.0)).intersection(&Arc::around(deg(180.0), deg(10.0))), None);
        let arc = Arc::around(deg(0.0), deg(10.0));
        assert_eq!((Arc::FULL.intersection(&arc), arc.intersection(&Arc::FULL)), (Some(arc), Some(arc)));
        assert!(Arc::FULL.contains(deg(77.0)) && Arc::FULL.shrunk(deg(5.0)) == Arc::FULL);
    }

    #[test]
    fn shrinking_leaves_something_in_the_middle() {
        let arc = Arc::around(deg(90.0), deg(5.0));
        assert_eq!(arc.shrunk(deg(1.0)), Arc::around(deg(90.0), deg(4.0)));
        let left = arc.shrunk(deg(100.0));
        assert!(left.contains(deg(90.0)) && (left.width().degrees() - 2.0).abs() < 1e-9);
    }
}
