//! Brings a field back that pulses cannot reach: slews by how far it is off.

use std::time::Duration;

use contract::device::telescope::{Capabilities, Command};
use imaging::Solution;
use schedule::Row;
use units::seconds;

use super::calibrated::binned;
use super::pulse::{self, Refused};
use super::session::Session;
use crate::authority::Authority;
use crate::devices::telescope::Mount;

/// Guiding slews no further than this: what is further off is another field, and pointing's business, degrees.
const FURTHEST_DEG: f64 = 2.0;

/// Guide rates in right ascension and declination, degrees of each coordinate per second, if the mount reports them.
pub fn guide_rates(can: &Capabilities) -> Option<[f64; 2]> {
    let good = |rate: &f64| rate.is_finite() && *rate > 0.0;
    let ra = can.guide_rate_ra_deg_per_s.filter(good)?;
    Some([ra, can.guide_rate_dec_deg_per_s.filter(good)?])
}

/// By how much right ascension and declination of the mount must change so that the stars move by this on the detector
/// (px of the frame), degrees. The calibration knows directions and the guide rates the scale.
pub fn offset_deg(session: &Session, rates_deg_s: [f64; 2], [dx_px, dy_px]: [f64; 2]) -> Result<[f64; 2], String> {
    let calibration = binned(&session.calibration, session.field.bin);
    let rates = calibration.at(session.dec_deg).map_err(|error| error.to_string())?;
    let (along_px, speeds) = (rates.along_axes([dx_px, dy_px]), rates.speeds_px_s());
    Ok([0, 1].map(|n| along_px[n] / speeds[n] * rates_deg_s[n]))
}

/// By how much right ascension and declination must change to look where the reference looked, degrees.
pub fn offset_to_reference_deg(session: &Session, solution: &Solution) -> Result<[f64; 2], String> {
    let [ra, dec] = session.centre_deg.ok_or("it is not known where the reference looked")?;
    let east = (ra - solution.ra.degrees() + 180.0).rem_euclid(360.0) - 180.0;
    Ok([east, dec - solution.dec.degrees()])
}

/// Slews by an offset from where the mount reports to be, which its device node lets settle.
///
/// # Errors
/// In words, when it may not be moved, the way is too far, or it does not arrive.
pub async fn slew_by(authority: &Authority, row: &Row, mount: &Mount, [ra, dec]: [f64; 2]) -> Result<(), Refused> {
    if let Some(refused) = pulse::objection(authority, row, mount) {
        return Err(refused);
    }
    let fields = mount
        .instrument
        .fresh()
        .map(|state| state.fields)
        .ok_or("the mount does not report on which side of the pier it is")?;
    let (Some(ra_deg), Some(dec_deg)) = (fields.ra_deg.known(), fields.dec_deg.known()) else {
        return Err("the mount does not report where it points".into());
    };
    let way_deg = (ra * dec_deg.to_radians().cos()).hypot(dec);
    if way_deg.is_nan() || way_deg > FURTHEST_DEG {
        return Err(format!("the field is {way_deg:.2} deg off, more than {FURTHEST_DEG}: point again").into());
    }
    let slew = Command::Slew { ra_deg: (ra_deg + ra).rem_euclid(360.0), dec_deg: (dec_deg + dec).clamp(-90.0, 90.0) };
    let most = seconds(mount.config.slew_timeout_s);
    mount.keep_place(false);
    mount.instrument.execute(slew, most).await.map_err(|error| error.to_string())?;
    let tracking = Command::Track { on: true };
    mount.instrument.execute(tracking, Duration::from_secs(60)).await.map_err(|error| error.to_string())?;
    mount.keep_place(true);
    Ok(())
}

#[cfg(test)]
mod tests {
    use contract::observatory::{CalibrationSource, GuideCalibration, GuideField};
    use imaging::star::{Flags, Star};
    use units::Utc;

    use super::*;

    fn session(dec_deg: f64) -> Session {
        let stars = (0..9).map(|n| Star {
            x_px: 20.0 + 20.0 * f64::from(n % 3),
            y_px: 20.0 + 20.0 * f64::from(n / 3),
            x_error_px: 0.02,
            y_error_px: 0.02,
            flux_adu: 1e5,
            flux_error_adu: 1e3,
            snr: 100.0,
            significance: 80.0,
            peak_adu: 1e4,
            fwhm_px: 3.0,
            ellipticity: 0.0,
            angle_deg: 0.0,
            flags: Flags::default(),
        });
        let field = GuideField {
            object: "x".to_owned(),
            filter: None,
            exposure_s: 1.0,
            camera: "cam".to_owned(),
            pier_side: None,
            bin: 2,
            size_px: [100, 100],
            origin_px: [0, 0],
        };
        // 1 arcsec/px unbinned, half the sidereal rate: North pulses move stars down.
        let calibration = GuideCalibration {
            source: CalibrationSource::Pulses,
            made_utc: Utc::EPOCH,
            pier_side: None,
            dec_deg: 0.0,
            east_px_per_s: [7.5, 0.0],
            north_px_per_s: [0.0, -7.5],
            backlash_s: None,
        };
        let frame = (contract::CommandId("r".to_owned()), Some([359.9, 60.0]));
        Session::new(&Default::default(), field, frame, stars.collect(), calibration, dec_deg).unwrap()
    }

    #[test]
    fn a_field_that_is_off_on_the_detector_asks_for_the_same_way_on_the_sky() {
        let rates = [7.5 / 3600.0; 2];
        // Binned px of 2 arcsec.
        let [ra, dec] = offset_deg(&session(60.0), rates, [30.0, 15.0]).unwrap();
        assert!((ra * 3600.0 - 60.0 / 0.5).abs() < 1e-6, "right ascension is wider at dec 60: {}", ra * 3600.0);
        assert!((dec * 3600.0 + 30.0).abs() < 1e-6, "stars move up when it looks south: {}", dec * 3600.0);
        assert!(offset_deg(&session(0.0), [f64::NAN; 2], [1.0, 1.0]).unwrap()[0].is_nan(), "the slew refuses it");
    }

    #[test]
    fn rates_that_are_none_are_not_counted_with() {
        let rates = |ra, dec| {
            guide_rates(&Capabilities {
                guide_rate_ra_deg_per_s: ra,
                guide_rate_dec_deg_per_s: dec,
                ..Default::default()
            })
        };
        assert_eq!(rates(Some(0.002), Some(0.001)), Some([0.002, 0.001]));
        assert_eq!(rates(Some(0.0), Some(0.001)), None);
        assert_eq!(rates(Some(0.002), None), None);
    }
}
