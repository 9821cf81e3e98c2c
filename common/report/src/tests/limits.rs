//! Nights that are at a limit: very short frames, very many rows, no values, hostile values.

use super::*;
use crate::claim::{Claim, Rank, divide};
use crate::class::{Class, of_frame, of_timed};

fn piece(from_s: f64, to_s: f64, group: Group) -> TimelinePiece {
    TimelinePiece { from_utc: at(from_s), to_utc: at(to_s), group, kind: "x".to_owned() }
}

fn alert(number: u32) -> AlertRecord {
    AlertRecord {
        id: format!("dome-held/{number}"),
        priority: "high".to_owned(),
        raised_utc: at(f64::from(number)),
        cleared_utc: None,
        cause: "nobody renewed it".to_owned(),
        acknowledged_by: None,
    }
}

fn flux(frame: u32, star: u32, flux_adu: f64) -> FluxRecord {
    FluxRecord {
        frame: format!("f{frame}"),
        series: "WASP-12 V".to_owned(),
        star,
        x_px: 10.0,
        y_px: 10.0,
        flux_adu,
        error_adu: 100.0,
        is_saturated: false,
    }
}

/// A night of frames with a target and two comparison stars.
fn photometry(frames: u32) -> NightEvents {
    let mut events = night();
    events.frames = (0..frames).map(|id| frame(id, 60.0 * f64::from(id))).collect();
    events.fluxes = (0..frames).flat_map(|id| [flux(id, 0, 1e5), flux(id, 1, 2e5), flux(id, 2, 3e5)]).collect();
    events
}

#[test]
fn a_night_of_frames_shorter_than_a_tenth_of_a_pixel_is_drawn_as_light() {
    let mut report = make(&night());
    let short = |number: u32| {
        let from_s = 1000.0 + 4.0 * f64::from(number);
        [piece(from_s, from_s + 3.0, Group::OpenShutter), piece(from_s + 3.0, from_s + 4.0, Group::Overhead)]
    };
    report.timeline = vec![piece(0.0, 1000.0, Group::Idle)];
    report.timeline.extend((0..8750).flat_map(short));
    let bar = svg::bar(&report);
    assert_eq!(bar.matches("<rect").count(), 2);
    assert_eq!(bar.matches("<rect class=\"open_shutter\"").count(), 1);
}

#[test]
fn rows_that_a_table_does_not_show_are_counted_below_it() {
    let mut events = night();
    events.alerts = (0..500).map(alert).collect();
    assert!(!html::page(&make(&events)).contains("more are in the JSON"));
    events.alerts.extend((500..503).map(alert));
    let report = make(&events);
    let page = html::page(&report);
    assert!(page.contains("3 more are in the JSON") && !page.contains("dome-held/500"));
    assert_eq!(report.alerts.len(), 503);
}

#[test]
fn claims_from_before_all_time_to_after_it_fill_the_span_and_no_more() {
    let class = Class::new(Group::Idle, "x");
    let claim = Claim { from_ms: i64::MIN, to_ms: i64::MAX, rank: Rank::Idle, class };
    let pieces = divide(10, std::slice::from_ref(&claim));
    assert_eq!(pieces.iter().map(|piece| (piece.from_ms, piece.to_ms)).collect::<Vec<_>>(), [(0, 10)]);
    assert!(divide(0, std::slice::from_ref(&claim)).is_empty());
    assert!(divide(-5, &[claim]).is_empty());
}

#[test]
fn frames_without_a_usable_exposure_time_leave_the_night_whole() {
    for exposure_s in [f64::NAN, -60.0, 0.0] {
        let mut events = clear();
        for frame in &mut events.frames {
            frame.exposure_s = exposure_s;
        }
        let report = make(&events);
        assert_whole(&report);
        assert_eq!(time_s(&report, Group::OpenShutter), 0.0, "{exposure_s}");
    }
}

