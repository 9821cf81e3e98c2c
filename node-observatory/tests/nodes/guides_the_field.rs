//! Guiding closes its loop on the simulated mount: calibrated by pulses or by a solved frame, and held on both sides of
//! the pier. How well it holds is measured in `proof`.

use std::time::Instant;

use contract::device::telescope::PierSide;
use contract::observatory::{CalibrationSource, Correction, GuideCalibration, GuideStage};
use units::Angle;

use crate::MOST;
use crate::sim::{Sim, by_geometry, telescope};

/// An `object` row that guides.
pub fn object((ra, dec): (f64, f64), exposure_s: f64, frames: u32) -> String {
    format!(
        r#"{{"object": "field", "ra": {ra}, "dec": {dec}, "exptime": {exposure_s}, "n": {frames}, "guiding": true}}"#
    )
}

/// Directions and speeds of two calibrations differ by this at most, degrees and share.
pub fn apart(a: [f64; 2], b: [f64; 2]) -> (f64, f64) {
    let angle = (a[1].atan2(a[0]) - b[1].atan2(b[0])).to_degrees();
    let turned = ((angle + 180.0).rem_euclid(360.0) - 180.0).abs();
    (turned, (a[0].hypot(a[1]) / b[0].hypot(b[1]) - 1.0).abs())
}

/// What was corrected while the field was held with the tube in the west of the pier, and in the east.
pub fn sides(corrections: &[Correction]) -> [Vec<Correction>; 2] {
    let of = |side| corrections.iter().filter(move |c| c.pier_side == Some(side) && c.stage == GuideStage::Guide);
    [PierSide::West, PierSide::East].map(|side| of(side).cloned().collect::<Vec<_>>())
}

/// The same camera on the other side of the pier.
pub fn turned(calibration: &GuideCalibration) -> GuideCalibration {
    let [east_px_per_s, north_px_per_s] =
        [calibration.east_px_per_s, calibration.north_px_per_s].map(|way| way.map(|v| -v));
    GuideCalibration { east_px_per_s, north_px_per_s, ..calibration.clone() }
}

