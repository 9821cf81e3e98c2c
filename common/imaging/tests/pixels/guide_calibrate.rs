//! Calibrations by pulses on a simulated mount that drifts meanwhile, as every mount does. Pulses run at half the
//! sidereal rate, a step takes three seconds, places are measured to 0.05 px.

use imaging::guide::calibration::pulses::{CalibrationRun, CalibrationSettings, Direction, Next};
use imaging::guide::{Calibration, Pulses};

use crate::mount::{Mount, exposure};

const STEP_S: f64 = 3.0;

/// Drifts along East and North, arcsec/s.
const DRIFTS: [[f64; 2]; 5] = [[0.0, 0.0], [0.02, 0.02], [0.04, 0.0], [0.03, -0.04], [-0.04, 0.04]];

/// Calibrates with the frames from this one on.
fn calibrate(mount: &mut Mount, first: usize) -> Calibration {
    // ten steps out, as the observatory chooses them
    let pulse_ms = (2500.0 / mount.speed_px_s()).round() as u32;
    let mut run = CalibrationRun::new(CalibrationSettings { pulse_ms, ..CalibrationSettings::default() });
    for n in first..first + 400 {
        let exposure = exposure(n, STEP_S);
        let seen = mount.measured(exposure);
        let (direction, ms) = match run.next(exposure.mid_s, Some([seen.dx_px, seen.dy_px])) {
            Next::Pulse { direction, length_ms } => (direction, length_ms as i32),
            Next::Done { calibration, .. } => return calibration,
            end => panic!("{end:?}"),
        };
        let (east_ms, north_ms) = match direction {
            Direction::East => (ms, 0),
            Direction::West => (-ms, 0),
            Direction::North => (0, ms),
            Direction::South => (0, -ms),
        };
        mount.pulse(exposure.mid_s + 0.5 * exposure.length_s, Pulses { east_ms, north_ms });
    }
    panic!("no end");
}

/// Share by which the faster or slower axis differs from the truth, and degrees by which the axes are turned, at most.
fn off(made: &Calibration, mount: &Mount) -> (f64, f64) {
    let truth = mount.calibration(None);
    let pairs = [(made.east_px_s, truth.east_px_s), (made.north_px_s, truth.north_px_s)];
    pairs.into_iter().fold((0.0, 0.0), |(share, turned_deg): (f64, f64), (a, b)| {
        let (cross, dot) = (a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1]);
        let faster = (a[0].hypot(a[1]) / b[0].hypot(b[1]) - 1.0).abs();
        (share.max(faster), turned_deg.max(cross.atan2(dot).to_degrees().abs()))
    })
}

/// Mounts at scales, drifts, angles and chances.
fn mounts() -> impl Iterator<Item = (Mount, String)> {
    [0.5, 0.75, 1.0].into_iter().flat_map(|scale_arcsec_px| {
        DRIFTS.into_iter().enumerate().flat_map(move |(n, drift_arcsec_s)| {
            (0..8_u64).map(move |seed| {
                let mut mount = Mount::new([0.0, 17.0, 45.0, 200.0][seed as usize % 4], 100 * n as u64 + seed);
                (mount.scale_arcsec_px, mount.mirrored) = (scale_arcsec_px, seed % 2 == 0);
                mount.drift_px_s = drift_arcsec_s.map(|drift| drift / scale_arcsec_px);
                (mount, format!("{scale_arcsec_px} arcsec/px, drift {drift_arcsec_s:?} arcsec/s, seed {seed}"))
            })
        })
    })
}

#[test]
fn a_drift_falsifies_neither_speeds_nor_directions_and_invents_no_play() {
    let (mut most_share, mut most_deg, mut most_play_s) = (0.0_f64, 0.0_f64, 0.0_f64);
    for (mut mount, what) in mounts() {
        let made = calibrate(&mut mount, 0);
        let (share, turned_deg) = off(&made, &mount);
        assert!(share < 0.02 && turned_deg < 1.0, "{what}: {share:.3}, {turned_deg:.2} deg, {made:?}");
        let play_s = made.backlash_s.unwrap();
        assert!(play_s < 0.05, "{what}: {play_s:.3} s of play were invented");
        (most_share, most_deg) = (most_share.max(share), most_deg.max(turned_deg));
        most_play_s = most_play_s.max(play_s);
    }
    println!("off by at most {most_share:.4} in speed, {most_deg:.2} deg; invented play {most_play_s:.3} s");
}

#[test]
fn true_play_is_found_beside_a_drift() {
    let mut most_s = 0.0_f64;
    for true_s in [0.1, 0.3, 0.9, 2.0] {
        for (mut mount, what) in mounts() {
            (mount.play_s, mount.free_north_s) = (true_s, 0.5 * true_s);
            let made = calibrate(&mut mount, 0);
            let play_s = made.backlash_s.unwrap();
            assert!((play_s - true_s).abs() < 0.05, "{what}: {play_s:.3} s of play for {true_s}");
            let (share, turned_deg) = off(&made, &mount);
            assert!(share < 0.02 && turned_deg < 1.0, "{what}: {share:.3}, {turned_deg:.2} deg, {made:?}");
            most_s = most_s.max((play_s - true_s).abs());
        }
    }
    println!("play off by at most {most_s:.3} s");
}

#[test]
fn a_worm_that_turns_meanwhile_costs_little() {
    // 8 arcsec to either side in 480 s: up to 0.1 arcsec/s, and it changes while declination has its turn
    for seed in 0..8 {
        let mut mount = Mount::new(17.0, seed);
        mount.scale_arcsec_px = 0.75;
        mount.worm = (8.0 / mount.scale_arcsec_px, 480.0);
        let made = calibrate(&mut mount, 20 * seed as usize);
        let (share, turned_deg) = off(&made, &mount);
        println!("worm, seed {seed}: {share:.4}, {turned_deg:.2} deg, {:?} s", made.backlash_s);
        assert!(share < 0.05 && turned_deg < 2.5 && made.backlash_s.unwrap() < 0.05, "{share} {turned_deg} {made:?}");
    }
}
