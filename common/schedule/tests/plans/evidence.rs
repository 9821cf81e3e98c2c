//! Overheads from frames and diaries.

use config::Observatory;
use contract::device::camera::Frame;
use schedule::plan::{Evidence, Figure, Overheads, TakenFrame, TimedPart};
use units::Utc;

/// Any frame: that of the contract's golden sample.
const FRAME: &str = include_str!("../../../contract/golden/v1/camera.frame.json");

fn config() -> Observatory {
    let text = "[observatory]\nsite = \"a\"\ntelescope = \"b\"\nlatitude_deg = 0\nlongitude_deg = 0\nelevation_m = 0\n\
                [schedule.check]\nframe_overhead_s = 7.5\n[[telescope]]\nname = \"m\"\nserver = \"a:1\"\nsettle_s = 4.0\n";
    config::parse(text, std::path::Path::new(".")).unwrap()
}

fn frame(action: &str, sequence: u32, at_s: f64, exposure_s: f64) -> TakenFrame {
    let mut frame: Frame = serde_json::from_str(FRAME).unwrap();
    frame.camera = "cam".to_owned();
    (frame.purpose.action, frame.purpose.sequence, frame.purpose.row) = (action.to_owned(), sequence, Some(3));
    (frame.started_utc, frame.exposure_s) = (Utc::from_seconds(1.8e9 + at_s), exposure_s);
    (frame.width_px, frame.height_px, frame.bin, frame.planes) = (1000, 500, 2, 1);
    TakenFrame::of(&frame, 1_002_880)
}

fn line(text: &str) -> (Utc, String) {
    (Utc::EPOCH, text.to_owned())
}

#[test]
fn a_gap_is_between_two_frames_of_one_row_that_follow_each_other() {
    let mut frames: Vec<TakenFrame> = (0..10).map(|n| frame("object", n, f64::from(n) * 34.0, 30.0)).collect();
    // Another row begins after an hour, one frame is missing, and the dome was shut for a while.
    frames.push(frame("object", 0, 4000.0, 30.0));
    frames.push(frame("object", 2, 4100.0, 30.0));
    frames.push(frame("object", 3, 9000.0, 30.0));
    frames.push(frame("calibration", 0, 10_000.0, 5.0));
    frames.reverse();
    let overheads = Evidence { frames, lines: Vec::new() }.overheads(&config());
    assert_eq!(overheads.frame("object"), Figure { value: 4.0, measured: 9 });
    assert_eq!(overheads.frame("calibration"), overheads.other_frame_s, "one frame has no gap");
    let sensor = overheads.sensor("cam");
    assert_eq!((sensor.size_px, sensor.measured), ([2000, 1000], 14));
    assert!((sensor.bytes_per_px - 2.005_76).abs() < 1e-9);
}

#[test]
fn diaries_show_what_was_done_and_how_long_it_took() {
    let lines = [
        "took row=1 span=open took_s=40.5",
        "took row=4 span=open took_s=44.5",
        "took deg=x span=close took_s=NaN",
        "took span=nothing took_s=3",
        "row begins action=object row=3",
        "took span=filter",
        "tooks span=filter took_s=3",
    ];
    let overheads = Evidence { frames: Vec::new(), lines: lines.map(line).to_vec() }.overheads(&config());
    assert_eq!(overheads.span(TimedPart::Open), Figure { value: 42.5, measured: 2 });
    let assumed = Overheads::assumed(&config());
    for span in [TimedPart::Close, TimedPart::Filter, TimedPart::Slew] {
        assert_eq!(overheads.span(span), assumed.span(span), "{span:?}");
    }
}

#[test]
fn slews_show_what_a_degree_takes_whatever_one_odd_one_took() {
    let slew = |deg: f64, took_s: f64| line(&format!("took deg={deg} span=slew took_s={took_s}"));
    let ways = [2.0, 10.0, 25.0, 40.0, 70.0, 110.0];
    let mut lines: Vec<(Utc, String)> = ways.iter().map(|deg| slew(*deg, 6.0 + 0.25 * deg)).collect();
    lines.push(slew(5.0, 300.0));
    let overheads = Evidence { frames: Vec::new(), lines }.overheads(&config());
    assert!((overheads.slew_s_per_deg.value - 0.25).abs() < 0.02, "{:?}", overheads.slew_s_per_deg);
    assert_eq!(overheads.slew_s_per_deg.measured, 7);
    assert!((overheads.slew_s(60.0) - 21.0).abs() < 1.0, "{}", overheads.slew_s(60.0));
    // Short ways alone give no time per degree.
    let few = Evidence { frames: Vec::new(), lines: vec![slew(3.0, 9.0), slew(6.0, 10.0)] }.overheads(&config());
    assert_eq!((few.slew_s_per_deg.measured, few.span(TimedPart::Slew).measured), (0, 2));
    assert!((few.slew_s(4.5) - 9.5).abs() < 0.1);
}

#[test]
fn what_nobody_measured_comes_from_the_configuration_or_is_assumed() {
    let overheads = Overheads::assumed(&config());
    assert_eq!(overheads.frame("object"), Figure::assumed(7.5));
    assert_eq!((overheads.slew_s(0.0), overheads.slew_s(30.0)), (9.0, 19.0));
    assert_eq!(overheads.sensor("cam").measured, 0);
    assert!(overheads.figures().iter().all(|(_, figure, _)| figure.measured == 0));
}
