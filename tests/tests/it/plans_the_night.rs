//! Compares a forecast with the truth: overheads are measured from the archive of one schedule, the next one is planned
//! with them, and then real nodes execute it on the simulator.

#![allow(clippy::unwrap_used, reason = "a test ends by panicking")]

use std::collections::BTreeMap;

use contract::observatory::RowStatus;
use serde_json::{Value, json};
use simulator::SlitOptions;
use sky::{EarthOrientation, Horizontal, Observer, Place};
use test_support::{Harness, HarnessOptions};
use units::Utc;

/// Sky seconds per machine second.
const SPEED: f64 = 20.0;
/// Devices at rest are polled each machine second, 20 s here, and a busy machine needs a quarter of one more.
const EACH_ROW_S: f64 = 25.0;
/// The first slew of a night comes from the park position: its way is taken for 60 deg, and may be 60 more or less.
const FROM_PARK_S: f64 = 40.0;
/// Of a slow dome, deg/s: the mount slews by 3.
const TURN_DEG_S: f64 = 2.0;
/// The plan has the median of what it waited for its slit: some 30 s, where a turn by half a circle lets the mount wait
/// for a minute, and no turn not at all.
const OTHER_TURN_S: f64 = 35.0;
/// So many frames of a row without a number may be missed by that.
const FRAMES: u64 = 3;
/// Medians of few slews and frames are good to this share of a row.
const SHARE: f64 = 0.1;

/// An object row at an altitude and azimuth of now.
fn object(
    harness: &Harness,
    name: &str,
    (altitude_deg, azimuth_deg): (f64, f64),
    exptime: f64,
    n: Option<u32>,
) -> Value {
    let place = Place::new(harness.world.latitude, harness.world.longitude, harness.world.elevation_m).unwrap();
    let observer = Observer::new(&place, &EarthOrientation::default(), harness.simulator.world().now()).unwrap();
    let target = observer.to_icrs(&Horizontal::from_degrees(altitude_deg, azimuth_deg));
    let (ra, dec) = (target.ra.wrapped_positive().degrees(), target.dec.degrees());
    let filter = if n.is_some() { "V" } else { "R" };
    let mut row = json!({ "object": name, "ra": ra, "dec": dec, "exptime": exptime, "filter": filter });
    if let Some(n) = n {
        row["n"] = json!(n);
    }
    row
}

