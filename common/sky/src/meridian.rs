//! The two meridians of a place: above the pole, where stars culminate, and below it.

use units::Angle;

/// One half of the meridian circle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Meridian {
    /// Through the zenith: hour angle 0.
    Upper,
    /// Below the pole: hour angle 12 h. Circumpolar stars culminate there for the second time.
    Lower,
}

/// The meridian that is nearer at an hour angle, and how far past it that is: from -6 h to 6 h.
pub fn nearest_meridian(hour_angle: Angle) -> (Meridian, Angle) {
    let (upper, lower) = (hour_angle.wrapped_signed(), (hour_angle - Angle::from_hours(12.0)).wrapped_signed());
    if upper.abs().hours() <= lower.abs().hours() { (Meridian::Upper, upper) } else { (Meridian::Lower, lower) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_hour_angle_is_within_six_hours_of_a_meridian() {
        for (hour_angle_h, meridian, past_h) in [
            (0.5, Meridian::Upper, 0.5),
            (-5.5, Meridian::Upper, -5.5),
            (7.0, Meridian::Lower, -5.0),
            (11.75, Meridian::Lower, -0.25),
            (12.5, Meridian::Lower, 0.5),
            (-11.5, Meridian::Lower, 0.5),
            (36.25, Meridian::Lower, 0.25),
            (24.25, Meridian::Upper, 0.25),
        ] {
            let (nearest, past) = nearest_meridian(Angle::from_hours(hour_angle_h));
            assert_eq!(nearest, meridian, "{hour_angle_h} h");
            assert!((past.hours() - past_h).abs() < 1e-9, "{hour_angle_h} h: {} h past", past.hours());
        }
    }
}
