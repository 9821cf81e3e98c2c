//! Named nights.

use contract::observatory::{ActionNow, Posture, RowStatus, Verdict};

use super::*;
use crate::events::*;

mod limits;

/// Sunset; sunrise is 10 h later.
const SUNSET_S: f64 = 1_795_220_000.0;
const NIGHT_S: f64 = 36_000.0;

fn at(second: f64) -> Utc {
    Utc::from_seconds(SUNSET_S + second)
}

fn held<T>(from_s: f64, until_s: f64, state: T) -> Held<T> {
    Held { from: at(from_s), until: at(until_s), boot: "a".to_owned(), seq: 100, state }
}

fn doing(posture: Posture, action: Option<(&str, &str)>) -> Doing {
    let action = action.map(|(action, step)| ActionNow {
        row: 0,
        action: action.to_owned(),
        camera: "andor".to_owned(),
        object: Some("WASP-12".to_owned()),
        step: step.to_owned(),
        started_utc: at(0.0),
        expected_by_utc: None,
    });
    Doing { robotic: true, posture, ended: false, speed: 1.0, simulated: false, actions: action.into_iter().collect() }
}

fn row(status: RowStatus, start_s: f64, end_s: f64) -> RowState {
    RowState {
        row: 0,
        action: "object".to_owned(),
        camera: "andor".to_owned(),
        object: Some("WASP-12".to_owned()),
        start_utc: at(start_s),
        end_utc: at(end_s),
        status,
        frames: 0,
        frames_wanted: Some(100),
        detail: String::new(),
    }
}

fn frame(id: u32, started_s: f64) -> FrameRecord {
    FrameRecord {
        id: format!("f{id}"),
        file: format!("20261121/f{id}.fits"),
        camera: "andor".to_owned(),
        action: "object".to_owned(),
        image_type: "Light Frame".to_owned(),
        object: Some("WASP-12".to_owned()),
        filter: Some("V".to_owned()),
        started: at(started_s),
        exposure_s: 60.0,
        bin: 1,
        is_complete: true,
        is_solved: true,
        fwhm_px: Some(3.0),
        scale_arcsec_px: Some(0.5),
        row: Some(0),
        bytes: 8_000_000,
        refused: None,
        unmeasured: None,
        ellipticity: Some(0.1),
        sky_adu: Some(300.0),
        transparency: Some(0.9),
        off_target_arcmin: Some(0.2),
        airmass: Some(1.2),
    }
}

fn night() -> NightEvents {
    let schedule = ScheduleRecord { file: "schedule.jsonl".to_owned(), revision: 1, refused: None, rows: 1 };
    NightEvents {
        site: "paranal".to_owned(),
        telescope: "callisto".to_owned(),
        night: "20261121".to_owned(),
        dark: Some((at(0.0), at(NIGHT_S))),
        schedules: vec![held(-100.0, NIGHT_S, schedule)],
        ..NightEvents::new(at(-20_000.0), at(66_400.0), at(60_000.0))
    }
}

/// A row from 1000 s to 7000 s: dome, slew, 80 frames of 60 s with 5 s between them, dome; then nothing is left.
fn clear() -> NightEvents {
    let mut events = night();
    events.doings = vec![
        held(-100.0, 999.0, doing(Posture::Closed, None)),
        held(1000.0, 1099.0, doing(Posture::Opening, Some(("object", "opening")))),
        held(1100.0, 1149.0, doing(Posture::Open, Some(("object", "slewing")))),
        held(1150.0, 6349.0, doing(Posture::Open, Some(("object", "frame of 100, 60 s, V")))),
        held(6350.0, 6449.0, doing(Posture::Closing, None)),
        held(6450.0, NIGHT_S + 100.0, doing(Posture::Closed, None)),
    ];
    events.rows = vec![
        RowChange { at: at(-100.0), row: row(RowStatus::Pending, 1000.0, 7000.0) },
        RowChange { at: at(1000.0), row: row(RowStatus::Running, 1000.0, 7000.0) },
        RowChange { at: at(6350.0), row: row(RowStatus::Finished, 1000.0, 7000.0) },
    ];
    events.frames = (0..80).map(|id| frame(id, 1150.0 + 65.0 * f64::from(id))).collect();
    events
}

