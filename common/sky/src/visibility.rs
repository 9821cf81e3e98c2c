//! The altitudes of a target over a window of time.

use units::{Angle, Utc};

use crate::{EarthOrientation, Icrs, Observer, Place, SkyError};

/// Spacing of the samples, as long as there are not too many.
const STEP_S: f64 = 30.0;
const MOST_SAMPLES: u32 = 2000;
/// For this long, either way, an observer may be turned with the Earth instead of being built anew.
const TURN_S: f64 = 1800.0;

/// The lowest point of a target within a window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LowestAltitude {
    /// Not refracted.
    pub altitude: Angle,
    /// The time at which it is there; the first one, when there are several.
    pub at: Utc,
}

/// The lowest altitude of a fixed target from `start` to `end`, both included; sampled as [`altitudes`] does.
pub fn lowest_altitude(
    place: &Place,
    orientation: &EarthOrientation,
    target: &Icrs,
    start: Utc,
    end: Utc,
) -> Result<LowestAltitude, SkyError> {
    let target = target.checked()?;
    let samples = altitudes(place, orientation, start, end, |_| target)?;
    samples
        .into_iter()
        .map(|(at, altitude)| LowestAltitude { altitude, at })
        .reduce(|lowest, sample| if sample.altitude < lowest.altitude { sample } else { lowest })
        .ok_or(SkyError::Window { start, end })
}

/// Altitudes (not refracted) of a target that may move, evenly from `start` to `end`, both included.
///
/// Every 30 s, at least 2 and at most 2000 samples; to 0.1 arcsec.
pub fn altitudes(
    place: &Place,
    orientation: &EarthOrientation,
    start: Utc,
    end: Utc,
    mut target: impl FnMut(Utc) -> Icrs,
) -> Result<Vec<(Utc, Angle)>, SkyError> {
    if end < start {
        return Err(SkyError::Window { start, end });
    }
    let span_s = end.seconds_since(start);
    let steps = ((span_s / STEP_S).round() as u32).clamp(1, MOST_SAMPLES - 1);
    let mut built = Observer::new(place, orientation, start)?;
    (0..=steps)
        .map(|step| {
            let at = if step == steps { end } else { start.plus_seconds(span_s * f64::from(step) / f64::from(steps)) };
            if at.seconds_since(built.at()) > TURN_S {
                built = Observer::new(place, orientation, at)?;
            }
            Ok((at, built.turned_to(at)?.to_horizontal(&target(at)).altitude))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paranal() -> Place {
        Place::new(Angle::from_degrees(-24.6157), Angle::from_degrees(-70.3976), 2518.0).unwrap()
    }

    fn utc(text: &str) -> Utc {
        text.parse().unwrap()
    }

    #[test]
    fn a_setting_star_is_lowest_at_the_end_and_a_rising_one_at_the_start() {
        let (start, end) = (utc("2026-11-21T03:00:00Z"), utc("2026-11-21T06:00:00Z"));
        let earth = EarthOrientation::default();
        let observer = Observer::new(&paranal(), &earth, start).unwrap();
        for (azimuth_deg, expected) in [(270.0, end), (90.0, start)] {
            let star = observer.to_icrs(&crate::Horizontal::from_degrees(60.0, azimuth_deg));
            let lowest = lowest_altitude(&paranal(), &earth, &star, start, end).unwrap();
            assert_eq!(lowest.at, expected);
            let exact = Observer::new(&paranal(), &earth, expected).unwrap().to_horizontal(&star).altitude;
            assert!((lowest.altitude - exact).arcseconds().abs() < 0.1, "{lowest:?} {exact:?}");
        }
    }

    #[test]
    fn a_star_that_dips_is_caught_in_between() {
        let (start, end) = (utc("2026-11-21T00:00:00Z"), utc("2026-11-21T23:00:00Z"));
        let star = Icrs::from_degrees(200.0, -80.0);
        let lowest = lowest_altitude(&paranal(), &EarthOrientation::default(), &star, start, end).unwrap();
        assert!(start < lowest.at && lowest.at < end);
        // Lower culmination: latitude minus polar distance.
        assert!((lowest.altitude.degrees() - (24.6157 - 10.0)).abs() < 0.2, "{lowest:?}");
    }

    #[test]
    fn samples_are_at_least_two_and_at_most_2000_and_hold_both_ends() {
        let start = utc("2026-11-21T00:00:00Z");
        for (span_s, expected) in [(0.0, 2), (10.0, 2), (300.0, 11), (86_400.0 * 3.0, 2000)] {
            let end = start.plus_seconds(span_s);
            let star = Icrs::from_degrees(10.0, -20.0);
            let samples = altitudes(&paranal(), &EarthOrientation::default(), start, end, |_| star).unwrap();
            assert_eq!(samples.len(), expected, "{span_s}");
            assert_eq!((samples[0].0, samples[expected - 1].0), (start, end));
        }
        let backwards = altitudes(&paranal(), &EarthOrientation::default(), start, start.plus_seconds(-1.0), |_| {
            Icrs::from_degrees(0.0, 0.0)
        });
        assert!(matches!(backwards, Err(SkyError::Window { .. })));
    }

    #[test]
    fn a_target_that_is_no_direction_is_refused_and_not_called_visible() {
        let start = utc("2026-11-21T00:00:00Z");
        let nowhere = Icrs::from_degrees(f64::NAN, 0.0);
        assert!(lowest_altitude(&paranal(), &EarthOrientation::default(), &nowhere, start, start).is_err());
    }
}
