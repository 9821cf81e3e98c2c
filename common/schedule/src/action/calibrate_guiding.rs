//! `calibrate_guiding`: learns from pulses how they move the stars of a camera, and how much play declination has.

use contract::device::telescope::PierSide;
use imaging::guide::Pier;
use imaging::guide::calibration::pulses;
use schemars::JsonSchema;
use serde::Deserialize;
use sky::{Icrs, Observer};

use super::parameters::{Defocus, LONGEST_S, Metadata, Readout, both, takes_light};
use super::{ActionType, Needs, Parameters, Place};
use crate::wrong::Wrong;

/// Learns from pulses how they move the stars of the row's camera, and how much of a pulse declination loses when it turns
/// round.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct CalibrateGuiding {
    /// Length of a pulse; absent: the way that the stars shall go over its pulses, where scale and guide rates are known,
    /// else 750.
    #[schemars(range(min = 10, max = 60_000), extend("unit" = "ms"))]
    pub pulse_time: Option<u32>,
    /// Exposure time.
    #[serde(default = "one_second")]
    #[schemars(range(min = 0, max = LONGEST_S), extend("unit" = "s"))]
    pub exptime: f64,
    /// Rest between a pulse and the exposure.
    #[serde(default = "one_second")]
    #[schemars(range(min = 0, max = 600), extend("unit" = "s"))]
    pub settle_time: f64,
    /// Pulses in each direction, 4 at least, as far as the stars stay within a quarter of the frame; absent: as many as
    /// bring them 25 px away.
    #[schemars(range(min = 1, max = 60), extend("unit" = "pulses"))]
    pub number_of_cycles: Option<u32>,
    /// Right ascension, ICRS, with `dec`; absent: one hour west of the meridian.
    #[schemars(range(min = -360, max = 360), extend("unit" = "deg"))]
    pub ra: Option<f64>,
    /// Declination, ICRS, with `ra`; absent: the equator.
    #[schemars(range(min = -89, max = 89), extend("unit" = "deg"))]
    pub dec: Option<f64>,
    /// Filter; the one in the beam where absent.
    pub filter: Option<String>,
    /// Where the focuser goes first.
    #[serde(flatten)]
    pub defocus: Defocus,
    /// How the sensor is read.
    #[serde(flatten)]
    pub readout: Readout,
    /// Folder for the files, inside the folder of images.
    pub dir: Option<String>,
    /// For `action_metadata` rows of the FITS-header table.
    #[serde(default)]
    pub metadata: Metadata,
}

/// Steps that the way shall take where the row does not say, and the limits of a pulse that is chosen so, ms.
pub const STEPS: f64 = 10.0;
/// Fewer pulses show no line.
const FEWEST: u32 = 4;
/// Why a row ends whose window was too short.
pub const TOO_LATE: &str = "the window ended before the calibration";
const PULSE_MS: std::ops::RangeInclusive<f64> = 50.0..=5000.0;

fn one_second() -> f64 {
    1.0
}

impl CalibrateGuiding {
    /// Where to calibrate: pulses in right ascension move the stars fastest at the equator.
    ///
    /// # Errors
    /// In words, where the place is below the horizon or is none.
    pub fn target(&self, observer: &Observer) -> Result<Icrs, String> {
        let target = match (self.ra, self.dec) {
            (Some(ra), Some(dec)) => {
                let checked = Icrs::from_degrees(ra, dec).checked();
                checked.map_err(|error| format!("the sky cannot be computed: {error}"))?
            }
            _ => Icrs::from_degrees((observer.sidereal_time().degrees() - 15.0).rem_euclid(360.0), 0.0),
        };
        let altitude_deg = observer.to_horizontal(&target).altitude.degrees();
        if altitude_deg > 0.0 {
            return Ok(target);
        }
        let (ra, dec) = (target.ra.degrees(), target.dec.degrees());
        let below = format!("ra {ra:.4}, dec {dec:.4} deg stands {altitude_deg:.1} deg, below the horizon");
        Err(below)
    }

    /// Binning of both axes.
    pub fn bin(&self) -> f64 {
        f64::from(self.readout.bin)
    }