/// A row without an end: a test ends when it has seen enough.
pub fn endless((ra, dec): (f64, f64), more: &str) -> String {
    format!(r#"{{"object": "field", "ra": {ra}, "dec": {dec}, {more}}}"#)
}

/// How far west of the meridian a place stands now, degrees.
pub fn past_meridian_deg(sim: &Sim, (ra, _): (f64, f64)) -> f64 {
    (sim.place(0.0, 0.0).0 - ra + 180.0).rem_euclid(360.0) - 180.0
}

/// Collects corrections until enough is seen of them.
async fn collect(sim: &Sim, corrections: &mut Vec<Correction>, enough: impl Fn(&[Correction]) -> bool) {
    let began = Instant::now();
    while !enough(corrections) {
        assert!(
            began.elapsed() < MOST,
            "not seen within {MOST:?}, last of {}: {:#?}",
            corrections.len(),
            corrections.last()
        );
        corrections.push(sim.next_correction().await);
    }
}

/// Frames that were corrected after while the field was held, with the tube on this side of the pier.
fn held(corrections: &[Correction], side: PierSide) -> usize {
    corrections.iter().filter(|c| c.pier_side == Some(side) && c.stage == GuideStage::Guide).count()
}

#[tokio::test(flavor = "multi_thread")]
async fn pulses_teach_what_they_do_and_a_field_is_held_by_it_until_its_last_frame() {
    let mut options = telescope(30.0);
    options.camera.position_angle = Angle::from_degrees(17.0);
    // Nothing moves the stars but pulses, however long this machine takes between two of them.
    (options.mount.drift_arcsec_per_min, options.mount.periodic_error_arcsec) = ((0.0, 0.0), 0.0);
    let truth = by_geometry(&options.camera);
    let mut sim = Sim::new(options, "[imaging]\nsolve = false\n").await;
    let field = sim.place(0.7, -20.0);
    let (ra, dec) = sim.place(0.8, 0.0);
    let calibrate = format!(r#"{{"exptime": 3, "pulse_time": 900, "settle_time": 0.5, "ra": {ra}, "dec": {dec}}}"#);
    sim.write_schedule(&[("calibrate_guiding", &calibrate), ("object", &object(field, 20.0, 5))], 18_000.0);
    sim.start().await;
    sim.until("calibrated", MOST, |sim| sim.ended(0).is_some()).await;
    sim.until("held", MOST, |sim| sim.holds(2)).await;
    let made = sim.guiding.get().unwrap().sample.body.calibration.unwrap();
    assert_eq!((made.source, made.pier_side), (CalibrationSource::Pulses, Some(PierSide::East)));
    for (learned, true_px_s) in [(made.east_px_per_s, truth.east_px_per_s), (made.north_px_per_s, truth.north_px_per_s)]
    {
        let (turned_deg, faster) = apart(learned, true_px_s);
        assert!(turned_deg < 2.0 && faster < 0.05, "{learned:?}, by geometry {true_px_s:?}");
    }
    sim.until("the field observed", MOST, |sim| sim.ended(1).is_some()).await;
    let over = |sim: &Sim| sim.guiding.get().is_some_and(|received| !received.sample.body.active);
    sim.until("guiding over with its row", MOST, over).await;
    let ended = sim.clock.utc();
    let told = |sim: &Sim| sim.night.get().is_some_and(|received| received.sample.at_utc > ended);
    sim.until("told since", MOST, told).await;
    let last = sim.night.get().unwrap().sample.body.last_frame.unwrap();
    let corrections = sim.corrections().await;
    assert!(corrections.iter().any(|correction| correction.stage == GuideStage::Guide), "{corrections:#?}");
    assert!(corrections.iter().any(|correction| correction.frame == last), "no correction of {last}: {corrections:#?}");
    sim.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_solved_frame_and_the_guide_rates_teach_what_pulses_do() {
    let mut options = telescope(30.0);
    options.camera.position_angle = Angle::from_degrees(45.0);
    options.mount.drift_arcsec_per_min = (0.8, 0.8);
    let truth = by_geometry(&options.camera);
    let mut sim = Sim::new(options, "[imaging]\ncatalogue = \"sky.smcat\"\n").await;
    let field = sim.place(0.7, -20.0);
    sim.write_catalogue(field);
    sim.write_schedule(&[("object", &endless(field, r#""exptime": 20, "guiding": true"#))], 18_000.0);
    sim.start().await;
    let mut corrections = Vec::new();
    // The drift alone is a pixel in each 55 s.
    let is_pulsed = |c: &Correction| c.east.given_ms != 0 || c.north.given_ms != 0;
    let is_held = |all: &[Correction]| held(all, PierSide::East) >= 4 && all.iter().any(is_pulsed);
    collect(&sim, &mut corrections, is_held).await;
    let made = sim.guiding.get().unwrap().sample.body.calibration.unwrap();
    assert_eq!((made.source, made.pier_side), (CalibrationSource::PlateSolution, Some(PierSide::East)));
    for (learned, true_px_s) in [(made.east_px_per_s, truth.east_px_per_s), (made.north_px_per_s, truth.north_px_per_s)]
    {
        let (turned_deg, faster) = apart(learned, true_px_s);
        assert!(turned_deg < 1.0 && faster < 0.01, "{learned:?}, by geometry {true_px_s:?}");
    }
    sim.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_of_its_own_guides_alongside_the_rows_exposures() {
    let mut options = telescope(10.0);
    let mut scope = simulator::GuideCameraOptions::default();
    (scope.camera.width, scope.camera.height) = (640, 480);
    options.mount.drift_arcsec_per_min = (2.0, -1.5);
    options.guide_camera = Some(scope);
    let known = by_geometry(&scope.camera);
    let more = "[imaging]\nsolve = false\n[guiding]\ncamera = \"guider\"\nexposure_s = 5.0\n";
    let mut sim = Sim::new(options, more).await;
    sim.keep_calibration("guider", GuideCalibration { source: CalibrationSource::Pulses, ..known });
    let field = sim.place(0.7, -20.0);
    sim.write_schedule(&[("object", &object(field, 40.0, 3))], 18_000.0);
    sim.start().await;
    let mut corrections = Vec::new();
    collect(&sim, &mut corrections, |all| held(all, PierSide::East) >= 3).await;
    sim.until("the field observed", MOST, |sim| sim.ended(0).is_some()).await;
    corrections.extend(sim.corrections().await);
    assert!(corrections.iter().all(|correction| correction.camera == "guider"));
    assert_eq!(sim.schedule.get().unwrap().sample.body.rows[0].frames, 3, "its frames are none of the row's");
    sim.stop().await;
}