#[test]
fn each_reason_to_do_nothing_has_its_class() {
    type Change = fn(&mut NightEvents);
    let scenarios: [(&str, Change, Group, &str); 6] = [
        ("the switch", |e| e.doings[0].state.robotic = false, Group::Idle, "the robotic switch was off"),
        ("no schedule", |e| e.schedules.clear(), Group::Idle, "no schedule was active"),
        ("an empty one", |e| e.schedules[0].state.rows = 0, Group::Idle, "the schedule had no rows"),
        ("its end", |e| e.doings[0].state.ended = true, Group::Idle, "the schedule had ended"),
        ("a dome", |e| e.doings[0].state.posture = Posture::Opening, Group::Overhead, "dome opening"),
        (
            "not known",
            |e| e.doings[0].state.posture = Posture::Unknown,
            Group::Fault,
            "dome: whether it is closed was not known",
        ),
    ];
    for (name, change, group, kind) in scenarios {
        let mut events = night();
        events.doings = vec![held(-100.0, NIGHT_S + 100.0, doing(Posture::Closed, None))];
        change(&mut events);
        let report = make(&events);
        assert_whole(&report);
        assert_eq!(kind_s(&report, group, kind), NIGHT_S, "{name}");
    }
}

#[test]
fn an_unsafe_verdict_has_the_class_of_its_reason() {
    let scenarios = [
        ("sun", Group::Daytime, "the Sun was above its limit"),
        ("wx/Humidity", Group::Weather, "wx/Humidity"),
        ("wx/Humidity/frozen", Group::Fault, "wx/Humidity/frozen"),
        ("node/dome", Group::Fault, "node/dome"),
        ("configuration", Group::Fault, "configuration"),
    ];
    for (input, group, kind) in scenarios {
        let mut events = night();
        let reason = Reason { input: input.to_owned(), why: "x".to_owned(), is_missing: false };
        let state = VerdictRecord { verdict: Verdict::Unsafe, reasons: vec![reason], suspended: vec![] };
        events.verdicts = vec![held(1000.0, 3000.0, state)];
        assert_eq!(kind_s(&make(&events), group, kind), 2000.0, "{input}");
    }
}

#[test]
fn only_light_of_a_target_is_open_shutter() {
    let scenarios = [
        ("object", "Light Frame", Some(Group::OpenShutter)),
        ("object", "Dark Frame", Some(Group::Overhead)),
        ("autofocus", "Light Frame", Some(Group::Overhead)),
        ("guiding", "Light Frame", None),
    ];
    for (action, image_type, group) in scenarios {
        assert_eq!(of_frame(action, image_type).map(|class| class.group), group, "{action} {image_type}");
    }
    assert_eq!(of_timed("a part that is new").kind, "a part that is new");
}

#[test]
fn a_curve_has_five_frames_and_only_frames_that_count() {
    assert!(make(&photometry(4)).curves.is_empty());
    assert_eq!(make(&photometry(5)).curves[0].points.len(), 5);
    let mut events = photometry(8);
    events.frames[3].refused = Some("clouds".to_owned());
    events.frames.remove(0);
    events.fluxes.reverse();
    let curves = make(&events).curves;
    assert_eq!(curves[0].points.len(), 6, "neither the refused frame nor the one that is not stored");
    assert!(curves[0].points.windows(2).all(|pair| pair[0].mid_utc < pair[1].mid_utc));
    for flux in events.fluxes.iter_mut().filter(|flux| flux.star == 0) {
        flux.is_saturated = true;
    }
    assert!(make(&events).curves.is_empty());
}

