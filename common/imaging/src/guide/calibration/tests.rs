//! Matrices with a known truth, and a mount that is calibrated step by step.

use super::pulses::{CalibrationRun, CalibrationSettings, Direction, Next, NoCalibration, Warning};
use super::*;

/// CD matrix of a camera turned by `rotation_deg`; `mirrored` as behind a diagonal mirror. deg/px.
fn cd(scale_deg: f64, rotation_deg: f64, mirrored: bool) -> [[f64; 2]; 2] {
    let (sin, cos) = rotation_deg.to_radians().sin_cos();
    let parity = if mirrored { 1.0 } else { -1.0 };
    [[parity * scale_deg * cos, -parity * scale_deg * sin], [scale_deg * sin, scale_deg * cos]]
}

#[test]
fn a_plate_solution_shows_where_pulses_move_the_stars() {
    // north up, east left; 1 arcsec/px, half the sidereal rate
    let rate = 7.5 / 3600.0;
    let calibration = Calibration::from_wcs(cd(1.0 / 3600.0, 0.0, false), [rate, rate], None).unwrap();
    // pointing east = stars move west = right; pointing north = stars move down
    assert!((calibration.east_px_s[0] - 7.5).abs() < 1e-9 && calibration.east_px_s[1].abs() < 1e-9);
    assert!((calibration.north_px_s[1] + 7.5).abs() < 1e-9 && calibration.north_px_s[0].abs() < 1e-9);
    let speeds = calibration.at(60.0).unwrap().speeds_px_s();
    assert!((speeds[0] - 3.75).abs() < 1e-9 && (speeds[1] - 7.5).abs() < 1e-9);
    for rotation in [0.0, 17.0, 45.0, 90.0, 200.0] {
        for mirrored in [false, true] {
            let turned = Calibration::from_wcs(cd(1e-4, rotation, mirrored), [rate, rate], None).unwrap();
            let rates = turned.at(20.0).unwrap();
            let there = rates.along_axes(rates.on_detector([3.0, -2.0]));
            assert!((there[0] - 3.0).abs() < 1e-9 && (there[1] + 2.0).abs() < 1e-9);
            // the motion by an East pulse, seen through the plate solution, is towards west
            let m = cd(1e-4, rotation, mirrored);
            let sky = m.map(|[a, b]| a * turned.east_px_s[0] + b * turned.east_px_s[1]);
            assert!((sky[0] + rate).abs() < 1e-12 && sky[1].abs() < 1e-12, "{rotation} {mirrored}: {sky:?}");
        }
    }
}

#[test]
fn what_cannot_be_turned_round_is_refused() {
    let rate = [1e-3, 1e-3];
    assert!(matches!(Calibration::from_wcs([[0.0; 2]; 2], rate, None), Err(CalibrationError::Wcs { .. })));
    assert!(Calibration::from_wcs(cd(f64::NAN, 0.0, false), rate, None).is_err());
    assert!(Calibration::from_wcs(cd(1e-4, 0.0, false), [0.0, 1e-3], None).is_err());
    let parallel =
        Calibration { east_px_s: [1.0, 1.0], north_px_s: [2.0, 2.01], dec_deg: 0.0, pier: None, backlash_s: None };
    assert!(matches!(parallel.at(0.0), Err(CalibrationError::Singular { .. })));
    let polar = Calibration { east_px_s: [1.0, 0.0], north_px_s: [0.0, 3.0], dec_deg: 70.0, ..parallel };
    assert!(polar.at(70.5).is_ok());
    assert!(matches!(polar.at(30.0), Err(CalibrationError::NearPole { .. })));
    assert!(matches!(polar.at(f64::NAN), Err(CalibrationError::Declination(_))));
    let equator = Calibration { dec_deg: 0.0, ..polar };
    assert!((equator.at(90.0).unwrap().speeds_px_s()[0] - 0.05).abs() < 1e-9, "cos(dec) stays above 0.05");
}

