//! Measures how long the forecasts of a year take: `cargo run --release -p schedule --example plans_a_year [NIGHTS]`.
//!
//! A night has some 40 rows: opening, flats at dusk and at dawn, a focus run, thirty targets through the night, one of
//! them until its window ends, a planet, closing, calibrations and headers. The goal is a year in under ten minutes.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use schedule::plan::{Evidence, Site, forecast};
use schedule::validate::{KnownFacts, accept};
use serde_json::{Value, json};
use units::{Angle, Utc};

const SITE: &str = concat!(
    include_str!("../../config/tests/paranal.toml"),
    r#"[[telescope]]
name = "mount"
server = "10.0.0.5:11111"
meridian_flip = true
[[camera]]
name = "main"
server = "10.0.0.5:11111"
[[filterwheel]]
name = "wheel"
server = "10.0.0.5:11111"
filters = ["B", "V", "R"]
[[dome]]
name = "dome"
server = "10.0.0.5:11111"
"#
);
/// Targets of a night.
const TARGETS: u32 = 30;
const YEAR: u32 = 365;

/// The schedule of the n-th night.
fn schedule(place: &sky::Place, n: u32) -> anyhow::Result<String> {
    let noon: Utc = "2026-11-20T17:00:00Z".parse()?;
    let night = sky::night(place, &Default::default(), noon.plus_seconds(86_400.0 * f64::from(n)))?;
    let known = |time: Option<Utc>| time.ok_or_else(|| anyhow::anyhow!("the Sun does not set in night {n}"));
    let (sunset, dusk) = (known(night.sunset)?, known(night.nautical_dusk)?);
    let (dawn, sunrise) = (known(night.nautical_dawn)?, known(night.sunrise)?);
    let mut rows = String::new();
    let mut row = |action: &str, value: Value, start: Utc, end: Utc| {
        let row = json!({
            "device_name": "main", "action_type": action, "action_value": value,
            "start_time": start.to_string(), "end_time": end.to_string(),
        });
        rows.push_str(&format!("{row}\n"));
    };
    let filters = json!({ "filter": ["B", "V", "R"], "n": [5, 5, 5] });
    row("cool_camera", json!({}), sunset.plus_seconds(-3600.0), dusk);
    row("open", json!({}), sunset, dusk);
    row("flats", filters.clone(), sunset.plus_seconds(1.0), dusk);
    row("autofocus", json!({ "filter": "V" }), dusk, dusk.plus_seconds(1200.0));
    let (begin, slot_s) = (dusk.plus_seconds(1200.0), (dawn.seconds_since(dusk) - 1200.0) / f64::from(TARGETS));
    for target in 0..TARGETS {
        let (start, end) =
            (begin.plus_seconds(slot_s * f64::from(target)), begin.plus_seconds(slot_s * f64::from(target + 1)));
        let lst_deg = sky::Observer::new(place, &Default::default(), start)?.sidereal_time().degrees();
        let (ra, dec) =
            ((lst_deg + f64::from(target % 7) * 6.0 - 18.0).rem_euclid(360.0), f64::from(target) * 2.0 - 60.0);
        let filter = ["B", "V", "R"][target as usize % 3];
        let mut value = json!({
            "object": format!("t{target}"), "exptime": 60, "ra": ra, "dec": dec, "filter": filter,
            "guiding": true, "pointing": target % 2 == 0,
        });
        if target != 20 {
            value["n"] = json!(10);
        }
        row("object", value, start, end);
    }
    row("object", json!({ "object": "Moon", "lookup_name": "moon", "exptime": 1, "n": 5 }), dawn, sunrise);
    row("flats", filters, dawn, sunrise);
    row("close", json!({}), sunrise.plus_seconds(1.0), sunrise.plus_seconds(3600.0));
    row(
        "calibration",
        json!({ "exptime": [0, 60], "n": [20, 10] }),
        sunrise.plus_seconds(2.0),
        sunrise.plus_seconds(9000.0),
    );
    row("complete_headers", json!({}), sunrise.plus_seconds(3.0), sunrise.plus_seconds(20_000.0));
    Ok(rows)
}

/// Plans so many nights; returns a summary in words, and how long it took, s.
pub fn plan(nights: u32) -> anyhow::Result<(String, f64)> {
    let config = Arc::new(config::parse(SITE, Path::new("."))?);
    let place = sky::Place::new(Angle::from_degrees(-24.6157), Angle::from_degrees(-70.3976), 2518.0)?;
    let texts: Vec<String> = (0..nights).map(|n| schedule(&place, n)).collect::<anyhow::Result<_>>()?;
    let begun = Instant::now();
    let known = KnownFacts::of(config.clone());
    let mut site = Site::new(config.clone(), Evidence::default().overheads(&config))?;
    let (mut rows, mut frames, mut at_risk) = (0, 0, 0);
    for text in &texts {
        let night = forecast(accept(text, &known)?, &mut site)?;
        rows += night.rows.len();
        frames += night.frames();
        at_risk += night.at_risk().count();
        anyhow::ensure!(night.frames() > 200 && night.open_s > 6.0 * 3600.0, "a poor night: {:?}", night.rows);
    }
    let took_s = begun.elapsed().as_secs_f64();
    let report = format!("{nights} nights, {rows} rows, {frames} frames, {at_risk} rows not whole");
    Ok((report, took_s))
}

fn main() -> anyhow::Result<()> {
    let nights: u32 = std::env::args().nth(1).map_or(Ok(YEAR), |n| n.parse())?;
    let (report, took_s) = plan(nights)?;
    println!("{report}: planned in {took_s:.2} s");
    anyhow::ensure!(took_s < 600.0, "expected less than ten minutes");
    Ok(())
}
