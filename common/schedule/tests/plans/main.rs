//! Forecasts: golden ones, those of any schedule, and the origin of their figures. One binary, because a link costs
//! more than the tests.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod any_schedule;
mod evidence;
mod golden;
mod sky;
#[allow(dead_code, reason = "it is an example too")]
#[path = "../../examples/plans_a_year.rs"]
mod year;

use std::path::Path;
use std::sync::Arc;

use contract::observatory::{PlanBegun, RowBegun, RowStatus};
use schedule::Row;
use schedule::plan::{Evidence, PlannedRow, Site, forecast_while};
use schedule::validate::{KnownFacts, accept};
use units::Utc;

/// Two cameras on one mount, a dome, a wheel; a slew takes 6 s and a third of a second per degree, a frame 2 s.
const SITE: &str = concat!(
    include_str!("../../../config/tests/paranal.toml"),
    r#"[schedule.check]
frame_overhead_s = 2.0
[[telescope]]
name = "mount"
server = "10.0.0.5:11111"
settle_s = 1.0
meridian_flip = true
meridian_flip_min = 5.0
limits = { altitude_min_deg = 20.0 }
[[camera]]
name = "main"
server = "10.0.0.5:11111"
telescope = "mount"
filterwheel = "wheel"
[[camera]]
name = "second"
server = "10.0.0.5:11111"
number = 1
telescope = "mount"
[[filterwheel]]
name = "wheel"
server = "10.0.0.5:11111"
filters = ["B", "V", "R"]
[[dome]]
name = "dome"
server = "10.0.0.5:11111"
"#
);

#[test]
fn a_night_of_the_year_is_planned() {
    let (report, _) = year::plan(1).unwrap();
    assert!(report.starts_with("1 nights, 39 rows"), "{report}");
}

mod proof {
    /// A bound in seconds on a real clock.
    #[test]
    fn a_week_is_planned_in_seconds() {
        let (report, took_s) = super::year::plan(7).unwrap();
        println!("{report}: planned in {took_s:.2} s");
        // A year of them would take half an hour at this limit, on a busy machine and without optimization.
        assert!(report.starts_with("7 nights, 273 rows") && took_s < 35.0, "{report}: {took_s} s");
    }
}

#[test]
fn a_forecast_that_takes_too_long_is_given_up_and_one_that_does_not_is_the_whole() {
    let rows_of_a_week = || {
        let row = |day: u32| {
            format!(
                "{{\"device_name\": \"main\", \"action_type\": \"object\", \"action_value\": {{\"object\": \"x{day}\", \"exptime\": 60, \"ra\": \
                 45.0, \"dec\": -24.6, \"n\": 3}}, \"start_time\": \"2026-11-{day} 03:00:00\", \"end_time\": \"2026-11-{day} 04:00:00\"}}\n"
            )
        };
        rows(&(20..27).map(row).collect::<String>())
    };
    let asked = std::cell::Cell::new(0);
    let goes_on = |most: u32| {
        asked.set(asked.get() + 1);
        asked.get() <= most
    };
    assert!(forecast_while(rows_of_a_week(), &mut site(), &|| goes_on(5)).unwrap().is_none());
    assert!(asked.get() < 10, "it ends soon: asked {} times", asked.get());
    let whole = forecast_while(rows_of_a_week(), &mut site(), &|| true).unwrap().unwrap();
    let published = whole.published(&site());
    assert_eq!((whole.frames(), published.rows.len(), published.night.unwrap().frames), (21, 7, 21));
    assert_eq!(published.cameras.iter().map(|sensor| sensor.camera.as_str()).collect::<Vec<_>>(), ["main"]);
}

#[test]
fn the_rest_of_a_night_begins_with_what_has_happened() {
    let row = |object: &str, start: &str, end: &str| {
        format!(
            "{{\"device_name\": \"main\", \"action_type\": \"object\", \"action_value\": {{\"object\": \"{object}\", \"exptime\": 60, \
             \"ra\": 45.0, \"dec\": -24.6, \"n\": 20}}, \"start_time\": \"2026-11-21 {start}\", \"end_time\": \"2026-11-21 {end}\"}}\n"
        )
    };
    let text =
        [row("a", "02:00:00", "03:00:00"), row("b", "03:00:00", "04:00:00"), row("c", "04:00:00", "05:00:00")].concat();
    let plan = |begun: Option<PlanBegun>| {
        let mut site = site();
        site.begun = begun;
        forecast_while(rows(&text), &mut site, &|| true).unwrap().unwrap()
    };
    let at = |time: &str| format!("2026-11-21T{time}Z").parse::<Utc>().unwrap();
    let begun = |time: &str, rows: Vec<RowBegun>| Some(PlanBegun { at_utc: at(time), open: true, rows });
    let whole = plan(None);
    assert_eq!(whole.rows.iter().map(|row| row.frames).collect::<Vec<_>>(), [20, 20, 20]);
    // One row is done, and of the next one 15 frames are taken.
    let of = |row, status, frames| RowBegun { row, status, frames };
    let rest = plan(begun("03:20:00", vec![of(0, RowStatus::Failed, 7), of(1, RowStatus::Running, 15)]));
    let [a, b, c] = &rest.rows[..] else { panic!("{:?}", rest.rows) };
    assert_eq!((a.status, a.frames, a.span()), (RowStatus::Failed, 7, None), "it has ended, and does not run again");
    let (from, to) = b.span().unwrap();
    assert_eq!((b.status, b.frames, from), (RowStatus::Finished, 20, at("03:20:00")));
    let frames_s = 5.0 * 62.0;
    assert!((frames_s..frames_s + 300.0).contains(&to.seconds_since(from)), "{from} to {to}");
    let begins = |row: &PlannedRow| row.span().map(|(from, _)| from);
    assert_eq!(
        (c.status, c.frames, begins(c)),
        (RowStatus::Finished, 20, begins(&whole.rows[2])),
        "what is to come stays"
    );
    // A row whose time has passed is not run.
    let late = plan(begun("04:01:00", vec![of(0, RowStatus::Finished, 20), of(1, RowStatus::Interrupted, 3)]));
    assert_eq!((late.rows[1].status, late.rows[1].frames, late.rows[1].span()), (RowStatus::Skipped, 3, None));
    assert!(late.rows[2].span().is_some_and(|(from, _)| from >= at("04:01:00")));
    // After its end nothing is left, and a row that there is not is nobody's.
    let over = plan(begun("06:00:00", vec![of(9, RowStatus::Running, 1)]));
    assert!(over.rows.iter().all(|row| row.status == RowStatus::Skipped && row.span().is_none()), "{:?}", over.rows);
}

/// The site with nothing measured.
fn site() -> Site {
    let config = Arc::new(config::parse(SITE, Path::new(".")).unwrap());
    let overheads = Evidence::default().overheads(&config);
    Site::new(config, overheads).unwrap()
}

/// Rows of a schedule for it.
fn rows(text: &str) -> Vec<Row> {
    let config = Arc::new(config::parse(SITE, Path::new(".")).unwrap());
    accept(text, &KnownFacts::of(config)).unwrap()
}
