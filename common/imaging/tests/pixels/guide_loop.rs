//! Closed loops on a simulated mount; what is asked of them is in docs/imaging.md, "Measured". One pixel is 0.35
//! arcsec, pulses run at half the sidereal rate, the worm's arcsec are the distance of its extremes from the middle.

use imaging::NoShift;
use imaging::guide::{Ask, Calibration, GuideSettings, Guider, Pier, State, Unstable, calibration};

use crate::mount::{Mount, exposure, guide, guide_late, rms, shift};

/// What is asked for: the predecessor's published median, px.
const ASKED_PX: f64 = 0.35;
const ANGLES_DEG: [f64; 5] = [0.0, 17.0, 45.0, 90.0, 200.0];

#[test]
fn drift_with_dec_backlash_is_held() {
    for cadence_s in [2.0, 30.0, 120.0] {
        for (n, angle_deg) in ANGLES_DEG.into_iter().enumerate() {
            let mut mount = Mount::new(angle_deg, n as u64);
            mount.mirrored = n % 2 == 1;
            mount.drift_px_s = [0.02, 0.05];
            // the motor stands anywhere in its play, which is known or not
            (mount.play_s, mount.free_north_s) = (2.0, [0.0, 0.5, 1.0, 1.5, 2.0][n]);
            let backlash_s = [Some(2.0), None][n % 2];
            let calibration = Calibration { backlash_s, ..mount.calibration(None) };
            let mut guider = Guider::new(GuideSettings::default(), &calibration, 0.0).unwrap();
            let first = ((200.0 / cadence_s) as usize).max(12);
            let places = guide(&mut mount, &mut guider, cadence_s, 0..first + 60, |_| true);
            let settled_px = rms(&places[first..]);
            println!("drift, cadence {cadence_s} s, camera at {angle_deg} deg: {settled_px:.3} px");
            assert!(settled_px <= ASKED_PX && guider.state() == State::Guide);
        }
    }
}

#[test]
fn worms_are_held_without_knowing_their_period() {
    for (cadence_s, period_s, arcsec) in [(2.0, 480.0, 8.0), (30.0, 480.0, 8.0), (120.0, 1000.0, 1.0)] {
        for (n, angle_deg) in ANGLES_DEG.into_iter().enumerate() {
            let mut mount = Mount::new(angle_deg, n as u64);
            mount.mirrored = n % 2 == 0;
            mount.worm = (arcsec / mount.scale_arcsec_px, period_s);
            let mut guider = Guider::new(GuideSettings::default(), &mount.calibration(None), 0.0).unwrap();
            let per_turn = (period_s / cadence_s) as usize;
            let turns = if cadence_s == 2.0 { 2 } else { 5 };
            let places = guide(&mut mount, &mut guider, cadence_s, 0..turns * per_turn, |_| true);
            let (first_px, later_px) = (rms(&places[..per_turn]), rms(&places[per_turn..]));
            println!(
                "worm of {arcsec} arcsec in {period_s} s, cadence {cadence_s} s, camera at {angle_deg} deg: \
                 {later_px:.3} px (first turn {first_px:.3})"
            );
            assert!(later_px <= ASKED_PX && guider.state() == State::Guide);
        }
    }
}

#[test]
fn pulses_that_come_late_into_the_next_exposure_hold_as_well() {
    for (late_s, most_px) in [(2.0, ASKED_PX), (4.0, ASKED_PX), (15.0, 2.5 * ASKED_PX)] {
        let mut mount = Mount::new(17.0, 14);
        (mount.drift_px_s, mount.worm) = ([0.02, 0.05], (8.0 / mount.scale_arcsec_px, 480.0));
        let mut guider = Guider::new(GuideSettings::default(), &mount.calibration(None), 0.0).unwrap();
        let places = guide_late(&mut mount, &mut guider, 30.0, late_s, 0..80, |_| true);
        println!("pulses {late_s} s late: {:.3} px", rms(&places[20..]));
        assert!(rms(&places[20..]) <= most_px && guider.state() == State::Guide);
    }
}

#[test]
fn the_predecessors_controller_holds_a_drift_too() {
    let mut mount = Mount::new(17.0, 3);
    mount.drift_px_s = [0.005, 0.0];
    let settings = GuideSettings { resist_dec_reversal: false, ..GuideSettings::pid() };
    let mut guider = Guider::new(settings, &mount.calibration(None), 0.0).unwrap();
    let places = guide(&mut mount, &mut guider, 60.0, 0..200, |_| true);
    println!("PID: {:.3} px", rms(&places[120..]));
    // its integral needs some fifty frames
    assert!(rms(&places[120..]) < ASKED_PX && rms(&places[120..]) < 0.5 * rms(&places[5..30]));
}