fn time_s(report: &Report, group: Group) -> f64 {
    report.times.iter().find(|time| time.group == group).unwrap().time_s
}

fn kind_s(report: &Report, group: Group, kind: &str) -> f64 {
    let time = report.times.iter().find(|time| time.group == group).unwrap();
    time.kinds.iter().find(|of| of.kind == kind).map_or(0.0, |of| of.time_s)
}

fn assert_whole(report: &Report) {
    let sum: f64 = report.times.iter().map(|time| time.time_s).sum();
    assert!((sum - report.to_utc.seconds_since(report.from_utc)).abs() < 1e-6, "{sum}");
    for pair in report.timeline.windows(2) {
        assert_eq!(pair[0].to_utc, pair[1].from_utc);
    }
}

#[test]
fn a_clear_night_is_light_overhead_and_idle() {
    let report = make(&clear());
    assert_whole(&report);
    assert_eq!((report.from_utc, report.to_utc), (at(0.0), at(NIGHT_S)));
    assert_eq!(time_s(&report, Group::OpenShutter), 80.0 * 60.0);
    assert_eq!(kind_s(&report, Group::Overhead, "dome opening"), 100.0);
    assert_eq!(kind_s(&report, Group::Overhead, "slew"), 50.0);
    assert_eq!(kind_s(&report, Group::Overhead, "readout and download"), 5200.0 - 4800.0);
    assert_eq!(kind_s(&report, Group::Overhead, "dome closing"), 100.0);
    assert_eq!(kind_s(&report, Group::Idle, "no row was due yet"), 1000.0);
    assert_eq!(kind_s(&report, Group::Idle, "no row was left"), NIGHT_S - 6450.0);
    assert_eq!(report.unexplained_share, 0.0);
    let target = &report.targets[0];
    assert_eq!((target.frames_asked, target.frames_taken, target.frames_counted), (Some(100), 80, 80));
    assert_eq!((target.exposure_s, target.quality[0].fwhm_arcsec), (4800.0, Some(1.5)));
}

#[test]
fn rain_in_the_middle_is_weather_except_while_light_was_collected() {
    let mut events = clear();
    let rain = |input: &str, is_missing| VerdictRecord {
        verdict: Verdict::Unsafe,
        reasons: vec![Reason { input: input.to_owned(), why: "raining".to_owned(), is_missing }],
        suspended: vec![],
    };
    // It begins in the middle of a frame.
    events.verdicts = vec![held(1180.0, 3180.0, rain("wx/RainRate", false))];
    let report = make(&events);
    assert_whole(&report);
    let lit = time_s(&report, Group::OpenShutter);
    assert_eq!(lit, 4800.0, "frames that were taken all the same count as light, once");
    let dry = 2000.0 - time_s(&report, Group::Weather);
    assert!(dry > 1700.0 && dry < 2000.0, "of 2000 s of rain {dry} had light");
    assert_eq!(report.times[2].kinds[0].kind, "wx/RainRate");
    // A sensor without values is a fault of that sensor, and no weather.
    events.frames.clear();
    events.verdicts = vec![held(1180.0, 3180.0, rain("safetymonitor/monitor", true))];
    let report = make(&events);
    assert_eq!(kind_s(&report, Group::Fault, "safetymonitor/monitor"), 2000.0);
    assert_eq!(time_s(&report, Group::Weather), 0.0);
    // A person's order is neither.
    events.verdicts = vec![held(1180.0, 3180.0, rain("stay closed", false))];
    assert_eq!(kind_s(&make(&events), Group::Idle, "a person ordered to stay closed"), 2000.0);
}

#[test]
fn a_dome_fault_is_counted_for_the_dome() {
    let mut events = night();
    let step = "trying again after: dome/dome_1 failed to open: the motor is hot";
    events.doings = vec![
        held(-100.0, 999.0, doing(Posture::Closed, None)),
        held(1000.0, 1499.0, doing(Posture::Closed, Some(("object", step)))),
        held(1500.0, NIGHT_S, doing(Posture::Closed, None)),
    ];
    let mut failed = row(RowStatus::Interrupted, 1000.0, 30_000.0);
    failed.detail = "postponed: dome/dome_1 failed to open: the motor is hot".to_owned();
    events.rows = vec![
        RowChange { at: at(-100.0), row: row(RowStatus::Pending, 1000.0, 30_000.0) },
        RowChange { at: at(1500.0), row: failed },
    ];
    let report = make(&events);
    assert_whole(&report);
    assert_eq!(kind_s(&report, Group::Fault, "dome/dome_1"), 29_000.0);
    assert_eq!(kind_s(&report, Group::Idle, "no row was left"), NIGHT_S - 30_000.0);
}

