use super::super::tests::frame;
use super::*;

fn at(seconds: f64) -> Utc {
    Utc::from_seconds(1.8e9 + seconds)
}

fn optics(rotation_deg: f64, scale_arcsec_px: f64, seconds: f64) -> Optics {
    Optics {
        camera: "cam".to_owned(),
        filter: Some("V".to_owned()),
        pier_side: Some(PierSide::East),
        bin: 1,
        scale_arcsec_px,
        rotation_deg,
        mirrored: false,
        sip: None,
        size_px: [2000, 1000],
        origin_px: [0, 0],
        faintest_mag: Some(15.0),
        exposure_s: 10.0,
        frames: 1,
        at_utc: at(seconds),
    }
}

fn lesson(optics: Optics) -> Lesson {
    Lesson { optics, zero_point: None }
}

fn zero(mag: f64, error_mag: f64, seconds: f64) -> Lesson {
    let measured = zero_point::Measured { mag, error_mag, stars: 20 };
    let (camera, filter) = ("cam".to_owned(), Some("V".to_owned()));
    let zero = ZeroPoint { camera, filter, gain: None, best_mag: mag, airmass: None, at_utc: at(seconds) };
    Lesson { zero_point: Some((measured, zero)), ..lesson(optics(10.0, 0.5, seconds)) }
}

#[test]
fn what_is_taught_first_is_known_at_once_and_each_side_of_the_pier_by_itself() {
    let (mut state, mut rivals) = (OpticsState::default(), Rivals::default());
    assert!(rivals.observe(&mut state, lesson(optics(10.0, 0.5, 0.0))));
    assert!(rivals.observe(&mut state, lesson(Optics { pier_side: Some(PierSide::West), ..optics(-170.0, 0.5, 1.0) })));
    let mut light = frame("f");
    light.purpose.filter = Some("V".to_owned());
    let rotation = |side| known(&state, &light, side).map(|optics| optics.rotation_deg);
    assert_eq!(rotation(Some(PierSide::East)), Some(10.0));
    assert_eq!(rotation(Some(PierSide::West)), Some(-170.0));
    assert_eq!(rotation(None), None);
    light.bin = 2;
    assert_eq!(known(&state, &light, Some(PierSide::East)), None, "another binning");
}

#[test]
fn a_camera_that_was_turned_is_learned_anew_by_its_second_frame_and_one_odd_frame_changes_nothing() {
    let (mut state, mut rivals) = (OpticsState::default(), Rivals::default());
    rivals.observe(&mut state, lesson(optics(179.8, 0.5, 0.0)));
    assert!(rivals.observe(&mut state, lesson(optics(-179.9, 0.5, 1.0))), "0.3 deg further: the same, a little turned");
    assert!(!rivals.observe(&mut state, lesson(optics(90.0, 0.5, 2.0))));
    assert!(!rivals.observe(&mut state, lesson(optics(-179.9, 0.5, 3.0))), "an odd one");
    assert!(!rivals.observe(&mut state, lesson(optics(90.0, 0.5, 4.0))), "the first one is forgotten");
    assert!(!rivals.observe(&mut state, lesson(optics(45.0, 0.5, 5.0))), "they disagree with one another");
    assert_eq!(state.optics[0].rotation_deg, -179.9);
    assert!(rivals.observe(&mut state, lesson(optics(45.1, 0.5, 6.0))));
    assert_eq!((state.optics.len(), state.optics[0].rotation_deg, state.optics[0].frames), (1, 45.1, 2));
    assert!(
        !rivals.observe(&mut state, lesson(optics(90.0, 0.6, 1.0))),
        "a frame of before the turn says nothing of now"
    );
}

#[test]
fn what_brings_nothing_new_is_not_written_down_again_and_again() {
    let (mut state, mut rivals) = (OpticsState::default(), Rivals::default());
    let news = (0..100).filter(|n| {
        rivals.observe(&mut state, lesson(optics(10.0 + 0.001 * f64::from(n % 3), 0.5, 30.0 * f64::from(*n))))
    });
    assert_eq!(news.collect::<Vec<_>>(), [0, 1, 62], "the first, the second, and after half an hour");
}

#[test]
fn distortion_is_used_only_on_the_part_of_the_sensor_that_showed_it() {
    let sip = Distortion { a: [1e-6; 7], b: [0.0; 7] };
    let known = Optics { sip: Some(sip), ..optics(0.0, 0.5, 0.0) };
    let mut light = Frame { width_px: 2000, height_px: 1000, ..frame("f") };
    assert_eq!(learned(&known, &light).sip, Some(Sip { a: sip.a, b: sip.b }));
    light.origin_px = [1, 0];
    assert_eq!(learned(&known, &light).sip, None);
}

#[test]
fn longer_frames_show_fainter_stars() {
    let mut light = frame("f");
    let known = optics(0.0, 0.5, 0.0);
    for (exposure_s, mag) in [(10.0, Some(15.0)), (100.0, Some(16.25)), (1.0, Some(13.75)), (0.01, None), (0.0, None)] {
        light.exposure_s = exposure_s;
        assert_eq!(faintest_mag(&known, &light), mag, "{exposure_s} s");
    }
}

#[test]
fn the_best_zero_point_is_what_two_frames_showed_and_grows_dusty() {
    let (mut state, mut rivals) = (OpticsState::default(), Rivals::default());
    let best = |state: &OpticsState| state.zero_points[0].best_mag;
    rivals.observe(&mut state, zero(21.0, 0.01, 0.0));
    assert_eq!(best(&state), 21.0);
    rivals.observe(&mut state, zero(22.0, 0.01, 10.0));
    assert_eq!(best(&state), 21.0, "one frame says nothing");
    rivals.observe(&mut state, zero(20.5, 0.01, 20.0));
    rivals.observe(&mut state, zero(21.4, 0.01, 30.0));
    assert_eq!(best(&state), 21.0, "the bright one was not confirmed by the next");
    rivals.observe(&mut state, zero(21.3, 0.01, 40.0));
    assert_eq!(best(&state), 21.3, "two in a row: the fainter of them");
    rivals.observe(&mut state, zero(30.0, 0.5, 50.0));
    rivals.observe(&mut state, zero(30.0, f64::NAN, 60.0));
    assert_eq!(best(&state), 21.3, "what is not known well does not count");
    let mut light = Frame { started_utc: at(40.0 + 100.0 * 86_400.0), ..frame("f") };
    light.purpose.filter = Some("V".to_owned());
    assert!((best_zero_point(&state, &light).unwrap() - 21.2).abs() < 1e-9, "after 100 days");
    light.purpose.filter = None;
    assert_eq!(best_zero_point(&state, &light), None);
}

#[test]
fn what_was_learned_outlives_a_restart_and_a_broken_file_is_learned_anew() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("optics.json");
    assert_eq!(OpticsState::read(&path), OpticsState::default());
    let state = OpticsState { optics: vec![optics(1.0, 0.5, 0.0)], zero_points: Vec::new() };
    crate::persisted::write_whole(&path, &folder.path().join("part"), &state).unwrap();
    assert_eq!(OpticsState::read(&path), state);
    std::fs::write(&path, "{").unwrap();
    assert_eq!(OpticsState::read(&path), OpticsState::default());
}
