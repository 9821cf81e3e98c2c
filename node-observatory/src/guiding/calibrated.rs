//! Chooses the valid calibration: the one that pulses gave, unless the camera was turned since; else the one of a plate
//! solution; on the other side of the pier either one turned round. Before anything was learned here, the values of the
//! configuration.

use contract::device::telescope::PierSide;
use contract::observatory::{CalibrationSource, GuideCalibration};
use imaging::guide::calibration::for_side;
use imaging::guide::{Calibration, CalibrationError, Pier};
use schedule::action::calibrate_guiding::pier;
use units::Utc;

use super::learned::LearnedGuiding;

/// Directions of the two sources that differ by more than this mean that the camera was turned, degrees.
const TURNED_DEG: f64 = 20.0;

fn side(pier: Option<Pier>) -> Option<PierSide> {
    pier.map(|pier| match pier {
        Pier::East => PierSide::East,
        Pier::West => PierSide::West,
    })
}

/// A calibration for frames of this binning.
pub fn binned(stored: &GuideCalibration, bin: u32) -> Calibration {
    Calibration {
        east_px_s: stored.east_px_per_s,
        north_px_s: stored.north_px_per_s,
        dec_deg: stored.dec_deg,
        pier: pier(stored.pier_side),
        backlash_s: stored.backlash_s,
    }
    .rebinned(f64::from(bin.max(1)))
}

/// A calibration that was made on frames of this binning, as it is kept.
pub fn unbinned(made: &Calibration, bin: u32, source: CalibrationSource, made_utc: Utc) -> GuideCalibration {
    let made = made.rebinned(1.0 / f64::from(bin.max(1)));
    GuideCalibration {
        source,
        made_utc,
        pier_side: side(made.pier),
        dec_deg: made.dec_deg,
        east_px_per_s: made.east_px_s,
        north_px_per_s: made.north_px_s,
        backlash_s: made.backlash_s,
    }
}

/// From a solved frame of this binning (its CD matrix, deg/px) and the mount's guide rates, degrees of right ascension
/// and declination per second.
///
/// # Errors
/// [`CalibrationError`] when matrix or rates give no directions.
pub fn of_solution(
    cd_deg_px: [[f64; 2]; 2],
    rates_deg_s: [f64; 2],
    bin: u32,
    pier_side: Option<PierSide>,
    now: Utc,
) -> Result<GuideCalibration, CalibrationError> {
    let made = Calibration::from_wcs(cd_deg_px, rates_deg_s, pier(pier_side))?;
    Ok(unbinned(&made, bin, CalibrationSource::PlateSolution, now))
}

/// A plate solution shows where north is, and not which way the declination motor turns. Beyond the pole, with the tube
/// west of the pier, a mount that leaves the motor as it was (`dec_reversed`) goes south by North pulses.
pub fn as_the_motor_turns(made: GuideCalibration, dec_reversed: bool) -> GuideCalibration {
    match dec_reversed && made.pier_side == Some(PierSide::West) {
        true => GuideCalibration { north_px_per_s: made.north_px_per_s.map(|v| -v), ..made },
        false => made,
    }
}

impl LearnedGuiding {
    /// The valid calibration of a camera on a side of the pier; with `dec_reversed`, North pulses go south after a
    /// flip.
    pub fn calibration(&self, camera: &str, side: Option<PierSide>, dec_reversed: bool) -> Option<GuideCalibration> {
        let of = |source| best(&self.calibrations_of(camera, source), side, dec_reversed);
        match (of(CalibrationSource::Pulses), of(CalibrationSource::PlateSolution)) {
            (Some(pulses), Some(solved)) if is_turned(&pulses, &solved) && solved.made_utc > pulses.made_utc => {
                // Gear and motor are the same, whatever the camera does, and pulses have shown how they turn.
                let is_reversed = dec_reversed && is_right_handed(&pulses) != is_right_handed(&solved);
                let sense = if is_reversed { -1.0 } else { 1.0 };
                let north_px_per_s = solved.north_px_per_s.map(|v| sense * v);
                Some(GuideCalibration { backlash_s: pulses.backlash_s, north_px_per_s, ..solved })
            }
            (Some(pulses), _) => Some(pulses),
            (None, solved) => solved,
        }
    }
}

