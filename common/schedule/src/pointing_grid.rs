//! Places over the sky for a pointing-model run: a spiral from near the zenith down.

use sky::{Horizontal, Icrs, Observer};
use units::Angle;

use crate::horizon_limits::HorizonLimits;

/// Not nearer to the Moon than this.
const MOON: Angle = Angle::from_degrees(20.0);
/// The lowest places, unless the mount's limit is higher, deg.
const LOWEST_DEG: f64 = 30.0;
/// The highest, and how far the spiral goes down from there, deg.
const HIGHEST_DEG: f64 = 85.0;
/// How far along the spiral the next place away from the Moon is looked for.
const STEP: f64 = 0.01;

/// The direction of place `index` of `of`, from 0; keeps clear of the Moon, above the least altitude and above the
/// horizon. None where the spiral has no such place any more.
///
/// `t = sqrt(i / (n - 1))`, altitude `85 - 55 t` deg and not below 30, azimuth `360 sqrt(n / 2) t` deg.
pub fn place(index: u32, of: u32, horizon_limits: &HorizonLimits, moon: &Horizontal) -> Option<Horizontal> {
    let last = f64::from(of.saturating_sub(1)).max(1.0);
    let mut t = (f64::from(index) / last).sqrt();
    // One turn more than the whole spiral is enough to leave the Moon behind.
    while t <= 2.0 {
        let azimuth_deg = (360.0 * (f64::from(of) / 2.0).sqrt() * t).rem_euclid(360.0);
        let lowest_deg = horizon_limits.lowest_deg(azimuth_deg).clamp(LOWEST_DEG, HIGHEST_DEG);
        let altitude_deg = (HIGHEST_DEG - 55.0 * t).max(lowest_deg);
        let place = Horizontal::from_degrees(altitude_deg, azimuth_deg);
        if moon.altitude.degrees() < -1.0 || place.separation(moon) > MOON {
            return Some(place);
        }
        t += STEP;
    }
    None
}

/// The place on the sky now.
pub fn target(index: u32, of: u32, horizon_limits: &HorizonLimits, observer: &Observer) -> Option<Icrs> {
    place(index, of, horizon_limits, &observer.moon()).map(|place| observer.to_icrs(&place))
}

#[cfg(test)]
mod tests {
    use super::*;

    const NO_MOON: Horizontal = Horizontal::from_degrees(-40.0, 0.0);

    #[test]
    fn the_spiral_covers_the_sky_above_30_deg_evenly() {
        let places: Vec<Horizontal> =
            (0..50).map(|n| place(n, 50, &HorizonLimits::default(), &NO_MOON).unwrap()).collect();
        assert!(
            (places[0].altitude.degrees() - 85.0).abs() < 1e-9 && (places[49].altitude.degrees() - 30.0).abs() < 1e-9
        );
        // Everything above the lowest altitude is within 15 deg of a place.
        for altitude in (30..90).step_by(5) {
            for azimuth in (0..360).step_by(10) {
                let here = Horizontal::from_degrees(f64::from(altitude), f64::from(azimuth));
                let near = places.iter().map(|place| place.separation(&here).degrees()).fold(f64::INFINITY, f64::min);
                assert!(near < 15.0, "{altitude} {azimuth}: {near}");
            }
        }
    }

    #[test]
    fn places_keep_clear_of_the_moon_of_the_mounts_limit_and_of_walls() {
        let moon = Horizontal::from_degrees(50.0, 120.0);
        let wall = config::Horizon::new(&[[180.0, 10.0], [200.0, 60.0], [260.0, 60.0], [280.0, 10.0]]).unwrap();
        let horizon_limits = HorizonLimits::new(45.0, Some(wall.clone()));
        for n in 0..50 {
            let clear = place(n, 50, &horizon_limits, &moon).unwrap();
            assert!(clear.separation(&moon) > MOON && clear.altitude.degrees() >= 45.0, "{n}: {clear:?}");
            let wall_deg = wall.altitude_deg(clear.azimuth.degrees());
            assert!(clear.altitude.degrees() > wall_deg, "{n}: {clear:?} behind {wall_deg} deg");
        }
        assert!(place(0, 1, &HorizonLimits::default(), &NO_MOON).is_some(), "one place is near the zenith");
    }
}