#[test]
fn each_side_of_the_pier_has_its_calibration() {
    let east = Calibration {
        east_px_s: [4.0, 1.0],
        north_px_s: [-1.0, 4.0],
        dec_deg: 10.0,
        pier: Some(Pier::East),
        backlash_s: Some(0.3),
    };
    assert_eq!(for_side(&[east], Some(Pier::East), false), Some(east));
    let west = for_side(&[east], Some(Pier::West), false).unwrap();
    assert_eq!((west.east_px_s, west.north_px_s, west.pier), ([-4.0, -1.0], [1.0, -4.0], Some(Pier::West)));
    assert_eq!(for_side(&[east], Some(Pier::West), true).unwrap().north_px_s, east.north_px_s);
    assert_eq!(west.flipped(false), east);
    let measured = Calibration { pier: Some(Pier::West), ..east };
    assert_eq!(for_side(&[east, measured], Some(Pier::West), false), Some(measured));
    assert_eq!(for_side(&[], None, false), None);
    assert_eq!(east.rebinned(2.0).east_px_s, [2.0, 0.5]);
}

/// A mount that answers pulses: speeds px/s on the detector, and a Dec gear with play.
struct Mount {
    east: [f64; 2],
    north: [f64; 2],
    play_s: f64,
    /// Seconds that the gear still turns freely towards north.
    free_north_s: f64,
    place: [f64; 2],
    /// What the star does by itself, px/s on the detector, from a step to the next one.
    drift: [f64; 2],
    step_s: f64,
}

/// A mount without play and drift.
const STILL: Mount = Mount {
    east: [3.0, 0.0],
    north: [0.0, 3.0],
    play_s: 0.0,
    free_north_s: 0.0,
    place: [0.0, 0.0],
    drift: [0.0, 0.0],
    step_s: 3.0,
};

impl Mount {
    fn pulse(&mut self, direction: Direction, length_ms: u32) {
        let seconds = f64::from(length_ms) / 1000.0;
        let (velocity, seconds) = match direction {
            Direction::East => (self.east, seconds),
            Direction::West => (self.east, -seconds),
            Direction::North => {
                let lost = self.free_north_s.min(seconds);
                self.free_north_s -= lost;
                (self.north, seconds - lost)
            }
            Direction::South => {
                let lost = (self.play_s - self.free_north_s).min(seconds);
                self.free_north_s += lost;
                (self.north, lost - seconds)
            }
        };
        (0..2).for_each(|n| self.place[n] += velocity[n] * seconds + self.drift[n] * self.step_s);
    }

    fn calibrate(&mut self, settings: CalibrationSettings) -> (Next, usize) {
        let mut run = CalibrationRun::new(settings);
        // noise of a measurement, the same at every run
        let noise = |n: usize| 0.05 * ((n * 7919 % 13) as f64 / 6.0 - 1.0);
        for n in 0..400 {
            let place = [self.place[0] + noise(n), self.place[1] + noise(n + 5)];
            match run.next(1000.0 + n as f64 * self.step_s, (n != 7).then_some(place)) {
                Next::Pulse { direction, length_ms } => self.pulse(direction, length_ms),
                Next::Measure => assert_eq!(n, 7),
                end => return (end, n),
            }
        }
        panic!("no end");
    }
}

#[test]
fn pulses_give_matrix_and_backlash() {
    for (rotation, parity) in [(0.0_f64, 1.0), (17.0, 1.0), (45.0, -1.0), (90.0, 1.0), (200.0, -1.0)] {
        let (sin, cos) = rotation.to_radians().sin_cos();
        let (east, north) = ([3.0 * cos, 3.0 * sin], [-parity * 4.0 * sin, parity * 4.0 * cos]);
        let mut mount = Mount { east, north, play_s: 2.0, free_north_s: 2.0, place: [100.0, 50.0], ..STILL };
        let settings =
            CalibrationSettings { dec_deg: 30.0, expected_px_s: Some([3.0, 4.0]), ..CalibrationSettings::default() };
        let Next::Done { calibration, warnings } = mount.calibrate(settings).0 else { panic!("{rotation}") };
        for n in 0..2 {
            assert!((calibration.east_px_s[n] - east[n]).abs() < 0.03, "{rotation}: {calibration:?}");
            assert!((calibration.north_px_s[n] - north[n]).abs() < 0.04, "{rotation}: {calibration:?}");
        }
        assert!((calibration.backlash_s.unwrap() - 2.0).abs() < 0.1, "{calibration:?}");
        assert!(warnings.is_empty(), "{warnings:?}");
    }
}

