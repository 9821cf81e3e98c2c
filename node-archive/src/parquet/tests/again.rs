//! Nights that are written again, after an older database was put back, a kill, a corrected longitude or a disk that
//! was away; and what a database that is made from them has then.

use super::*;

async fn store(config: &config::Observatory, batches: Vec<Vec<Write>>) {
    let alerts = NodeAlerts::new(Clock::machine_clock());
    let (database, writer) = Database::open(&config.archive.database, "callisto", alerts).unwrap();
    for writes in batches {
        database.commit(writes).await.unwrap();
    }
    drop(database);
    writer.end().await;
}

fn rows_of(database: &Path, table: &str) -> Vec<String> {
    everything(database).into_iter().find(|(name, _)| name == table).unwrap().1
}

fn dates(config: &config::Observatory) -> Vec<String> {
    nights(config).unwrap().iter().map(|night| night.date.to_string()).collect()
}

fn wind(second: i64) -> Write {
    reading("callisto", ("WindGust", Ok(Scalar::Float(3.5))), second)
}

fn wind_at(at: Utc) -> Write {
    let device = Address::new("paranal", "callisto").unwrap().device(Kind::ObservingConditions, &"wx".parse().unwrap());
    Write::Reading { device, property: "WindGust".to_owned(), value: Ok(Scalar::Float(3.5)), at }
}

fn alerts(alerts: Vec<Alert>, second: i64, origin: (BootId, u64)) -> Write {
    Write::Alerts(Box::new(StoredAlerts { alerts, at: at(second), origin }))
}

fn state(second: i64, origin: (BootId, u64)) -> Write {
    let (same, state) = ("open".to_owned(), "{}".to_owned());
    Write::State(Box::new(StoredState { part: "night", same, state, at: at(second), gap_s: 15.0, origin }))
}