#[test]
fn no_figure_is_a_mean_of_two_cameras_binnings_or_exposures() {
    let mut events = photometry(8);
    let other = |id: u32, camera: &str, bin, exposure_s, sky_adu| FrameRecord {
        camera: camera.to_owned(),
        bin,
        exposure_s,
        sky_adu: Some(sky_adu),
        ..frame(id, 60.0 * f64::from(id))
    };
    events.frames.push(other(100, "second", 1, 60.0, 9000.0));
    events.frames.push(other(101, "andor", 2, 60.0, 1200.0));
    events.frames.push(other(102, "andor", 1, 10.0, 50.0));
    let guided = |camera: &str, bin, off_px| GuideRecord {
        object: Some("WASP-12".to_owned()),
        camera: camera.to_owned(),
        bin,
        off_px,
    };
    events.guiding = vec![
        guided("guider", Some(1), 3.0),
        guided("andor", Some(1), 4.0),
        guided("guider", Some(1), 4.0),
        guided("andor", Some(2), 2.0),
        guided("guider", None, 0.5),
    ];
    let report = make(&events);
    let of_sky = |of: &summary::Quality| (of.camera.clone(), of.bin, of.exposure_s, of.sky_adu);
    let sky: Vec<_> = report.targets[0].quality.iter().map(of_sky).collect();
    let expected = [
        ("andor", 1, 10.0, Some(50.0)),
        ("andor", 1, 60.0, Some(300.0)),
        ("andor", 2, 60.0, Some(1200.0)),
        ("second", 1, 60.0, Some(9000.0)),
    ];
    assert_eq!(sky, expected.map(|(camera, bin, exposure_s, sky)| (camera.to_owned(), bin, exposure_s, sky)));
    let held: Vec<_> = report.guiding.iter().map(|of| (&*of.camera, of.bin, of.frames, of.rms_px)).collect();
    let expected = [
        ("andor", Some(1), 1, 4.0),
        ("andor", Some(2), 1, 2.0),
        ("guider", None, 1, 0.5),
        ("guider", Some(1), 2, 12.5_f64.sqrt()),
    ];
    assert_eq!(held, expected);
    // A series of another exposure or binning lacks nothing of this one.
    assert_eq!((report.curves[0].points.len(), report.curves[0].frames_left_out), (8, 0));
    let page = html::page(&report);
    assert!(page.contains("second, bin 1, 60 s") && page.contains("guider"), "{page}");
}

#[test]
fn a_width_without_a_scale_is_no_point_of_a_curve_in_arcsec() {
    let mut events = photometry(8);
    events.frames[3].scale_arcsec_px = None;
    let widths: Vec<_> = make(&events).curves[0].points.iter().map(|point| point.fwhm_arcsec).collect();
    assert_eq!((widths[2], widths[3], widths[4]), (Some(1.5), None, Some(1.5)));
}

#[test]
fn values_that_are_no_numbers_are_left_out_of_guiding_and_of_the_page() {
    let mut events = clear();
    let guide = |off_px| GuideRecord { object: None, camera: "andor".to_owned(), bin: None, off_px };
    events.guiding = vec![guide(3.0), guide(f64::NAN), guide(f64::INFINITY), guide(4.0)];
    for frame in &mut events.frames {
        frame.fwhm_px = Some(f64::NAN);
    }
    let report = make(&events);
    assert_eq!((report.guiding[0].frames, report.guiding[0].rms_px), (2, 12.5_f64.sqrt()));
    assert_eq!(report.targets[0].quality[0].fwhm_arcsec, None);
    assert!(!html::page(&report).contains("NaN"));
}

#[test]
fn rows_of_a_longer_schedule_before_are_no_rows_of_this_one() {
    let mut events = clear();
    let old = RowState { row: 7, ..row(RowStatus::Pending, 20_000.0, 30_000.0) };
    events.rows.insert(0, RowChange { at: at(-200.0), row: old });
    let report = make(&events);
    assert_eq!(report.rows.len(), 1);
    assert_eq!(report.targets[0].frames_asked, Some(100));
    assert_eq!(kind_s(&report, Group::Idle, "no row was left"), NIGHT_S - 6450.0);
}