#[test]
fn a_drift_is_held_behind_clouds_and_the_next_clear_frame_works() {
    let mut mount = Mount::new(45.0, 5);
    mount.drift_px_s = [0.05, -0.03];
    let mut guider = Guider::new(GuideSettings::default(), &mount.calibration(None), 0.0).unwrap();
    let places = guide(&mut mount, &mut guider, 30.0, 0..60, |n| !(40..46).contains(&n));
    // 180 s of clouds would have been 10 px of drift
    assert!(places[40..60].iter().all(|[x, y]| x.hypot(*y) < 1.0), "{:?}", &places[40..60]);
    assert!(rms(&places[50..]) < ASKED_PX && guider.state() == State::Guide);
}

#[test]
fn after_a_pier_flip_the_other_sides_calibration_guides() {
    for dec_reversed in [false, true] {
        let mut mount = Mount::new(30.0, 9);
        mount.drift_px_s = [0.01, 0.03];
        let east = mount.calibration(Some(Pier::East));
        let mut guider = Guider::new(GuideSettings::default(), &east, 0.0).unwrap();
        assert!(rms(&guide(&mut mount, &mut guider, 10.0, 0..80, |_| true)[30..]) < ASKED_PX);
        // the image turns by half a turn, and the reference with it; some mounts turn their Dec motor round, some not
        let mut flipped = Mount::new(210.0, 10);
        (flipped.drift_px_s, flipped.dec_reversed) = ([0.01, 0.03], dec_reversed);
        let west = calibration::for_side(&[east], Some(Pier::West), dec_reversed).unwrap();
        assert_eq!(guider.recalibrated(&west, 0.0), Ok(()));
        assert_eq!(guider.state(), State::Acquire);
        let places = guide(&mut flipped, &mut guider, 10.0, 0..80, |_| true);
        println!("after a flip, Dec reversed {dec_reversed}: {:.3} px", rms(&places[30..]));
        assert!(rms(&places[30..]) < ASKED_PX);
        // a wrong matrix is noticed by the motions against it, and turned round
        let mut wrong = Guider::new(GuideSettings::default(), &east, 0.0).unwrap();
        let mut again = Mount::new(210.0, 10);
        (again.drift_px_s, again.dec_reversed) = ([0.01, 0.03], dec_reversed);
        let places = guide(&mut again, &mut wrong, 10.0, 0..80, |_| true);
        let next = wrong.step(exposure(80, 10.0), Ok(&again.measured(exposure(80, 10.0))));
        assert!(rms(&places[40..]) < ASKED_PX, "{places:?}");
        assert_eq!(next.log.unstable, Some(Unstable::WrongWay));
    }
}

#[test]
fn a_field_that_was_knocked_away_is_brought_back() {
    let mut mount = Mount::new(90.0, 4);
    let mut guider = Guider::new(GuideSettings::default(), &mount.calibration(None), 0.0).unwrap();
    guide(&mut mount, &mut guider, 10.0, 0..30, |_| true);
    // within reach of pulses
    mount.slew(25.0, -20.0);
    let places = guide(&mut mount, &mut guider, 10.0, 30..60, |_| true);
    assert!(rms(&places[20..]) < ASKED_PX && guider.state() == State::Guide, "{:?}", places.last());
    // beyond: twice beyond the cap is lost, twice the same place is believed
    mount.slew(300.0, 50.0);
    let mut asked = None;
    for n in 60..66 {
        let exposure = exposure(n, 10.0);
        let decision = guider.step(exposure, Ok(&mount.measured(exposure)));
        assert_eq!((decision.pulses.east_ms, decision.pulses.north_ms), (0, 0));
        asked = decision.ask.or(asked);
    }
    let Some(Ask::Recentre { dx_px, dy_px }) = asked else { panic!("{asked:?}") };
    assert!((dx_px + 300.0).abs() < 1.0 && (dy_px + 50.0).abs() < 1.0, "{dx_px} {dy_px}");
    mount.slew(dx_px, dy_px);
    guider.moved();
    let places = guide(&mut mount, &mut guider, 10.0, 66..96, |_| true);
    assert!(rms(&places[15..]) < ASKED_PX && guider.state() == State::Guide);
}

#[test]
fn a_pulse_is_reported_once() {
    let mut mount = Mount::new(0.0, 11);
    let mut guider = Guider::new(GuideSettings::default(), &mount.calibration(None), 0.0).unwrap();
    mount.slew(3.0, 3.0);
    let decision = guider.step(exposure(0, 30.0), Ok(&mount.measured(exposure(0, 30.0))));
    assert!(decision.pulses.east_ms != 0 && decision.pulses.north_ms != 0, "{decision:?}");
    guider.report([Some((29.5, decision.pulses.east_ms)), Some((29.6, decision.pulses.north_ms))]);
    let expected = guider.expected_px(exposure(1, 30.0));
    // as a caller would who also reports axes that were not pulsed
    guider.report([Some((59.5, 0)); 2]);
    assert_eq!(guider.expected_px(exposure(1, 30.0)), expected);
    let without = guider.expected_px(exposure(0, 30.0));
    assert!((without[0] - expected[0]).abs() > 1.0, "the pulses are in what is expected: {without:?}, {expected:?}");
}