/// A schedule's text: rows with the length of their windows, which begin one second after another.
fn text(start: Utc, rows: &[(&'static str, Value, f64)]) -> String {
    let at = |(index, (action, value, length_s)): (usize, &(&'static str, Value, f64))| {
        (*action, value.clone(), index as f64, index as f64 + length_s)
    };
    text_at(start, &rows.iter().enumerate().map(at).collect::<Vec<_>>())
}

/// ... rows with begin and end of their windows after `start`, s.
fn text_at(start: Utc, rows: &[(&str, Value, f64, f64)]) -> String {
    let line = |(action, value, from_s, to_s): &(&str, Value, f64, f64)| {
        let row = json!({
            "device_name": "camera", "action_type": action, "action_value": value,
            "start_time": start.plus_seconds(*from_s).to_string(), "end_time": start.plus_seconds(*to_s).to_string(),
        });
        format!("{row}\n")
    };
    rows.iter().map(line).collect()
}

/// When each row began and ended after `since`, as the nodes' diaries have it in the archive, which count rows from 1.
fn truth(harness: &Harness, since: Utc) -> BTreeMap<u32, (Option<Utc>, Option<Utc>)> {
    let database = rusqlite::Connection::open(harness.path("data/archive.db")).unwrap();
    let mut lines = database.prepare("SELECT datetime, message FROM log ORDER BY datetime").unwrap();
    let lines = lines.query_map([], |row| Ok((row.get::<_, String>(0)?, row.get::<_, String>(1)?))).unwrap();
    let mut rows: BTreeMap<u32, (Option<Utc>, Option<Utc>)> = BTreeMap::new();
    for (at, message) in lines.map(Result::unwrap) {
        let at: Utc = format!("{}Z", at.replace(' ', "T")).parse().unwrap();
        let number = message.split(' ').find_map(|word| word.strip_prefix("row=")).and_then(|n| n.parse().ok());
        let Some(number) = number.filter(|_| at >= since) else { continue };
        let row = rows.entry(number).or_default();
        if message.starts_with("row begins") {
            row.0 = Some(at);
        } else if message.starts_with("row finished") || message.starts_with("row ended") {
            row.1 = Some(at);
        }
    }
    rows
}

/// Waits until all rows of a schedule so long have ended.
async fn until_ended(harness: &Harness, rows: usize) -> anyhow::Result<()> {
    let ended = |harness: &Harness| {
        let states = harness.schedule.get().map(|schedule| schedule.sample.body.rows).unwrap_or_default();
        let is_over = |status| matches!(status, RowStatus::Finished | RowStatus::Failed | RowStatus::Skipped);
        states.len() == rows && states.iter().all(|row| is_over(row.status))
    };
    harness.until("all rows have ended", 120.0, ended).await?;
    harness
        .until("the night has ended", 60.0, |harness| harness.night.get().is_some_and(|night| night.sample.body.ended))
        .await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn the_next_night_goes_as_planned_from_the_telemetry_of_the_last_one() -> anyhow::Result<()> {
    // Wide enough for a machine that adds half a second to each frame, which is 10 s of this sky.
    under(None, 1.6).await
}

#[tokio::test(flavor = "multi_thread")]
async fn under_a_slow_dome_the_next_night_goes_as_planned_too() -> anyhow::Result<()> {
    under(Some(SlitOptions::default()), 1.6).await
}

/// Two nights under a roof, or under a slow dome with this slit; windows are as much wider as that takes longer.
async fn under(slit: Option<SlitOptions>, wider: f64) -> anyhow::Result<()> {
    let mut options = HarnessOptions::default();
    options.world.speed = SPEED;
    let turn_s = if slit.is_some() { OTHER_TURN_S } else { 0.0 };
    options.world.dome = simulator::DomeOptions { slit, turn_deg_per_s: TURN_DEG_S, ..options.world.dome };
    options.world.mount = simulator::MountOptions { slew_deg_per_s: 3.0, ..simulator::MountOptions::perfect() };
    let mut harness = Harness::new(options, |_| vec![("cool_camera", json!({}))]).await?;
    // A forecast assumes at first that the sensor is warm, and in the second schedule it would still be cold.
    let site = std::fs::read_to_string(harness.path("observatory.toml"))?;
    std::fs::write(harness.path("observatory.toml"), site.replace("temperature_c = -10.0\n", ""))?;
    let first = [
        ("open", json!({}), 3600.0),
        ("object", object(&harness, "a", (70.0, 90.0), 5.0, Some(4)), 3600.0),
        ("object", object(&harness, "b", (40.0, 200.0), 5.0, Some(4)), 3600.0),
        ("object", object(&harness, "c", (55.0, 20.0), 5.0, Some(4)), 3600.0),
        ("object", object(&harness, "d", (50.0, 60.0), 5.0, Some(3)), 3600.0),
        ("object", object(&harness, "e", (75.0, 60.0), 5.0, Some(3)), 3600.0),
        ("calibration", json!({ "exptime": [0.0, 2.0], "n": [4, 4] }), 3600.0),
        ("close", json!({}), 3600.0),
    ];
    std::fs::write(harness.path("schedule.jsonl"), text(harness.simulator.world().now(), &first))?;
    harness.start_all()?;
    until_ended(&harness, first.len()).await?;

    // The archive commits within a second.
    tokio::time::sleep(std::time::Duration::from_millis(1500)).await;
    let start = harness.simulator.world().now().plus_seconds(60.0);
    // Each row has time to end before the next one begins, so that each is judged for itself.
    let second = [
        ("open", json!({}), 0.0, 100.0),
        ("object", object(&harness, "f", (65.0, 120.0), 10.0, Some(6)), 80.0, 300.0),
        ("object", object(&harness, "g", (35.0, 300.0), 4.0, Some(8)), 270.0, 400.0),
        ("object", object(&harness, "h", (60.0, 10.0), 12.0, None), 410.0, 570.0),
        ("calibration", json!({ "exptime": [0.0, 8.0], "n": [6, 5] }), 600.0, 760.0),
        ("close", json!({}), 700.0, 1000.0),
    ];
    let second = second.map(|(action, value, from_s, to_s)| (action, value, wider * from_s, wider * to_s));
    let file = harness.path("next.jsonl");
    std::fs::write(&file, text_at(start, &second))?;
    let config = harness.path("observatory.toml");
    let words = ["plan", file.to_str().unwrap(), "--config", config.to_str().unwrap(), "--json"];
    let output = harness.starmesh(&words).await?;
    println!("{}", harness.starmesh(&words[..4]).await?);
    std::fs::rename(&file, harness.path("schedule.jsonl"))?;
    let plan: Vec<Value> = output.lines().map(serde_json::from_str).collect::<Result<_, _>>()?;
    let measured = |name: &str| {
        let figures = plan[0]["overheads"].as_array().unwrap();
        figures.iter().find(|figure| figure["name"] == name).map_or(0, |figure| figure["measured"].as_u64().unwrap())
    };
    let slits = if turn_s > 0.0 { 3 } else { 0 };
    for (name, least) in
        [("open", 1), ("close", 1), ("slew", 4), ("slit", slits), ("spool", 5), ("between frames, object", 10)]
    {
        assert!(measured(name) >= least, "{name}: {} measured of at least {least}\n{output}", measured(name));
    }
    let camera = &plan[0]["cameras"][0];
    assert!(camera["camera"] == "camera" && camera["width_px"] == 256 && camera["measured"].as_u64() > Some(10));
    let rows: Vec<&Value> = plan.iter().filter(|line| line["row"].is_number()).collect();
    assert!(rows.len() == second.len() && rows.iter().all(|row| row["whole"] == true), "{output}");

    let begins = start.plus_seconds(-1.0);
    harness
        .until("the next night has begun", 60.0, |harness| {
            harness.schedule.get().is_some_and(|received| received.sample.body.rows.len() == 6)
        })
        .await?;
    until_ended(&harness, second.len()).await?;
    tokio::time::sleep(std::time::Duration::from_millis(1500)).await;
    let done = truth(&harness, begins);
    let frames = harness.schedule.get().unwrap().sample.body.rows;
    let mut off: Vec<String> = Vec::new();
    for (number, row) in (0_u32..).zip(rows) {
        let time = |name: &str| -> Utc { row[name].as_str().unwrap().parse().unwrap() };
        let (planned, (began, ended)) = ((time("start_utc"), time("end_utc")), done[&(number + 1)]);
        let (began, ended) = (began.unwrap(), ended.unwrap());
        let near_s = EACH_ROW_S
            + turn_s
            + SHARE * planned.1.seconds_since(planned.0)
            + if number == 1 { FROM_PARK_S } else { 0.0 };
        let (early_s, late_s) = (began.seconds_since(planned.0), ended.seconds_since(planned.1));
        let (count, wanted) = (frames[number as usize].frames, row["frames"].as_u64().unwrap());
        println!(
            "{:12} begins {early_s:+6.1} s, ends {late_s:+6.1} s off its plan ({:.0} s long, within {near_s:.0} s), {count} of \
             {wanted} frames",
            row["action"].as_str().unwrap(),
            planned.1.seconds_since(planned.0),
        );
        if early_s.abs() > near_s || late_s.abs() > near_s {
            off.push(format!("row {number}: {early_s:+.1} s, {late_s:+.1} s"));
        }
        // A row that goes on until its window ends has as many as fit.
        let is_counted = row["frames_wanted"].is_number();
        let differ = u64::from(count).abs_diff(wanted);
        assert!(differ <= if is_counted { 0 } else { FRAMES }, "row {number}: {count} frames, {wanted} were planned");
    }
    assert!(off.is_empty(), "{off:?}");
    harness.until("the dome ends shut", 30.0, Harness::is_shut).await?;
    Ok(())
}