#[test]
fn a_night_in_which_nothing_was_tried_has_the_reason_and_one_frame_is_something() {
    let mut events = night();
    events.doings = vec![held(-100.0, NIGHT_S + 100.0, doing(Posture::Closed, None))];
    let reason = Reason { input: "wx/Humidity".to_owned(), why: "x".to_owned(), is_missing: false };
    let state = VerdictRecord { verdict: Verdict::Unsafe, reasons: vec![reason], suspended: vec![] };
    events.verdicts = vec![held(0.0, 30_000.0, state)];
    let report = make(&events);
    let why = report.nothing_tried.clone().unwrap();
    assert_eq!(why, "The night was weather and safety 8 h 20 min (wx/Humidity), idle 1 h 40 min (no row was left).");
    assert!(html::page(&report).contains("Nothing was tried.</b> The night was weather"));
    events.frames.push(frame(1, 100.0));
    assert_eq!(make(&events).nothing_tried, None);
    assert_eq!(make(&clear()).nothing_tried, None);
}

#[test]
fn rows_that_cannot_be_read_are_on_the_page() {
    let mut events = clear();
    assert!(!html::page(&make(&events)).contains("Left out"));
    events.unreadable = vec!["the state `night` of 2026-11-21 03:00:00: <nothing>".to_owned()];
    let report = make(&events);
    assert_eq!(report.unreadable, events.unreadable);
    assert!(html::page(&report).contains("03:00:00: &lt;nothing&gt;"));
}

/// The flux of a star: its level, how much it varies from frame to frame, and its error.
type Star = (f64, f64, f64);

/// A night of a target and its comparison stars, with the noise of their errors.
fn night_of(stars: &[Star]) -> NightEvents {
    let mut events = photometry(120);
    events.fluxes.clear();
    let mut seed = 7_u64;
    let mut noise = || -> f64 {
        let uniform = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 11) as f64 / (1_u64 << 53) as f64
        };
        std::iter::repeat_with(uniform).take(12).sum::<f64>() - 6.0
    };
    for id in 0..120 {
        let clouds = 1.0 - 0.3 * f64::from(id % 7) / 7.0;
        for (star, (level, varies, error_adu)) in (0..).zip(stars) {
            let phase = f64::from(id) / 9.0 + f64::from(star);
            let flux_adu = clouds * level * (1.0 + varies * phase.sin()) + error_adu * noise();
            events.fluxes.push(FluxRecord { error_adu: *error_adu, ..flux(id, star, flux_adu) });
        }
    }
    events
}

#[test]
fn a_variable_star_among_few_is_left_out_where_the_others_show_which_it_is_and_else_there_is_a_warning() {
    let (quiet, varies, faint) = ((2e5, 0.0, 200.0), (3e5, 0.05, 200.0), (4e3, 0.0, 100.0));
    let (target, moving) = ((1e5, 0.0, 150.0), (1e5, 0.03, 150.0));
    for (what, stars, left, variable, warning) in [
        ("two quiet ones", vec![target, quiet, quiet], 2, 0, None),
        ("two quiet ones, and a target that varies", vec![moving, quiet, quiet], 2, 0, None),
        ("one of three varies", vec![moving, quiet, varies, quiet], 2, 1, None),
        ("one of four varies", vec![moving, varies, quiet, quiet, faint], 3, 1, None),
        ("two of four vary", vec![moving, varies, quiet, varies, quiet], 2, 2, None),
        (
            "one of two varies, and the target shows which",
            vec![target, quiet, varies],
            1,
            1,
            Some("one comparison star"),
        ),
        ("all vary", vec![moving, quiet, varies], 2, 0, Some("which of them varies cannot be seen")),
        ("one", vec![target, quiet], 1, 0, Some("one comparison star")),
        ("faint ones hide nothing", vec![target, quiet, quiet, faint, faint, faint, varies], 5, 1, None),
    ] {
        let curves = make(&night_of(&stars)).curves;
        let curve = &curves[0];
        assert_eq!((curve.comparison_stars, curve.variable_stars), (left, variable), "{what}: {:?}", curve.warnings);
        assert_eq!(curve.warnings.is_empty(), warning.is_none(), "{what}: {:?}", curve.warnings);
        assert!(warning.is_none_or(|words| curve.warnings[0].contains(words)), "{what}: {:?}", curve.warnings);
        let page = html::page(&make(&night_of(&stars)));
        assert_eq!(page.contains("<b>Warning:</b>"), warning.is_some(), "{what}");
    }
}