#[test]
fn a_dither_moves_the_field_and_holds_it_there() {
    let mut mount = Mount::new(17.0, 6);
    mount.drift_px_s = [0.02, 0.02];
    let mut guider = Guider::new(GuideSettings::default(), &mount.calibration(None), 0.0).unwrap();
    guide(&mut mount, &mut guider, 30.0, 0..30, |_| true);
    guider.aim(6.0, -4.0);
    let places = guide(&mut mount, &mut guider, 30.0, 30..50, |_| true);
    let off: Vec<[f64; 2]> = places.iter().map(|[x, y]| [x - 6.0, y + 4.0]).collect();
    // the first frame was on its way when the aim changed
    assert!(rms(&off[1..]) < 2.0 * ASKED_PX && rms(&off[5..]) < ASKED_PX, "{off:?}");
    let next = guider.expected_px(exposure(50, 30.0));
    assert!((next[0] - 6.0).abs() < 1.0 && (next[1] + 4.0).abs() < 1.0, "{next:?}");
}

#[test]
fn one_wild_measurement_does_not_move_the_mount() {
    let mut mount = Mount::new(0.0, 7);
    let mut guider = Guider::new(GuideSettings::default(), &mount.calibration(None), 0.0).unwrap();
    guide(&mut mount, &mut guider, 30.0, 0..40, |_| true);
    let decision = guider.step(exposure(40, 30.0), Ok(&shift(8.0, -9.0)));
    assert!(decision.pulses.east_ms.abs() < 30 && decision.pulses.north_ms.abs() < 30, "{decision:?}");
    let places = guide(&mut mount, &mut guider, 30.0, 41..60, |_| true);
    assert!(rms(&places) < ASKED_PX);
}

#[test]
fn stars_of_another_field_ask_for_a_solution_and_then_for_a_person() {
    let mut mount = Mount::new(0.0, 8);
    let mut guider = Guider::new(GuideSettings::default(), &mount.calibration(None), 0.0).unwrap();
    guide(&mut mount, &mut guider, 30.0, 0..20, |_| true);
    let strangers = NoShift::NoMatch { matched: 1, dx_px: 0.0, dy_px: 0.0 };
    let asked: Vec<Option<Ask>> = (20..27).map(|n| guider.step(exposure(n, 30.0), Err(&strangers)).ask).collect();
    let (register, solve) = (Some(Ask::Register), Some(Ask::PlateSolve));
    assert_eq!(asked, [None, register, register, solve, solve, solve, Some(Ask::Alarm)]);
    assert_eq!(guider.state(), State::Stopped);
    let stopped = guider.step(exposure(27, 30.0), Ok(&shift(1.0, 1.0)));
    assert_eq!((stopped.pulses.east_ms, stopped.pulses.north_ms, stopped.state), (0, 0, State::Stopped));
    guider.moved();
    let places = guide(&mut mount, &mut guider, 30.0, 28..50, |_| true);
    assert!(rms(&places[5..]) < ASKED_PX && guider.state() == State::Guide);
}

#[test]
fn long_clouds_call_a_person_and_pass() {
    let mut mount = Mount::new(0.0, 12);
    let mut guider = Guider::new(GuideSettings::default(), &mount.calibration(None), 0.0).unwrap();
    guide(&mut mount, &mut guider, 60.0, 0..20, |_| true);
    let clouds = NoShift::TooFewStars { reference: 20, check: 0 };
    let asked: Vec<Option<Ask>> = (20..40).map(|n| guider.step(exposure(n, 60.0), Err(&clouds)).ask).collect();
    assert_eq!((asked[0], asked[1], asked[10]), (None, Some(Ask::Register), Some(Ask::Register)));
    assert_eq!((asked[19], guider.state()), (Some(Ask::Alarm), State::Lost));
    let places = guide(&mut mount, &mut guider, 60.0, 40..60, |_| true);
    assert!(rms(&places[3..]) < ASKED_PX && guider.state() == State::Guide);
}

#[test]
fn a_clock_that_was_set_back_is_survived() {
    let mut mount = Mount::new(0.0, 13);
    let mut guider = Guider::new(GuideSettings::default(), &mount.calibration(None), 0.0).unwrap();
    guide(&mut mount, &mut guider, 30.0, 100..130, |_| true);
    let mut again = Mount::new(0.0, 13);
    let places = guide(&mut again, &mut guider, 30.0, 0..30, |_| true);
    assert!(rms(&places[10..]) < ASKED_PX && guider.state() == State::Guide);
}