#[test]
fn as_many_pulses_are_made_as_asked_for_while_the_stars_stay_near() {
    let frames = |settings| {
        let (end, frames) = Mount { ..STILL }.calibrate(settings);
        let Next::Done { calibration, .. } = end else { panic!("{end:?}") };
        assert!((calibration.east_px_s[0] - 3.0).abs() < 0.05, "{calibration:?}");
        frames
    };
    let many = CalibrationSettings { steps: Some(20), distance_px: 200.0, ..CalibrationSettings::default() };
    // four ways of 20, and a few until declination takes hold
    assert!((83..=90).contains(&frames(many)), "{}", frames(many));
    // 2.25 px each
    let near = frames(CalibrationSettings { steps: Some(60), distance_px: 30.0, ..many });
    assert!((14 * 4..=14 * 4 + 10).contains(&near), "{near}");
    let end = Mount { east: [0.1, 0.0], ..STILL }.calibrate(many).0;
    assert!(
        matches!(end, Next::Failed(NoCalibration::DidNotMove { direction: Direction::West, steps: 20, .. })),
        "{end:?}"
    );
}

#[test]
fn odd_mounts_are_reported() {
    let settings =
        CalibrationSettings { dec_deg: 65.0, expected_px_s: Some([30.0, 4.0]), ..CalibrationSettings::default() };
    let mut skewed = Mount { east: [20.0, 0.0], north: [4.0, 8.0], ..STILL };
    let Next::Done { calibration, warnings } = skewed.calibrate(settings).0 else { panic!("not done") };
    assert_eq!(calibration.backlash_s, Some(0.0));
    let has = |wanted: fn(&Warning) -> bool| warnings.iter().any(wanted);
    assert!(has(|w| matches!(w, Warning::NotOrthogonal { off_deg } if (off_deg - 26.6).abs() < 1.0)), "{warnings:?}");
    assert!(has(|w| matches!(w, Warning::FewSteps { axis: "RA", steps: 2 })), "{warnings:?}");
    assert!(has(|w| matches!(w, Warning::Speed { axis: "RA", .. })), "{warnings:?}");
    assert!(has(|w| matches!(w, Warning::NearPole { .. })), "{warnings:?}");
    let mut stuck = Mount { east: [0.01, 0.0], ..STILL };
    let end = stuck.calibrate(CalibrationSettings::default()).0;
    assert!(
        matches!(end, Next::Failed(NoCalibration::DidNotMove { direction: Direction::West, steps: 60, .. })),
        "{end:?}"
    );
    let mut loose = Mount { play_s: 1e3, free_north_s: 1e3, ..STILL };
    assert!(matches!(
        loose.calibrate(CalibrationSettings::default()).0,
        Next::Failed(NoCalibration::Backlash { steps: 60 })
    ));
    let mut run = CalibrationRun::new(CalibrationSettings::default());
    assert_eq!([run.next(0.0, None), run.next(1.0, Some([f64::NAN, 0.0]))], [Next::Measure, Next::Measure]);
    assert_eq!(run.next(2.0, None), Next::Failed(NoCalibration::StarLost));
}

#[test]
fn a_drift_is_not_taken_for_pulses() {
    // right ascension is stuck, declination too; the field drifts 25 px all the same
    let mut adrift = Mount { east: [0.01, 0.0], drift: [0.3, 0.1], ..STILL };
    let end = adrift.calibrate(CalibrationSettings::default()).0;
    let Next::Failed(NoCalibration::DidNotMove { direction: Direction::West, moved_px, .. }) = end else {
        panic!("{end:?}")
    };
    assert!(moved_px < 1.0, "{moved_px}");
    // as fast as a third of the least good move
    let mut loose = Mount { play_s: 1e3, free_north_s: 1e3, drift: [0.0, 0.15], ..STILL };
    assert!(matches!(
        loose.calibrate(CalibrationSettings::default()).0,
        Next::Failed(NoCalibration::Backlash { steps: 60 })
    ));
    let mut late = Mount { drift: [0.0, 0.25], ..loose };
    assert!(matches!(
        late.calibrate(CalibrationSettings::default()).0,
        Next::Failed(NoCalibration::Backlash { steps: 60 })
    ));
}

