//! Decides when a German mount has to flip to the other side of its pier: past the meridian, and for stars that do not set
//! past the lower meridian too.

use contract::device::telescope::PierSide;
use sky::{Meridian, nearest_meridian};
use units::Angle;

/// Looks a mount on this side over its pier, so long past the nearest meridian, min?
pub fn is_past(side: Option<PierSide>, hour_angle: Angle, margin_min: f64) -> bool {
    let (meridian, past) = nearest_meridian(hour_angle);
    let wrong = match meridian {
        Meridian::Upper => PierSide::West,
        Meridian::Lower => PierSide::East,
    };
    side == Some(wrong) && past.hours() * 60.0 > margin_min
}

/// The side on which a mount is after a flip.
pub fn turned(side: PierSide) -> PierSide {
    match side {
        PierSide::West => PierSide::East,
        PierSide::East => PierSide::West,
        PierSide::Unknown => PierSide::Unknown,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_mount_that_looks_back_over_its_pier_is_turned_over_and_only_past_the_margin() {
        let at = |minutes: f64| Angle::from_hours(minutes / 60.0);
        for (side, minutes, due) in [
            (Some(PierSide::West), 5.1, true),
            (Some(PierSide::West), 4.9, false),
            (Some(PierSide::West), -30.0, false),
            (Some(PierSide::West), 359.0, true),
            (Some(PierSide::West), 400.0, false),
            // Below the pole it is the other side: 15 min before, and 5 min past hour angle 12 h.
            (Some(PierSide::East), 705.0, false),
            (Some(PierSide::East), 724.9, false),
            (Some(PierSide::East), 725.1, true),
            (Some(PierSide::East), -714.9, true),
            (Some(PierSide::East), 1079.0, true),
            (Some(PierSide::East), 1120.0, false),
            (Some(PierSide::West), 730.0, false),
            (None, 730.0, false),
            (Some(PierSide::East), 30.0, false),
            (Some(PierSide::Unknown), 30.0, false),
            // A fork, or a mount that does not report its side: it is never slewed for this.
            (None, 30.0, false),
        ] {
            assert_eq!(is_past(side, at(minutes), 5.0), due, "{side:?} {minutes} min");
        }
    }
}
