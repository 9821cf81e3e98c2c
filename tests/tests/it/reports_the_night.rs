//! The report of a night of real nodes: each second has a class, and the figures are those of the simulator.

use std::time::Duration;

use contract::Role;
use serde_json::{Value, json};
use test_support::{Harness, HarnessOptions, header, object, row};
use units::Utc;

const FRAMES: u32 = 16;
const EXPOSURE_S: f64 = 10.0;

/// Width of the stars at 20 deg from the zenith: optics alone, the seeing set to nearly nothing.
const FWHM_ARCSEC: f64 = 25.0;

/// A field of 1.5 deg with stars of 2.4 px, so that its frames are solved.
fn options() -> HarnessOptions {
    let mut options = HarnessOptions::default();
    let camera = &mut options.world.camera;
    (camera.width, camera.height, camera.pixel_um) = (512, 512, 13.5 * 4.0);
    camera.optics_fwhm_arcsec = FWHM_ARCSEC;
    options.world.mount = simulator::MountOptions::perfect();
    options
}

fn group<'a>(report: &'a Value, name: &str) -> &'a Value {
    report["times"].as_array().and_then(|times| times.iter().find(|time| time["group"] == name)).unwrap_or(&Value::Null)
}

fn time_s(report: &Value, name: &str) -> f64 {
    group(report, name)["time_s"].as_f64().unwrap_or(f64::NAN)
}