#[test]
fn a_night_without_any_record_is_unexplained_and_the_page_is_written_all_the_same() {
    let mut events = night();
    events.schedules.clear();
    let report = make(&events);
    assert_whole(&report);
    assert_eq!((report.unexplained_share, time_s(&report, Group::Unexplained)), (1.0, NIGHT_S));
    assert!(html::page(&report).contains("No target was asked for"));
    // Where the Sun does not set and nothing happened there is nothing to be explained.
    events.dark = None;
    let report = make(&events);
    assert_eq!((report.span_s, report.unexplained_share, report.timeline.len()), (0.0, 0.0, 0));
    assert!(html::page(&report).contains("</html>"));
}

#[test]
fn a_restart_of_the_observatory_node_is_a_fault_and_one_of_the_archive_is_unexplained() {
    let mut events = clear();
    // The observatory node is silent from 7000 to 7300 s, and has another incarnation then.
    events.doings[5].until = at(7000.0);
    events.doings.push(held(7300.0, 10_000.0, doing(Posture::Closed, None)));
    (events.doings[6].boot, events.doings[6].seq) = ("b".to_owned(), 0);
    // The archive is away from 10,000 to 10,100 s: the same incarnation publishes afterwards.
    events.doings.push(held(10_100.0, NIGHT_S + 5.0, doing(Posture::Closed, None)));
    events.doings[7].boot = "b".to_owned();
    let report = make(&events);
    assert_whole(&report);
    assert_eq!(kind_s(&report, Group::Fault, "restart of the observatory node"), 300.0);
    assert_eq!(time_s(&report, Group::Unexplained), 100.0);
    assert!((report.unexplained_share - 100.0 / NIGHT_S).abs() < 1e-9);
    // Where the archive has not seen the beginning of the new incarnation, nobody knows when it began.
    events.doings[6].seq = 900;
    assert_eq!(time_s(&make(&events), Group::Unexplained), 400.0);
}

#[test]
fn before_the_first_start_of_the_observatory_node_it_did_not_run() {
    let mut events = clear();
    events.doings.retain(|held| held.from >= at(1100.0));
    assert_eq!(time_s(&make(&events), Group::Unexplained), 1100.0);
    events.doings[0].seq = 0;
    let report = make(&events);
    assert_whole(&report);
    assert_eq!(kind_s(&report, Group::Fault, "the observatory node did not run"), 1100.0);
}

#[test]
fn steps_that_overlap_are_counted_once_and_measured_parts_go_first() {
    let mut events = clear();
    events.frames.clear();
    // Two cameras: one slews while the other one cools; a filter turned meanwhile, which was measured.
    let mut both = doing(Posture::Open, Some(("object", "slewing")));
    both.actions.extend(doing(Posture::Open, Some(("object", "cooling"))).actions);
    events.doings[3].state = both;
    events.timed = vec![Timed { until: at(2000.0), took_s: 12.5, part: "filter".to_owned() }];
    let report = make(&events);
    assert_whole(&report);
    assert_eq!(kind_s(&report, Group::Overhead, "filter"), 12.5);
    assert_eq!(kind_s(&report, Group::Overhead, "slew"), 50.0 + 5200.0 - 12.5);
    assert_eq!(kind_s(&report, Group::Overhead, "cooling"), 0.0);
}

#[test]
fn two_cameras_that_expose_at_once_are_one_open_shutter_and_flats_before_sunset_are_overhead() {
    let mut events = clear();
    let mut second = events.frames.clone();
    for frame in &mut second {
        (frame.camera, frame.id) = ("guide".to_owned(), format!("{}b", frame.id));
    }
    events.frames.extend(second);
    let flat = |started_s| FrameRecord {
        action: "flats".to_owned(),
        image_type: "Flat Frame".to_owned(),
        exposure_s: 10.0,
        ..frame(900, started_s)
    };
    events.frames.push(flat(-500.0));
    let report = make(&events);
    assert_whole(&report);
    assert_eq!(report.from_utc, at(-500.0));
    assert_eq!(time_s(&report, Group::OpenShutter), 4800.0);
    assert_eq!(kind_s(&report, Group::Overhead, "calibration frames"), 10.0);
    assert_eq!(time_s(&report, Group::Daytime), 490.0);
    assert_eq!(report.targets[0].frames_taken, 160, "a flat is no frame of a target");
}

