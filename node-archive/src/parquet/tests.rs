//! A database with something in every table, its nights as files, and the database that is made from them.

use std::collections::BTreeSet;
use std::fs;

use bus::Clock;
use contract::device::camera::Frame;
use contract::node::Level;
use contract::observatory::{Alert, Alerts, Correction, FocusRun, FrameFacts, RowState, ScheduleState};
use contract::{Address, BootId, CommandId, Kind, Scalar};
use node::NodeAlerts;
use parquet_nights::{NIGHTS, Outcome, TABLES};

use super::*;
use crate::database::{
    Database, StarFlux, StoredAlerts, StoredCorrection, StoredFacts, StoredFluxes, StoredImage, StoredRecord,
    StoredRow, StoredRun, StoredState, Write,
};

mod again;
mod shared;

const DAY_S: i64 = 86_400;
/// Noon of 2026-11-21 at longitude 0.
const NOON_S: i64 = 1_795_262_400;

fn at(second: i64) -> Utc {
    Utc::from_micros((NOON_S + second) * 1_000_000 + 123_456)
}

fn golden<T: serde::de::DeserializeOwned>(name: &str) -> T {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../common/contract/golden/v1/{name}.json"));
    let sample: serde_json::Value = serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap();
    // Some samples are lists of several.
    let sample = sample.as_array().and_then(|all| all.last()).unwrap_or(&sample);
    serde_json::from_value(sample.clone()).unwrap()
}

fn config(folder: &Path) -> config::Observatory {
    let text = format!("{}[archive]\nraw_days = 3\n", test_support::PARANAL);
    let mut config = config::parse(&text, folder).unwrap();
    config.place.longitude_deg = 0.0;
    config
}

fn reading(telescope: &str, (property, value): (&str, Result<Scalar, String>), second: i64) -> Write {
    let address = Address::new("paranal", telescope).unwrap();
    let device = address.device(Kind::ObservingConditions, &"wx".parse().unwrap());
    Write::Reading { device, property: property.to_owned(), value, at: at(second) }
}

fn record(node: &str, number: i64, second: Option<i64>) -> Write {
    Write::Audit(Box::new(StoredRecord {
        node: node.to_owned(),
        chain: "c".to_owned(),
        number,
        at: second.map(at),
        from: "Zoë".to_owned(),
        device: String::new(),
        verb: "close".to_owned(),
        token: (number > 1).then_some(number),
        outcome: "accepted".to_owned(),
        line: format!("{{\"line\":{number}}}"),
        sha256: format!("{number:064x}"),
        fault: None,
    }))
}

/// What a night leaves, in every table.
fn night(first: i64, number: u64, boot: &BootId) -> Vec<Write> {
    let values = [
        Ok(Scalar::Float(2.0)),
        Ok(Scalar::Float(1e-7)),
        Ok(Scalar::Float(f64::NAN)),
        Ok(Scalar::Float(f64::INFINITY)),
        Ok(Scalar::Int(i64::MAX)),
        Ok(Scalar::Bool(true)),
        Ok(Scalar::Text("12".to_owned())),
        Ok(Scalar::Text("Öffnung \u{1f52d}".to_owned())),
        Ok(Scalar::List(vec![Scalar::Text("R".to_owned()), Scalar::Int(1)])),
        Err("timeout".to_owned()),
    ];
    let mut writes = Vec::new();
    for (step, value) in (0..).zip(values) {
        writes.push(reading("callisto", ("WindGust", value.clone()), first + 7 * step));
        writes.push(reading("shared", ("Humidity", value), first + 7 * step));
    }
    // At the noon that ends the night, to the microsecond before it: the minute belongs to one night.
    let last = Write::Reading {
        device: Address::new("paranal", "callisto").unwrap().device(Kind::Dome, &"dome".parse().unwrap()),
        property: "Azimuth".to_owned(),
        value: Ok(Scalar::Int(7)),
        at: Utc::from_micros((NOON_S + (first.div_euclid(DAY_S) + 1) * DAY_S) * 1_000_000 - 1),
    };
    writes.push(last);
    let id = |what: &str| CommandId(format!("{what}-{number}"));
    let frame = Frame { id: id("frame"), started_utc: at(first), ..golden("camera.frame") };
    let (path, file) = (format!("/images/{number}.fits").into(), format!("{number}.fits"));
    let image = StoredImage { frame, file, bytes: 5760, stored: at(first + 60) };
    writes.push(Write::Stored(Box::new(image), path));
    let facts =
        |name: &str, started| FrameFacts { frame: id(name), started_utc: started, ..golden("observatory.facts") };
    for facts in [facts("frame", Some(at(first))), facts("unknown", None)] {
        let at = at(first + 70);
        writes.push(Write::Facts(Box::new(StoredFacts { facts, at, origin: (boot.clone(), number) })));
    }
    let correction = Correction { frame: id("guide"), mid_utc: at(first + 80), ..golden("observatory.correction") };
    let telescope = "callisto".to_owned();
    writes.push(Write::Correction(Box::new(StoredCorrection {
        correction,
        telescope,
        origin: (boot.clone(), number),
    })));
    let run = FocusRun { id: id("run"), started_utc: at(first + 90), ..golden("observatory.focus_run") };
    let (plot, at_utc) = ("autofocus/ü.svg".to_owned(), at(first + 99));
    writes.push(Write::Focus(Box::new(StoredRun { run, plot, at: at_utc, origin: (boot.clone(), number) })));
    for (level, line) in [(Level::Info, "exposure started"), (Level::Error, "the dome’s shutter – stuck")] {
        writes.push(Write::Log {
            telescope: "callisto".to_owned(),
            node: "device/main".to_owned(),
            target: "node_device".to_owned(),
            level,
            message: line.to_owned(),
            at: at(first + 100),
            origin: (boot.clone(), number * 10 + u64::from(level == Level::Error)),
        });
    }
    writes.extend(happenings(first, number, boot, id("frame")));
    let number = i64::try_from(number).unwrap();
    writes.extend([record("device/callisto/main", 2 * number, Some(first)), record("device/callisto/main", -1, None)]);
    writes.push(record("device/callisto/main", 2 * number + 1, Some(first + 5)));
    writes
}