/// Counts of the tables that a repeated message or a restart must not double.
fn counts(harness: &Harness) -> anyhow::Result<Vec<(String, i64, i64)>> {
    let database = rusqlite::Connection::open(harness.path("data/archive.db"))?;
    let keys = [
        ("states", "part || boot_id || seq"),
        ("schedule_rows", "number || row || boot_id"),
        ("alerts", "id || raised"),
        ("fluxes", "frame_id || star"),
    ];
    let count = |(table, key): (&str, &str)| -> anyhow::Result<(String, i64, i64)> {
        let sql = format!("SELECT count(*), count(DISTINCT {key}) FROM {table}");
        let (rows, distinct) = database.query_row(&sql, [], |row| Ok((row.get(0)?, row.get(1)?)))?;
        Ok((table.to_owned(), rows, distinct))
    };
    keys.into_iter().map(count).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn each_second_of_a_night_has_a_class_and_the_figures_are_those_of_the_simulator() -> anyhow::Result<()> {
    let mut harness = Harness::new(options(), |world| {
        let field = object(world, "<b>Żuraw & field</b>", EXPOSURE_S, FRAMES);
        vec![row("open", json!({})), field, row("complete_headers", json!({}))]
    })
    .await?;
    harness.simulator.world().set_weather(simulator::Quantity::StarFwhm, Some(0.1));
    harness.start_all()?;
    let frames = |harness: &Harness| harness.night.get().map_or(0, |night| night.sample.body.frames);
    harness.until("three frames are taken", 120.0, |harness| frames(harness) >= 3).await?;
    let rain_began = harness.simulator.world().now();
    harness.simulator.world().rain(true);
    harness.until("the dome is shut in the rain", 60.0, Harness::is_shut).await?;
    let shut = harness.simulator.world().now();
    tokio::time::sleep(Duration::from_secs(3)).await;
    harness.simulator.world().rain(false);
    harness.until("the row goes on", 120.0, |harness| frames(harness) >= 8).await?;

    // A report of the night that runs, and an archive that is away for a while.
    let config = harness.path("observatory.toml").display().to_string();
    let words = ["night", "report", "last", "--json", "--config", &config];
    let running: Value = serde_json::from_str(&harness.starmesh(&words).await?)?;
    assert_eq!(running["is_running"], true);
    harness.kill(Role::Archive)?;
    tokio::time::sleep(Duration::from_secs(2)).await;
    harness.start(Role::Archive)?;
    harness.order(&["stop", "--reason", "the test looks"]).await?;
    tokio::time::sleep(Duration::from_secs(2)).await;
    harness.order(&["start", "--reason", "the test has looked"]).await?;
    harness
        .until("the night ends", 180.0, |harness| harness.night.get().is_some_and(|night| night.sample.body.ended))
        .await?;
    let reports = harness.path("images/reports");
    let written = |ending: &str| -> Option<std::path::PathBuf> {
        let mut files = std::fs::read_dir(&reports).ok()?.flatten().map(|entry| entry.path());
        files.find(|path| path.extension().is_some_and(|extension| extension == ending))
    };
    harness.until("the archive writes the report", 120.0, |_| written("html").is_some()).await?;
    let report: Value = serde_json::from_slice(&std::fs::read(written("json").unwrap_or_default())?)?;
    let page = std::fs::read_to_string(written("html").unwrap_or_default())?;
    for time in report["times"].as_array().into_iter().flatten() {
        println!("{time}");
    }
    if let Ok(folder) = std::env::var("STARMESH_KEEP_REPORT") {
        std::fs::write(std::path::Path::new(&folder).join("night.html"), &page)?;
        std::fs::write(std::path::Path::new(&folder).join("night.json"), serde_json::to_vec_pretty(&report)?)?;
        let copy = std::path::Path::new(&folder).join("night.db").display().to_string();
        rusqlite::Connection::open(harness.path("data/archive.db"))?.execute("VACUUM INTO ?", [copy])?;
    }

    // The classes cover the span, and nearly all of it is explained.
    let sum: f64 = report["times"].as_array().into_iter().flatten().filter_map(|time| time["time_s"].as_f64()).sum();
    let span_s = report["span_s"].as_f64().unwrap_or(f64::NAN);
    assert!((sum - span_s).abs() < 0.01, "{sum} of {span_s}");
    let absent = group(&report, "fault")["kinds"].as_array().into_iter().flatten();
    let absent = absent.filter(|kind| kind["kind"] == "the observatory node did not run");
    let before_s: f64 = absent.filter_map(|kind| kind["time_s"].as_f64()).sum();
    let unexplained = time_s(&report, "unexplained") / (span_s - before_s);
    println!("unexplained {:.3} % of {:.0} s", 100.0 * unexplained, span_s - before_s);
    assert!(unexplained <= 0.01, "{unexplained}");

    // Light: what the files' headers have, and as many frames as the row asks for.
    let mut light_s = 0.0;
    for file in harness.fits() {
        light_s += header(&file)?["EXPTIME"].parse::<f64>()?;
    }
    assert!((time_s(&report, "open_shutter") - light_s).abs() < 0.5, "{light_s} s of light are in the files");
    let target = &report["targets"][0];
    assert_eq!((&target["frames_asked"], &target["frames_taken"]), (&json!(FRAMES), &json!(harness.fits().len())));
    assert!(target["frames_counted"].as_u64().is_some_and(|counted| counted >= u64::from(FRAMES)));
    let fwhm = target["quality"][0]["fwhm_arcsec"].as_f64().unwrap_or(f64::NAN);
    assert!((fwhm / FWHM_ARCSEC - 1.0).abs() < 0.1, "{fwhm} arcsec");

    // Rain: at least from the closed dome on, and it began after the simulator's did. At the night's start, too, the verdict
    // is unsafe until each input was good for its dwell time.
    let weather = report["timeline"].as_array().into_iter().flatten().filter(|piece| piece["group"] == "weather");
    let begins: Vec<Utc> = weather.filter_map(|piece| piece["from_utc"].as_str()?.parse().ok()).collect();
    let is_of_rain = |begin: &Utc| *begin >= rain_began && *begin <= shut;
    assert!(begins.iter().any(is_of_rain), "rain from {rain_began} to {shut}, weather from {begins:?}");
    assert!(time_s(&report, "weather") > 30.0);
    let idle = group(&report, "idle").to_string();
    assert!(idle.contains("the robotic switch was off"), "{idle}");

    let orders: Vec<&Value> = report["orders"].as_array().into_iter().flatten().collect();
    assert_eq!(orders.len(), 2, "{orders:?}");
    assert!(
        page.contains("&lt;b&gt;Żuraw &amp; field&lt;/b&gt;") && !page.contains("<b>") && !page.contains("<script")
    );
    let database = rusqlite::Connection::open(harness.path("data/archive.db"))?;
    let measured: i64 =
        database.query_row("SELECT count(DISTINCT frame_id) FROM fluxes WHERE star > 0", [], |row| row.get(0))?;
    assert_eq!(measured, i64::from(FRAMES), "comparison stars are measured on every frame");
    for (table, rows, distinct) in counts(&harness)? {
        println!("{table}: {rows} rows");
        assert!(rows > 0 || table == "alerts", "{table}");
        assert!(table == "schedule_rows" || rows == distinct, "{table}: {rows} rows, {distinct} of them different");
    }
    harness.until("the dome ends shut", 60.0, Harness::is_shut).await?;
    Ok(())
}
