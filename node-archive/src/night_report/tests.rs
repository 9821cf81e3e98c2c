//! Which nights get a report, and when.

use std::path::PathBuf;

use bus::Clock;
use contract::BootId;
use contract::observatory::Posture;
use node::NodeAlerts;
use report::events::Doing;

use super::*;
use crate::database::{StoredState, Write};
use crate::folder::PART_FOLDER;

fn config(folder: &Path) -> Observatory {
    let mut config = config::parse(test_support::PARANAL, folder).unwrap();
    config.place.longitude_deg = 0.0;
    config
}

/// Hours after the noon of 2026-11-21.
fn at(hours: f64) -> Utc {
    Utc::from_seconds(1_795_262_400.0 + 3600.0 * hours)
}

/// What the telescope did from an hour to another, closed and idle.
fn closed(ended: bool, from: f64, to: f64, state: Option<&str>) -> Vec<Write> {
    let boot = BootId::fresh();
    let doing = Doing { robotic: true, posture: Posture::Closed, ended, speed: 1.0, simulated: false, actions: vec![] };
    let json = state.map_or_else(|| serde_json::to_string(&doing).unwrap(), str::to_owned);
    let state = |at, seq| StoredState {
        part: "night",
        same: format!("{ended} {from}"),
        state: json.clone(),
        at,
        gap_s: 1e6,
        origin: (boot.clone(), seq),
    };
    vec![Write::State(Box::new(state(at(from), 0))), Write::State(Box::new(state(at(to), 1)))]
}

async fn archive(folder: &Path, writes: Vec<Write>) -> (Observatory, PathBuf) {
    let (config, path) = (config(folder), folder.join("archive.db"));
    std::fs::create_dir_all(config.folders.images.join(PART_FOLDER)).unwrap();
    let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    database.commit(writes).await.unwrap();
    drop(database);
    writer.end().await;
    (config, path)
}

/// The nights for which a report is made, from an hour on until none is left.
fn reports(config: &Observatory, path: &Path, hour: f64, written: &mut BTreeMap<NightDate, Ending>) -> Vec<String> {
    let reader = Reader::open(path, "callisto").unwrap();
    let mut dates = Vec::new();
    while let Some((night, ending)) = due(config, &reader, at(hour), written).unwrap() {
        let report = make(config, &reader, &night, at(hour)).unwrap();
        write(&config.folders.images, &night, &report).unwrap();
        written.insert(night.date, ending);
        dates.push(night.date.to_string());
    }
    dates
}

#[tokio::test(flavor = "multi_thread")]
async fn a_night_in_which_nothing_was_tried_has_one_report_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (config, path) = archive(folder.path(), closed(false, -2.0, 40.0, None)).await;
    let mut written = BTreeMap::new();
    assert_eq!(reports(&config, &path, 6.0, &mut written), ["20261120"], "in the evening that of the night before");
    assert_eq!(reports(&config, &path, 12.0, &mut written), [""; 0], "not in the middle of the night");
    assert_eq!(reports(&config, &path, 23.0, &mut written), ["20261121"]);
    assert_eq!(reports(&config, &path, 26.0, &mut written), [""; 0]);
    let night = Night::at(at(12.0), &config.place);
    let [page, json] = files(&config.folders.images, &night);
    assert!(std::fs::read_to_string(page).unwrap().contains("Nothing was tried."));
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(json).unwrap()).unwrap();
    assert!(json["nothing_tried"].as_str().unwrap().starts_with("The night was idle"), "{json:#}");
}

#[tokio::test(flavor = "multi_thread")]
async fn nights_of_which_nothing_is_known_have_none_and_those_that_were_missed_get_theirs() {
    let folder = tempfile::tempdir().unwrap();
    // Closed for three nights without a change, while the archive node was away in the mornings.
    let (config, path) = archive(folder.path(), closed(false, 6.0, 70.0, None)).await;
    let mut written = BTreeMap::new();
    assert_eq!(reports(&config, &path, 75.0, &mut written), ["20261123", "20261122", "20261121"]);
    // After a restart the newest one is written again, older ones are there.
    assert_eq!(reports(&config, &path, 75.0, &mut BTreeMap::new()), ["20261123"]);
    assert_eq!(reports(&config, &path, 24.0 * 30.0, &mut BTreeMap::new()), [""; 0]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_state_that_cannot_be_read_and_one_of_the_future_leave_the_report_whole() {
    let folder = tempfile::tempdir().unwrap();
    let mut writes = closed(false, 6.0, 22.0, None);
    writes.extend(closed(false, 12.0, 12.1, Some("{\"posture\":\"sideways\"}")));
    // A clock that was a year ahead for a while, with a schedule that had ended.
    writes.extend(closed(true, 24.0 * 365.0, 24.0 * 365.0 + 1.0, None));
    let (config, path) = archive(folder.path(), writes).await;
    let reader = Reader::open(&path, "callisto").unwrap();
    assert_eq!(reader.newest_doing(Some(at(23.0))).unwrap().unwrap().from, at(6.0), "of those that can be read");
    assert_eq!(reports(&config, &path, 23.0, &mut BTreeMap::new()), ["20261121"]);
    let report = make(&config, &reader, &Night::at(at(12.0), &config.place), at(23.0)).unwrap();
    assert_eq!(report.unreadable.len(), 1, "{:?}", report.unreadable);
    assert!(report.unreadable[0].starts_with("the state `night` of 2026-11-22 00:00:00"), "{:?}", report.unreadable);
}
