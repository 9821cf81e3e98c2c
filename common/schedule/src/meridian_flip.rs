//! Decides when a German mount has to flip to the other side of its pier.

use contract::device::telescope::PierSide;
use units::Angle;

/// Past the pole below it a mount that looks east moves away from its pier: nothing is to be turned over there.
const HIGHEST_H: f64 = 6.0;

/// Looks a mount on this side over its pier, so long past the meridian, min?
pub fn is_past(side: Option<PierSide>, hour_angle: Angle, margin_min: f64) -> bool {
    let past_h = hour_angle.wrapped_signed().hours();
    side == Some(PierSide::West) && past_h * 60.0 > margin_min && past_h < HIGHEST_H
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_mount_that_looks_east_is_turned_over_and_only_past_the_margin() {
        let at = |minutes: f64| Angle::from_hours(minutes / 60.0);
        for (side, minutes, due) in [
            (Some(PierSide::West), 5.1, true),
            (Some(PierSide::West), 4.9, false),
            (Some(PierSide::West), -30.0, false),
            (Some(PierSide::West), 359.0, true),
            (Some(PierSide::West), 400.0, false),
            (Some(PierSide::East), 30.0, false),
            (Some(PierSide::Unknown), 30.0, false),
            // A fork, or a mount that does not report its side: it is never slewed for this.
            (None, 30.0, false),
        ] {
            assert_eq!(is_past(side, at(minutes), 5.0), due, "{side:?} {minutes} min");
        }
    }
}
