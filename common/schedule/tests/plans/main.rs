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

use schedule::Row;
use schedule::plan::{Evidence, Site};
use schedule::validate::{Known, accept};

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
fn a_week_is_planned_in_seconds() {
    let (told, took_s) = year::plan(7).unwrap();
    println!("{told}: planned in {took_s:.2} s");
    // A year of them would take half an hour at this limit, on a busy machine and without optimization.
    assert!(told.starts_with("7 nights, 273 rows") && took_s < 35.0, "{told}: {took_s} s");
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
    accept(text, &Known::of(config)).unwrap()
}