#[test]
fn a_mount_that_does_not_come_back_is_reported() {
    for drift in [[0.0, 0.0], [0.1, 0.1]] {
        let mut run = CalibrationRun::new(CalibrationSettings { distance_px: 40.0, ..CalibrationSettings::default() });
        let (mut place, mut mid_s) = ([0.0, 0.0], 0.0);
        let end = loop {
            match run.next(mid_s, Some(place)) {
                Next::Pulse { direction, .. } => {
                    let way: [f64; 2] = match direction {
                        Direction::West => [-3.0, 0.0],
                        Direction::East => [1.5, 0.0],
                        Direction::North => [0.0, 3.0],
                        Direction::South => [0.0, -3.0],
                    };
                    (0..2).for_each(|n| place[n] += way[n] + 3.0 * drift[n]);
                    mid_s += 3.0;
                }
                end => break end,
            }
        };
        let Next::Done { calibration, warnings } = end else { panic!("{end:?}") };
        let share = warnings.iter().find_map(|warning| match warning {
            Warning::NotBack { share } => Some(*share),
            _ => None,
        });
        assert!((share.unwrap() - 0.5).abs() < 0.02, "{warnings:?}");
        assert!((calibration.north_px_s[1] - 4.0).abs() < 0.01 && calibration.backlash_s == Some(0.0));
    }
}

#[test]
fn a_play_longer_than_the_way_is_measured_all_the_same_and_of_an_endless_one_what_was_seen() {
    // the way takes 8.3 s of pulse
    for (play_s, drift) in [(15.0, [0.0, 0.0]), (15.0, [0.04, 0.04]), (20.0, [-0.04, 0.04])] {
        let mut mount = Mount { play_s, free_north_s: 0.5, drift, ..STILL };
        let Next::Done { calibration, .. } = mount.calibrate(CalibrationSettings::default()).0 else {
            panic!("{play_s}")
        };
        assert!((calibration.backlash_s.unwrap() - play_s).abs() < 0.2, "{calibration:?}");
        assert!((calibration.north_px_s[1] - 3.0).abs() < 0.03, "{calibration:?}");
    }
    let mut oneway = Mount { play_s: 1e3, drift: [0.04, 0.04], ..STILL };
    let Next::Done { calibration, warnings } = oneway.calibrate(CalibrationSettings::default()).0 else {
        panic!("not done")
    };
    assert_eq!(calibration.backlash_s, Some(45.0), "all of the 60 pulses of 0.75 s");
    assert_eq!(warnings, [Warning::OneWay { play_s: 45.0 }]);
    assert!((calibration.north_px_s[1] - 3.0).abs() < 0.03 && calibration.north_px_s[0].abs() < 0.03);
}

#[test]
fn times_that_do_not_go_on_are_reported() {
    for wrong_s in [5.0, 4.0, f64::NAN, f64::INFINITY] {
        let mut run = CalibrationRun::new(CalibrationSettings::default());
        assert!(matches!(run.next(5.0, Some([0.0, 0.0])), Next::Pulse { .. }));
        let end = run.next(wrong_s, Some([1.0, 0.0]));
        assert!(matches!(end, Next::Failed(NoCalibration::Clock { before_s: 5.0, .. })), "{end:?}");
    }
}

#[test]
fn one_gust_does_not_spoil_a_calibration() {
    for gust in 1..60 {
        let mut mount = Mount { drift: [0.03, -0.04], play_s: 0.6, free_north_s: 0.6, ..STILL };
        let (mut run, mut n) = (CalibrationRun::new(CalibrationSettings::default()), 0);
        let end = loop {
            let [x, y] = mount.place;
            match run.next(f64::from(n) * 3.0, Some(if n == gust { [x + 6.0, y - 4.0] } else { [x, y] })) {
                Next::Pulse { direction, length_ms } => mount.pulse(direction, length_ms),
                end => break end,
            }
            n += 1;
        };
        let Next::Done { calibration, .. } = end else { panic!("gust {gust}: {end:?}") };
        let (east, north) = (calibration.east_px_s, calibration.north_px_s);
        assert!((east[0] - 3.0).abs() < 0.06 && east[1].abs() < 0.06, "gust {gust}: {calibration:?}");
        assert!((north[1] - 3.0).abs() < 0.06 && north[0].abs() < 0.06, "gust {gust}: {calibration:?}");
        assert!((calibration.backlash_s.unwrap() - 0.6).abs() < 0.1, "gust {gust}: {calibration:?}");
    }
}