/// What the observatory node did, and the fluxes of a frame.
fn happenings(first: i64, number: u64, boot: &BootId, frame: CommandId) -> Vec<Write> {
    let origin = (boot.clone(), number);
    let state = StoredState {
        part: "night",
        same: format!("open {number}"),
        state: format!("{{\"night\":{number}}}"),
        at: at(first + 110),
        gap_s: 15.0,
        origin: origin.clone(),
    };
    let rows: ScheduleState = golden("observatory.schedule");
    let row = StoredRow { row: rows.rows[0].clone(), at: at(first + 111), origin: origin.clone() };
    let row = StoredRow { row: RowState { frames: number as u32, ..row.row }, ..row };
    let active: Alerts = golden("alerts");
    let alerts = active.alerts.into_iter().map(|alert| Alert { raised_utc: at(first + 112), ..alert }).collect();
    let alerts = StoredAlerts { alerts, at: at(first + 113), origin };
    let flux =
        |star| StarFlux { star, x_px: 10.5, y_px: -1.25, flux_adu: 1e5, error_adu: 300.0, is_saturated: star == 1 };
    let new_stars = if number == 0 { vec![[97.6, 29.7], [97.7, 29.8]] } else { Vec::new() };
    let fluxes = StoredFluxes { frame, series: "WASP-12/r/ü".to_owned(), new_stars, fluxes: vec![flux(0), flux(1)] };
    vec![
        Write::State(Box::new(state)),
        Write::Row(Box::new(row)),
        Write::Alerts(Box::new(alerts)),
        Write::Fluxes(Box::new(fluxes)),
    ]
}

/// A database with five nights, of which three have raw values left; returns where it is.
async fn database(config: &config::Observatory) {
    let alerts = NodeAlerts::new(Clock::machine_clock());
    let (database, writer) = Database::open(&config.archive.database, "callisto", alerts).unwrap();
    let boot = BootId::fresh();
    for number in 0..5 {
        let mut writes = night(i64::try_from(number).unwrap() * DAY_S + 40_000, number, &boot);
        writes.push(Write::Complete(CommandId("frame-1".to_owned())));
        database.commit(writes).await.unwrap();
    }
    drop(database);
    writer.end().await;
}

async fn forget(config: &config::Observatory) {
    let alerts = NodeAlerts::new(Clock::machine_clock());
    let (database, writer) = Database::open(&config.archive.database, "callisto", alerts).unwrap();
    database.commit(vec![Write::ForgetOld { days: config.archive.raw_days }]).await.unwrap();
    drop(database);
    writer.end().await;
}

fn write_all(config: &config::Observatory, folder: &Path) -> Vec<PartReport> {
    nights(config).unwrap().iter().flat_map(|night| write(config, night, folder).unwrap()).collect()
}