#[tokio::test(flavor = "multi_thread")]
async fn an_older_database_that_is_put_back_opens_no_alert_again_and_shortens_no_state() {
    let folder = tempfile::tempdir().unwrap();
    let (mut config, files) = (config(folder.path()), folder.path().join("network"));
    let boot = BootId::fresh();
    let active: Alerts = golden("alerts");
    let alert = Alert { raised_utc: at(100), ..active.alerts[0].clone() };
    let before = vec![state(110, (boot.clone(), 1)), alerts(vec![alert], 113, (boot.clone(), 1))];
    let after = vec![state(120, (boot.clone(), 2)), alerts(Vec::new(), 900, (boot.clone(), 2))];
    store(&config, vec![before.clone(), after]).await;
    let newest = config.archive.database.clone();
    write_all(&config, &files);

    config.archive.database = folder.path().join("older.db");
    store(&config, vec![before]).await;
    let parts = write_all(&config, &files);
    for table in ["alerts", "states"] {
        let part = parts.iter().find(|part| part.table == table).unwrap();
        assert_eq!((part.outcome, part.rows), (Outcome::Unchanged, 1), "{table}");
    }
    let made = folder.path().join("made.db");
    refill(&config, &files, &made).await.unwrap();
    for table in ["alerts", "states"] {
        assert_eq!(rows_of(&made, table), rows_of(&newest, table), "{table}");
        assert_ne!(rows_of(&made, table), rows_of(&config.archive.database, table), "{table} went on");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn facts_that_learn_late_when_their_frame_began_are_the_newest_ones_in_a_new_database() {
    let folder = tempfile::tempdir().unwrap();
    let (config, files) = (config(folder.path()), folder.path().join("network"));
    let boot = BootId::fresh();
    let facts = |started: Option<i64>, second: i64, seq: u64| {
        let frame = CommandId("frame-x".to_owned());
        let facts = FrameFacts { frame, started_utc: started.map(at), ..golden("observatory.facts") };
        Write::Facts(Box::new(StoredFacts { facts, at: at(second), origin: (boot.clone(), seq) }))
    };
    store(&config, vec![vec![facts(None, 2 * DAY_S + 100, 1)]]).await;
    write_all(&config, &files);
    // They move from the night in which they were published to that of the frame; no file loses its row.
    store(&config, vec![vec![facts(Some(50), 2 * DAY_S + 200, 2)]]).await;
    write_all(&config, &files);
    assert_eq!(
        partition(&config, &files).nights(&parquet_nights::NIGHTS).unwrap().into_iter().collect::<Vec<_>>(),
        ["20261121", "20261123"]
    );
    let made = folder.path().join("made.db");
    refill(&config, &files, &made).await.unwrap();
    assert_eq!(rows_of(&made, "facts"), rows_of(&config.archive.database, "facts"));
    assert_eq!(rows_of(&made, "facts").len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn values_of_every_second_day_come_back_for_as_many_days_as_are_stored() {
    let folder = tempfile::tempdir().unwrap();
    let (config, files) = (config(folder.path()), folder.path().join("network"));
    // In the morning and in the evening of a day: two nights for each day, and `raw_days` is 3.
    let days = [-2, 0, 2, 4];
    let of_day = |day: i64| [6, 18].map(|hour| wind(DAY_S / 2 + day * DAY_S + hour * 3600)).to_vec();
    store(&config, days.map(of_day).to_vec()).await;
    assert_eq!(dates(&config).len(), 8);
    write_all(&config, &files);
    forget(&config).await;
    let made = folder.path().join("made.db");
    refill(&config, &files, &made).await.unwrap();
    for (table, rows) in [("samples", 6), ("days", 3), ("minutes", 8), ("series", 1)] {
        assert_eq!(rows_of(&config.archive.database, table).len(), rows, "{table}");
        assert_eq!(rows_of(&made, table), rows_of(&config.archive.database, table), "{table}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_value_of_the_seconds_between_noon_and_the_next_minute_is_in_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let (mut config, files) = (config(folder.path()), folder.path().join("network"));
    // Noon is 16:41:36 UTC: the minute of the value began in the night before.
    config.place.longitude_deg = -70.4;
    let noon = Night::at(at(40_000), &config.place).from;
    store(&config, vec![vec![wind_at(noon.plus_seconds(2.0))]]).await;
    assert_eq!(dates(&config), ["20261120", "20261121"]);
    write_all(&config, &files);
    let made = folder.path().join("made.db");
    refill(&config, &files, &made).await.unwrap();
    for table in ["samples", "minutes"] {
        assert_eq!(rows_of(&made, table), rows_of(&config.archive.database, table), "{table}");
        assert_eq!(rows_of(&made, table).len(), 1, "{table}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn times_of_a_clock_that_was_never_set_or_is_centuries_ahead_are_nights_like_others() {
    let folder = tempfile::tempdir().unwrap();
    let (config, files) = (config(folder.path()), folder.path().join("network"));
    let times = ["1970-01-01T00:00:01Z", "2028-02-29T23:59:59.999999Z", "2028-03-01T12:00:00Z", "2999-12-31T23:00:00Z"];
    store(&config, vec![times.map(|time| wind_at(time.parse().unwrap())).to_vec()]).await;
    assert_eq!(dates(&config), ["19691231", "20280229", "20280301", "29991231"]);
    write_all(&config, &files);
    forget(&config).await;
    let made = folder.path().join("made.db");
    refill(&config, &files, &made).await.unwrap();
    assert_eq!(rows_of(&made, "samples"), rows_of(&config.archive.database, "samples"));
    assert_eq!(rows_of(&made, "minutes"), rows_of(&config.archive.database, "minutes"));
    assert_eq!(rows_of(&made, "minutes").len(), 4);
}

#[test]
fn a_noon_belongs_to_the_night_that_begins_then_at_every_longitude() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path());
    for longitude_deg in [-180.0, -155.471_3, -70.403_2, -0.1, 0.0, 1.0 / 3.0, 98.486_7, 179.999_999, 289.6] {
        config.place.longitude_deg = longitude_deg;
        for day in 0..800 {
            let night = Night::at(at(day * DAY_S + 1234), &config.place);
            let is_of = |time| Night::at(time, &config.place) == night;
            assert!(is_of(night.from) && is_of(night.to.plus_seconds(-1e-6)), "{longitude_deg} {}", night.date);
            assert!(!is_of(night.to) && !is_of(night.from.plus_seconds(-1e-6)), "{longitude_deg} {}", night.date);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_corrected_longitude_moves_rows_to_another_night_and_doubles_none() {
    let folder = tempfile::tempdir().unwrap();
    let (mut config, files) = (config(folder.path()), folder.path().join("network"));
    database(&config).await;
    write_all(&config, &files);
    // Noon is 2.4 s earlier: the last value of each night is in the next one now.
    config.place.longitude_deg = 0.01;
    write_all(&config, &files);
    assert_eq!(partition(&config, &files).nights(&parquet_nights::NIGHTS).unwrap().len(), 6);
    forget(&config).await;
    let made = folder.path().join("made.db");
    refill(&config, &files, &made).await.unwrap();
    for ((table, before), (_, after)) in everything(&config.archive.database).iter().zip(&everything(&made)) {
        assert_eq!(before, after, "{table}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_night_without_anything_makes_no_file_and_no_folder() {
    let folder = tempfile::tempdir().unwrap();
    let (config, files) = (config(folder.path()), folder.path().join("network"));
    store(&config, Vec::new()).await;
    assert_eq!(dates(&config), [""; 0]);
    let night = Night::at(at(0), &config.place);
    let parts = write(&config, &night, &files).unwrap();
    assert_eq!(parts.len(), TABLES.len());
    assert!(parts.iter().all(|part| (part.outcome, part.rows, part.bytes) == (Outcome::Empty, 0, 0)), "{parts:#?}");
    assert!(!files.exists());
    assert!(partition(&config, &files).nights(&parquet_nights::NIGHTS).unwrap().is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_killed_rebuild_left_under_the_same_process_id_is_in_no_new_database() {
    let folder = tempfile::tempdir().unwrap();
    let (config, files) = (config(folder.path()), folder.path().join("network"));
    store(&config, vec![vec![wind(60), wind(120)]]).await;
    write_all(&config, &files);
    let left = |name: &str| folder.path().join(format!("{name}.part-{}", std::process::id()));
    fs::write(left("one.db"), "half a database").unwrap();
    // Whole, and of another telescope's nights.
    let mut other = config.clone();
    other.archive.database = left("two.db");
    store(&other, vec![vec![reading("shared", ("Humidity", Ok(Scalar::Float(1.0))), 999)]]).await;
    for name in ["one.db", "two.db"] {
        let made = folder.path().join(name);
        refill(&config, &files, &made).await.unwrap();
        for table in ["samples", "series"] {
            assert_eq!(rows_of(&made, table), rows_of(&config.archive.database, table), "{name} {table}");
        }
        assert!(!left(name).exists(), "{name}");
    }
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn a_file_that_lies_on_a_disk_that_is_away_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let (config, files) = (config(folder.path()), folder.path().join("network"));
    database(&config).await;
    let parts = write_all(&config, &files);
    let night = nights(&config).unwrap()[0];
    let part = parts.iter().find(|part| part.table == "telemetry").unwrap().path.clone();
    let (disk, away) = (folder.path().join("disk"), folder.path().join("away"));
    fs::create_dir(&disk).unwrap();
    fs::rename(&part, disk.join("part")).unwrap();
    std::os::unix::fs::symlink(disk.join("part"), &part).unwrap();
    fs::rename(&disk, &away).unwrap();
    let error = format!("{:#}", write(&config, &night, &files).unwrap_err());
    assert!(error.contains(part.to_str().unwrap()), "{error}");
    assert!(fs::symlink_metadata(&part).unwrap().file_type().is_symlink(), "the link is as it was");
    fs::rename(&away, &disk).unwrap();
    let again = write(&config, &night, &files).unwrap();
    assert!(again.iter().all(|part| part.outcome == Outcome::Unchanged), "{again:#?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_night_under_the_name_of_another_is_refused_and_foreign_files_are_no_night() {
    let folder = tempfile::tempdir().unwrap();
    let (config, files) = (config(folder.path()), folder.path().join("network"));
    store(&config, vec![vec![wind(60)], vec![wind(DAY_S + 60)]]).await;
    write_all(&config, &files);
    let nights = files.join("minutes/site=paranal/telescope=callisto");
    let (first, second) = (nights.join("night=20261121"), nights.join("night=20261122"));
    let (bytes, other) = (fs::read(first.join("part-0.parquet")), fs::read(second.join("part-0.parquet")));
    // A copy of the wrong night.
    fs::write(first.join("part-0.parquet"), other.unwrap()).unwrap();
    let made = folder.path().join("made.db");
    let error = format!("{:#}", refill(&config, &files, &made).await.unwrap_err());
    assert!(error.contains("written for night 20261122, and its folder is that of 20261121"), "{error}");
    let error = format!("{:#}", write(&config, &Night::at(at(60), &config.place), &files).unwrap_err());
    assert!(error.contains("Move it away"), "{error}");
    fs::write(first.join("part-0.parquet"), bytes.unwrap()).unwrap();
    // What other programs leave next to the nights is none of them.
    fs::create_dir(nights.join("night=20261123")).unwrap();
    fs::write(nights.join(".DS_Store"), "x").unwrap();
    assert_eq!(refill(&config, &files, &made).await.unwrap().nights, 2);
}