/// What pulses do by the configuration, for a side of the pier: measured by other programs, which gave no time.
pub fn configured(start: &config::GuideStart, side: Option<PierSide>, dec_reversed: bool) -> Option<GuideCalibration> {
    let given = GuideCalibration {
        source: CalibrationSource::Pulses,
        made_utc: Utc::EPOCH,
        pier_side: start.pier_side.filter(|side| *side != PierSide::Unknown),
        dec_deg: start.dec_deg,
        east_px_per_s: start.east_px_per_s,
        north_px_per_s: start.north_px_per_s,
        backlash_s: None,
    };
    best(&[given], side, dec_reversed)
}

/// The calibration for a side of the pier out of those that were made, newest last.
fn best(made: &[GuideCalibration], side: Option<PierSide>, dec_reversed: bool) -> Option<GuideCalibration> {
    let newest = made.last()?;
    let all: Vec<Calibration> = made.iter().map(|stored| binned(stored, 1)).collect();
    let chosen = for_side(&all, pier(side), dec_reversed)?;
    let of_side = made.iter().rev().find(|stored| pier(stored.pier_side) == chosen.pier);
    Some(unbinned(&chosen, 1, newest.source, of_side.unwrap_or(newest).made_utc))
}

/// Whether North is a quarter turn from East in the sense from +x to +y; turning the camera leaves that as it is.
fn is_right_handed(made: &GuideCalibration) -> bool {
    let ([east_x, east_y], [north_x, north_y]) = (made.east_px_per_s, made.north_px_per_s);
    east_x * north_y > east_y * north_x
}