#[test]
fn a_night_that_runs_ends_with_its_newest_state() {
    let mut events = clear();
    events.now = at(3000.5);
    events.doings.truncate(4);
    events.doings[3].until = at(3000.0);
    events.frames.truncate(28);
    let report = make(&events);
    assert!(report.is_running);
    assert_eq!((report.to_utc, report.unexplained_share), (at(3000.0), 0.0));
    assert!(html::page(&report).contains("the night is not over"));
}

#[test]
fn hostile_names_stay_text() {
    let hostile = "<script>alert(1)</script>\"'&\u{202e}\u{7}";
    let mut events = clear();
    events.site = hostile.to_owned();
    for frame in &mut events.frames {
        frame.object = Some(hostile.to_owned());
        frame.filter = Some(hostile.to_owned());
        frame.refused = Some(hostile.to_owned());
    }
    events.rows[2].row.detail = hostile.to_owned();
    events.doings[2].state.actions[0].step = format!("trying again after: {hostile}");
    events.verdicts = vec![held(
        8000.0,
        9000.0,
        VerdictRecord {
            verdict: Verdict::Unsafe,
            reasons: vec![Reason { input: hostile.to_owned(), why: hostile.to_owned(), is_missing: false }],
            suspended: vec![],
        },
    )];
    events.alerts = vec![AlertRecord {
        id: hostile.to_owned(),
        priority: "high".to_owned(),
        raised_utc: at(1.0),
        cleared_utc: None,
        cause: hostile.to_owned(),
        acknowledged_by: Some(hostile.to_owned()),
    }];
    events.orders = vec![OrderRecord {
        at_utc: at(1.0),
        from: hostile.to_owned(),
        verb: hostile.to_owned(),
        outcome: hostile.to_owned(),
    }];
    let page = html::page(&make(&events));
    assert!(page.contains("&lt;script&gt;alert(1)&lt;/script&gt;&quot;&#39;&amp;"));
    assert!(!page.contains("<script") && !page.contains('\u{202e}') && !page.contains('\u{7}'));
}

#[test]
fn a_transit_has_its_depth_in_the_curve_and_a_variable_star_is_no_comparison() {
    let mut events = night();
    events.frames = (0..100).map(|id| frame(id, 60.0 * f64::from(id))).collect();
    for id in 0..100_u32 {
        let dip = if (40..60).contains(&id) { 0.99 } else { 1.0 };
        let clouds = 1.0 - 0.3 * f64::from(id % 7) / 7.0;
        for (star, flux) in [(0, 1e5 * dip), (1, 2e5), (2, 1.5e5), (3, 3e5), (4, 2e5 * (1.0 + 0.1 * f64::from(id % 3)))]
        {
            events.fluxes.push(FluxRecord {
                frame: format!("f{id}"),
                series: "WASP-12 V".to_owned(),
                star,
                x_px: 10.0,
                y_px: 10.0,
                flux_adu: flux * clouds,
                error_adu: 100.0,
                is_saturated: id == 7 && star == 0,
            });
        }
    }
    events.fluxes[20].flux_adu = f64::NAN;
    let curves = make(&events).curves;
    let curve = &curves[0];
    assert_eq!((curve.comparison_stars, curve.points.len(), curve.frames_left_out), (3, 98, 2));
    let mean = |from: f64, to: f64| {
        let inside: Vec<f64> = curve
            .points
            .iter()
            .filter(|point| (from..to).contains(&point.mid_utc.seconds_since(at(0.0))))
            .map(|point| point.flux)
            .collect();
        inside.iter().sum::<f64>() / inside.len() as f64
    };
    assert!((mean(2430.0, 3590.0) - 0.99).abs() < 1e-6 && (mean(0.0, 2400.0) - 1.0).abs() < 1e-6);
}
