//! Decides where a mount may be sent: a pure function of its limits, the target and the sky.

use config::MountLimits;
use sky::{Icrs, Observer};

/// Why a target is beyond the mount's limits, with numbers and units; `None` where it is not.
///
/// `meridian_past_min` depends on the pier side, which the mount chooses in a slew; its device node watches it.
pub fn beyond(limits: &MountLimits, target: &Icrs, sky: &Observer) -> Option<String> {
    let (ra, dec) = (target.ra.degrees(), target.dec.degrees());
    let altitude_deg = sky.to_horizontal(target).altitude.degrees();
    // A place that is not a number is beyond the limits.
    if !altitude_deg.is_finite() || altitude_deg < limits.altitude_min_deg {
        let least = limits.altitude_min_deg;
        return Some(format!(
            "ra {ra:.4}, dec {dec:.4} deg stands {altitude_deg:.1} deg high, the limit is {least} deg"
        ));
    }
    let most_h = limits.hour_angle_max_h?;
    let hour_angle_h = sky.hour_angle(target).degrees() / 15.0;
    let is_within = hour_angle_h <= most_h;
    (!is_within)
        .then(|| format!("ra {ra:.4}, dec {dec:.4} deg is at hour angle {hour_angle_h:.3} h, the limit is {most_h} h"))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use sky::{EarthOrientation, Place};
    use units::{Angle, Utc};

    use super::*;

    const LATITUDE_DEG: f64 = -24.6;

    fn sky(hours: f64) -> Observer {
        let place = Place::new(Angle::from_degrees(LATITUDE_DEG), Angle::from_degrees(-70.4), 2500.0).unwrap();
        Observer::new(&place, &EarthOrientation::default(), Utc::from_seconds(1_795_228_200.0 + hours * 3600.0))
            .unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn no_target_within_reach_stands_beyond_a_limit(
            ra in 0.0..360.0_f64, dec in -90.0..90.0_f64, hours in 0.0..8760.0_f64,
            least in -5.0..60.0_f64, most_h in 0.0..12.0_f64,
        ) {
            let limits = MountLimits {
                altitude_min_deg: least, hour_angle_max_h: Some(most_h), meridian_past_min: None,
            };
            let (sky, target) = (sky(hours), Icrs::from_degrees(ra, dec));
            // Independent of the library: the place of date by the cosine rule, good to the minute of aberration and
            // polar motion.
            let of_date = sky.to_of_date(&target);
            let hour_angle = (sky.sidereal_time().degrees() - of_date.ra.degrees()).to_radians();
            let (latitude, dec) = (LATITUDE_DEG.to_radians(), of_date.dec.degrees().to_radians());
            let sine = latitude.sin() * dec.sin() + latitude.cos() * dec.cos() * hour_angle.cos();
            let altitude_deg = sine.asin().to_degrees();
            let hour_angle_h = hour_angle.sin().atan2(hour_angle.cos()).to_degrees() / 15.0;
            let is_outside = altitude_deg < least - 0.1 || (hour_angle_h > most_h + 0.1);
            let is_inside = altitude_deg > least + 0.1 && hour_angle_h < most_h - 0.1;
            let reason = beyond(&limits, &target, &sky);
            prop_assert!(!is_outside || reason.is_some(), "altitude {altitude_deg}, hour angle {hour_angle_h}");
            prop_assert!(!is_inside || reason.is_none(), "{reason:?}: altitude {altitude_deg}, hour angle {hour_angle_h}");
        }
    }

    #[test]
    fn a_target_below_the_limit_is_reported_with_its_altitude() {
        let limits = MountLimits { altitude_min_deg: 89.9, ..MountLimits::default() };
        let why = beyond(&limits, &Icrs::from_degrees(10.0, 60.0), &sky(0.0)).unwrap();
        assert!(why.contains("deg high, the limit is 89.9 deg"), "{why}");
    }

    #[test]
    fn a_place_that_is_no_number_is_out_of_reach() {
        assert!(beyond(&MountLimits::default(), &Icrs::from_degrees(f64::NAN, 0.0), &sky(0.0)).is_some());
    }
}