/// Whether the East pulses of two calibrations go in clearly different directions.
fn is_turned(a: &GuideCalibration, b: &GuideCalibration) -> bool {
    let angle = |v: [f64; 2]| v[1].atan2(v[0]).to_degrees();
    let apart = (angle(a.east_px_per_s) - angle(b.east_px_per_s) + 180.0).rem_euclid(360.0) - 180.0;
    apart.abs() > TURNED_DEG
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE: f64 = 7.5 / 3600.0;

    /// A camera whose +y is turned by this from north, 1 arcsec/px, solved at a time.
    fn solved(angle_deg: f64, side: PierSide, at_s: f64) -> GuideCalibration {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        let cd = [[-cos / 3600.0, sin / 3600.0], [sin / 3600.0, cos / 3600.0]];
        of_solution(cd, [RATE; 2], 1, Some(side), Utc::from_seconds(at_s)).unwrap()
    }

    fn pulsed(angle_deg: f64, side: PierSide, at_s: f64) -> GuideCalibration {
        let backlash_s = Some(0.4);
        GuideCalibration { source: CalibrationSource::Pulses, backlash_s, ..solved(angle_deg, side, at_s) }
    }

    fn learned(made: &[GuideCalibration]) -> LearnedGuiding {
        let mut learned = LearnedGuiding::default();
        made.iter().for_each(|made| learned.keep_calibration("cam", made.clone()));
        learned
    }

    #[test]
    fn binning_changes_the_speed_and_comes_back() {
        let stored = solved(17.0, PierSide::East, 1.0);
        let halved = binned(&stored, 2);
        let speed = halved.east_px_s[0].hypot(halved.east_px_s[1]);
        assert!((speed - 3.75).abs() < 1e-9, "{speed}");
        let again = unbinned(&halved, 2, stored.source, stored.made_utc);
        let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).abs() < 1e-9 && (a[1] - b[1]).abs() < 1e-9;
        assert!(near(again.east_px_per_s, stored.east_px_per_s) && near(again.north_px_per_s, stored.north_px_per_s));
    }

    #[test]
    fn pulses_go_before_a_solution_unless_the_camera_was_turned_since() {
        let (east, none) = (Some(PierSide::East), learned(&[]).calibration("cam", None, false));
        assert_eq!(none, None);
        let held = learned(&[pulsed(10.0, PierSide::East, 1.0), solved(12.0, PierSide::East, 2.0)]);
        assert_eq!(held.calibration("cam", east, false).unwrap().source, CalibrationSource::Pulses);
        let turned = learned(&[pulsed(10.0, PierSide::East, 1.0), solved(100.0, PierSide::East, 2.0)]);
        let now = turned.calibration("cam", east, false).unwrap();
        assert_eq!((now.source, now.backlash_s), (CalibrationSource::PlateSolution, Some(0.4)));
        // Pulses have shown that North goes south there, so it does after the camera was turned.
        let mirrored = GuideCalibration {
            north_px_per_s: pulsed(10.0, PierSide::East, 1.0).north_px_per_s.map(|v| -v),
            ..pulsed(10.0, PierSide::East, 1.0)
        };
        let reversed = learned(&[mirrored, solved(100.0, PierSide::East, 2.0)]);
        let north =
            |reversed_after_flip| reversed.calibration("cam", east, reversed_after_flip).unwrap().north_px_per_s;
        assert_eq!(north(true), now.north_px_per_s.map(|v| -v));
        assert_eq!(north(false), now.north_px_per_s);
        let older = learned(&[solved(100.0, PierSide::East, 1.0), pulsed(10.0, PierSide::East, 2.0)]);
        assert_eq!(older.calibration("cam", east, false).unwrap().source, CalibrationSource::Pulses);
        assert_eq!(held.calibration("other", east, false), None);
    }

    #[test]
    fn what_the_configuration_knows_holds_on_both_sides_of_the_pier() {
        let start = |pier_side| config::GuideStart {
            east_px_per_s: [14.0, 0.0],
            north_px_per_s: [0.0, -13.0],
            dec_deg: 0.0,
            pier_side,
        };
        let on = |made_on, side, reversed| configured(&start(made_on), side, reversed).unwrap();
        let (east, west) = (Some(PierSide::East), Some(PierSide::West));
        let same = on(east, east, true);
        assert_eq!((same.east_px_per_s, same.north_px_per_s), ([14.0, 0.0], [0.0, -13.0]));
        assert_eq!((same.source, same.made_utc), (CalibrationSource::Pulses, Utc::EPOCH));
        let beyond = on(east, west, true);
        assert_eq!((beyond.east_px_per_s, beyond.north_px_per_s), ([-14.0, -0.0], [0.0, -13.0]));
        assert_eq!(on(east, west, false).north_px_per_s, [-0.0, 13.0]);
        // A mount that does not report its side, or has none.
        assert_eq!(on(east, None, true).east_px_per_s, [14.0, 0.0]);
        assert_eq!(on(None, west, true).east_px_per_s, [14.0, 0.0]);
    }

    #[test]
    fn the_other_side_of_the_pier_is_turned_round_until_it_has_its_own() {
        let one = learned(&[pulsed(0.0, PierSide::East, 1.0)]);
        let west = one.calibration("cam", Some(PierSide::West), false).unwrap();
        let east = one.calibration("cam", Some(PierSide::East), false).unwrap();
        assert_eq!(west.east_px_per_s, east.east_px_per_s.map(|v| -v));
        assert_eq!(west.north_px_per_s, east.north_px_per_s.map(|v| -v));
        assert_eq!((west.pier_side, west.backlash_s), (Some(PierSide::West), Some(0.4)));
        let reversed = one.calibration("cam", Some(PierSide::West), true).unwrap();
        assert_eq!(reversed.north_px_per_s, east.north_px_per_s, "such mounts leave the motor as it was");
        // The same by solved frames alone, of either side.
        let beyond = as_the_motor_turns(solved(180.0, PierSide::West, 1.0), true);
        let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).abs() < 1e-9 && (a[1] - b[1]).abs() < 1e-9;
        assert!(
            near(beyond.north_px_per_s, reversed.north_px_per_s) && near(beyond.east_px_per_s, reversed.east_px_per_s)
        );
        let this_side = as_the_motor_turns(solved(0.0, PierSide::East, 1.0), true);
        assert!(near(this_side.north_px_per_s, east.north_px_per_s), "{this_side:?}");
        let both = learned(&[pulsed(0.0, PierSide::East, 1.0), pulsed(90.0, PierSide::West, 2.0)]);
        let own = both.calibration("cam", Some(PierSide::West), false).unwrap();
        assert!((own.east_px_per_s[0]).abs() < 1e-9, "its own, not the other turned round: {own:?}");
    }
}