    /// How to step, so that the stars go their way in as many steps as the row says, or ten, where the guide rates, deg/s, and
    /// the scale, arcsec/px, are known together, the shorter side of the frame, px, and
    /// the side of the pier.
    pub fn settings_of(
        &self,
        known: Option<([f64; 2], f64)>,
        frame_px: Option<u32>,
        side: Option<PierSide>,
        target: &Icrs,
    ) -> pulses::CalibrationSettings {
        let expected_px_s = known.map(|([ra, dec], scale_arcsec_px)| {
            [3600.0 * ra * target.dec.cos() / scale_arcsec_px, 3600.0 * dec / scale_arcsec_px]
        });
        let plain = pulses::CalibrationSettings::default();
        let cycles = self.number_of_cycles.map(|cycles| cycles.max(FEWEST));
        let (steps, way) = (cycles.map(|cycles| cycles as usize), cycles.map_or(STEPS, f64::from));
        let chosen = expected_px_s.map(|[east, north]| 1000.0 * plain.distance_px / way / east.min(north));
        let chosen = chosen.filter(|ms| ms.is_finite()).map(|ms| ms.clamp(*PULSE_MS.start(), *PULSE_MS.end()));
        let pulse_ms = self.pulse_time.or(chosen.map(|ms| ms.round() as u32)).unwrap_or(plain.pulse_ms);
        let distance_px = match (steps, frame_px) {
            (Some(_), Some(frame_px)) => f64::from(frame_px) / 4.0,
            _ => plain.distance_px,
        };
        let dec_deg = target.dec.degrees();
        pulses::CalibrationSettings { pulse_ms, distance_px, steps, dec_deg, pier: pier(side), expected_px_s, ..plain }
    }
}

/// The side of the pier in the words of a guiding calibration.
pub fn pier(side: Option<PierSide>) -> Option<Pier> {
    match side {
        Some(PierSide::East) => Some(Pier::East),
        Some(PierSide::West) => Some(Pier::West),
        Some(PierSide::Unknown) | None => None,
    }
}

impl ActionType for CalibrateGuiding {
    const NAME: &'static str = "calibrate_guiding";
    const EXAMPLE: &'static str = r#"{"filter": "V", "exptime": 2, "pulse_time": 1000}"#;
}

impl Parameters for CalibrateGuiding {
    fn check(&self) -> Result<(), Wrong> {
        self.readout.check()?;
        takes_light(self.exptime)?;
        both("ra", self.ra.is_some(), "dec", self.dec.is_some())
    }

    fn needs(&self) -> Needs {
        Needs { safe: true, mount: true, parallel: false, all_before: false }
    }

    fn azimuth_deg(&self, sky: &Observer) -> Option<f64> {
        self.target(sky).ok().map(|target| sky.to_horizontal(&target).azimuth.degrees())
    }

    fn looks_at(&self) -> Option<Place> {
        let (ra, dec) = self.ra.zip(self.dec)?;
        Some(Place::Icrs(Icrs::from_degrees(ra, dec)))
    }

    fn filters(&self) -> Vec<&str> {
        self.filter.as_deref().into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn action(value: &str) -> Result<CalibrateGuiding, String> {
        crate::action::read_text(value)
    }

    #[test]
    fn it_calibrates_one_hour_west_of_the_meridian_on_the_equator_unless_configured_otherwise() {
        let place = sky::Place::new(units::Angle::from_degrees(-24.6), units::Angle::from_degrees(-70.4), 2600.0);
        let at = "2026-11-21T03:00:00Z".parse().unwrap();
        let observer = Observer::new(&place.unwrap(), &Default::default(), at).unwrap();
        let target = action("{}").unwrap().target(&observer).unwrap();
        let hour_angle_deg = observer.hour_angle(&target).wrapped_signed().degrees();
        // the difference is that of J2000 and date
        assert!((hour_angle_deg - 15.0).abs() < 0.6 && target.dec.degrees() == 0.0, "{hour_angle_deg}");
        let chosen = action(r#"{"ra": 45.0, "dec": -24.6}"#).unwrap().target(&observer).unwrap();
        assert_eq!((chosen.ra.degrees(), chosen.dec.degrees()), (45.0, -24.6));
        let below = action(r#"{"ra": 45.0, "dec": 80.0}"#).unwrap().target(&observer);
        assert!(below.unwrap_err().contains("below the horizon"));
    }

    #[test]
    fn parameters_that_no_mount_can_follow_are_refused_by_name() {
        for (value, name) in [
            (r#"{"pulse_time": 0}"#, "pulse_time"),
            (r#"{"exptime": -1}"#, "exptime"),
            (r#"{"settle_time": 1e9}"#, "settle_time"),
            (r#"{"ra": 10}"#, "ra"),
        ] {
            assert!(action(value).unwrap_err().starts_with(name), "{value}");
        }
        assert!(action(r#"{"number_of_cycles": 10, "pulse_time": 5000, "focus_shift": 10}"#).is_ok());
    }
}