/// Every row of every table as text, series by their names. `writing` has names of files that are being written;
/// `streams` and `lost` have what one archive received.
fn everything(database: &Path) -> Vec<(String, Vec<String>)> {
    let connection = open(database).unwrap();
    let sql = "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT IN ('writing', 'streams', 'lost')
        AND name NOT LIKE 'sqlite_%'";
    let mut tables = connection.prepare(sql).unwrap();
    let tables: Vec<String> = tables.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect();
    let mut all = Vec::new();
    for table in tables {
        let sql = match table.as_str() {
            "series" => "SELECT telescope, device_type, device_name, device_command FROM series".to_owned(),
            "samples" | "minutes" => format!("SELECT * FROM {table} JOIN series ON series.id = {table}.series"),
            "audit" => "SELECT row_number() OVER (ORDER BY rowid), * FROM audit".to_owned(),
            _ => format!("SELECT * FROM {table}"),
        };
        let mut statement = connection.prepare(&sql).unwrap();
        let names: Vec<String> = statement.column_names().into_iter().map(str::to_owned).collect();
        let is_number = |name: &String| ["id", "series"].contains(&name.as_str());
        let mut rows: Vec<String> = statement
            .query_map([], |row| {
                let cells = names.iter().enumerate().filter(|(_, name)| !is_number(name));
                Ok(cells.map(|(index, name)| format!("{name}={:?} ", row.get_ref(index).unwrap())).collect::<String>())
            })
            .unwrap()
            .map(Result::unwrap)
            .collect();
        rows.sort();
        all.push((table, rows));
    }
    all
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_that_is_filled_again_is_the_one_of_before() {
    let folder = tempfile::tempdir().unwrap();
    let (config, files) = (config(folder.path()), folder.path().join("network"));
    database(&config).await;
    write_all(&config, &files);
    forget(&config).await;
    let made = folder.path().join("deep/made.db");
    let refilled = refill(&config, &files, &made).await.unwrap();
    let (before, after) = (everything(&config.archive.database), everything(&made));
    assert!(before.iter().all(|(_, rows)| !rows.is_empty()), "every table is tested: {before:#?}");
    for ((table, before), (_, after)) in before.iter().zip(&after) {
        assert_eq!(before, after, "{table}");
    }
    assert_eq!(before.len(), after.len());
    // Five nights; records and facts without a time add none.
    assert_eq!(refilled.nights, 5);

    // The archive node goes on with it.
    let alerts = NodeAlerts::new(Clock::machine_clock());
    let (database, writer) = Database::open(&made, "callisto", alerts).unwrap();
    database.commit(night(6 * DAY_S, 9, &BootId::fresh())).await.unwrap();
    assert!(database.rows() > 20);
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_database_has_forgotten_stays_in_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let (mut config, files) = (config(folder.path()), folder.path().join("network"));
    database(&config).await;
    let first = write_all(&config, &files);
    assert!(first.iter().all(|part| part.outcome == Outcome::Written), "{first:#?}");
    forget(&config).await;
    let again = write_all(&config, &files);
    assert!(again.iter().all(|part| part.outcome == Outcome::Unchanged), "{again:#?}");
    let rows = |parts: &[PartReport]| parts.iter().map(|part| (part.path.clone(), part.rows)).collect::<Vec<_>>();
    assert_eq!(rows(&first), rows(&again));

    // A new database that knows only the second half of a night adds to its files.
    let images = |parts: &[PartReport]| {
        parts.iter().filter(|part| part.table == "images").map(|part| (part.outcome, part.rows)).collect::<Vec<_>>()
    };
    config.archive.database = folder.path().join("new.db");
    let alerts = NodeAlerts::new(Clock::machine_clock());
    let (database, writer) = Database::open(&config.archive.database, "callisto", alerts).unwrap();
    database.commit(night(45_000, 77, &BootId::fresh())).await.unwrap();
    drop(database);
    writer.end().await;
    assert_eq!(images(&write_all(&config, &files)), [(Outcome::Changed, 2)]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_disk_that_takes_nothing_leaves_the_file_of_before() {
    let folder = tempfile::tempdir().unwrap();
    let (config, files) = (config(folder.path()), folder.path().join("network"));
    database(&config).await;
    let night = nights(&config).unwrap()[0];
    let blocked = files.join("images/site=paranal");
    fs::create_dir_all(blocked.parent().unwrap()).unwrap();
    fs::write(&blocked, "no folder").unwrap();
    let store = NightStore::Folder(files.clone());
    let error = format!("{:#}", store.write(&config, &night).await.unwrap_err());
    assert!(error.contains("20261121") && error.contains("images/site=paranal"), "{error}");
    assert!(store.written(&config).await.unwrap().is_empty(), "the night is not whole");
    fs::remove_file(&blocked).unwrap();
    let parts = write(&config, &night, &files).unwrap();
    let outcomes: BTreeSet<&str> =
        parts.iter().map(|part| if part.outcome == Outcome::Written { part.table } else { "" }).collect();
    assert!(outcomes.contains("images") && !outcomes.contains("telemetry"), "the first tables were there: {parts:#?}");
    assert_eq!(store.written(&config).await.unwrap().len(), 1);
    let names = |folder: &Path| fs::read_dir(folder).unwrap().count();
    assert!(parts.iter().all(|part| names(part.path.parent().unwrap()) == 1), "no temporary file is left");

    // A damaged file is named, and never overwritten.
    let part = &parts[2].path;
    fs::write(part, "no Parquet").unwrap();
    let error = format!("{:#}", write(&config, &night, &files).unwrap_err());
    assert!(error.contains(part.to_str().unwrap()), "{error}");
    assert_eq!(fs::read_to_string(part).unwrap(), "no Parquet");
}

#[tokio::test(flavor = "multi_thread")]
async fn no_database_is_overwritten_and_none_is_made_from_files_that_are_not_whole() {
    let folder = tempfile::tempdir().unwrap();
    let (config, files) = (config(folder.path()), folder.path().join("network"));
    let made = folder.path().join("made.db");
    let refused = async |from: &Path, into: &Path| format!("{:#}", refill(&config, from, into).await.unwrap_err());
    let none = refused(&files, &made).await;
    assert!(none.contains("has no night of paranal/callisto") && none.contains("name the folder"), "{none}");
    database(&config).await;
    let there = refused(&files, &config.archive.database).await;
    assert!(there.contains("never overwritten"), "{there}");

    let parts = write_all(&config, &files);
    let log = parts.iter().find(|part| part.table == "log").unwrap().path.clone();
    let bytes = fs::read(&log).unwrap();
    fs::remove_file(&log).unwrap();
    let lost = refused(&files, &made).await;
    assert!(lost.contains(log.to_str().unwrap()) && lost.contains("has 0 rows, and 2 were written"), "{lost}");
    let mut damaged = bytes.clone();
    damaged.truncate(bytes.len() - 9);
    fs::write(&log, damaged).unwrap();
    assert!(refused(&files, &made).await.contains(log.to_str().unwrap()));
    fs::write(&log, bytes).unwrap();
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(left.iter().all(|name| !name.to_string_lossy().contains("made.db")), "nothing is left: {left:?}");
    refill(&config, &files, &made).await.unwrap();

    let mut other = config.clone();
    other.place.telescope = "io".parse().unwrap();
    let elsewhere = format!("{:#}", refill(&other, &files, &folder.path().join("io.db")).await.unwrap_err());
    assert!(elsewhere.contains("it has nights of paranal/callisto"), "{elsewhere}");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_table_and_column_of_the_database_is_in_the_files() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    database(&config).await;
    let connection = open(&config.archive.database).unwrap();
    let columns = |sql: &str| -> BTreeSet<(String, String)> {
        let mut statement = connection.prepare(sql).unwrap();
        statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap().map(Result::unwrap).collect()
    };
    // Generated columns are computed from others, and the table of `table_info` has none of them.
    let found = columns(
        "SELECT m.name, c.name FROM sqlite_master AS m, pragma_table_info(m.name) AS c WHERE m.type = 'table'
            AND m.name NOT IN ('series', 'samples', 'minutes', 'days', 'writing', 'streams', 'lost')
            AND m.name NOT LIKE 'sqlite_%'",
    );
    let mut stored = BTreeSet::new();
    for table in &TABLES {
        let columns = table.columns.iter().map(|column| column.sql).chain(table.owner);
        stored.extend(columns.map(|column| (table.into.to_owned(), column.to_owned())));
    }
    stored.insert(("log".to_owned(), "telescope".to_owned()));
    let missing: Vec<_> = found.difference(&stored).collect();
    assert!(missing.is_empty(), "add them at the end of common/parquet_nights/src/tables: {missing:?}");
    assert_eq!(NIGHTS.name, "nights");
}
