//! An archive node and the years: a database of before, old values, the night's copy, and what the bus is answered.

use std::path::Path;
use std::time::Duration;

use bus::{Bus, Clock};
use contract::archive::{ArchiveAnswer, ArchiveQuestion, ArchiveRow, Ask, Series, SeriesName};
use contract::{Address, DeviceState, Key, Kind, Link, Role};
use node::Node;
use node_archive::database::{Database, Write};
use node_archive::reader::Reader;
use rusqlite::Connection;
use test_support::{LIMIT, PARANAL, RunningNode, block, join, private_bus, until};
use units::Utc;

use crate::in_the_night;

const DAY_S: f64 = 86_400.0;

fn address() -> Address {
    Address::new("paranal", "callisto").unwrap()
}

fn station() -> contract::Device {
    address().device(Kind::ObservingConditions, &"wx".parse().unwrap())
}

fn archive(folder: &Path, bus: Bus) -> RunningNode {
    let station = block("observingconditions", "wx", "localhost:1", "");
    let text = format!("{PARANAL}[archive]\nraw_days = 2\nbackup_count = 3\n{station}");
    let config = config::parse(&text, folder).unwrap();
    let node = Node::new(Role::Archive, "main".parse().unwrap(), config, Default::default(), bus);
    RunningNode::work(node, node_archive::run)
}

async fn ask(bus: &Bus, properties: &[&str], (from, to): (Utc, Utc), points: u32) -> Vec<Series> {
    let name = |property: &&str| SeriesName {
        kind: Kind::ObservingConditions,
        device: "wx".to_owned(),
        property: (*property).to_owned(),
    };
    let ask = Ask::Series { properties: properties.iter().map(name).collect(), points };
    let question = ArchiveQuestion { ask, from_utc: Some(from), to_utc: Some(to), limit: None };
    let asked = async {
        loop {
            // A node that has just started does not answer yet.
            let answer =
                bus.ask::<_, ArchiveAnswer>(&Key::History(address()), &question, Duration::from_secs(10)).await;
            if let Ok(answer) = answer {
                return answer;
            }
        }
    };
    let answer = tokio::time::timeout(LIMIT, asked).await.unwrap();
    let series = |row| match row {
        ArchiveRow::Series(series) => series,
        other => panic!("{other:?}"),
    };
    answer.rows.into_iter().map(series).collect()
}

/// The tables of the first version, with a value each hour of five days that ended yesterday.
fn database_of_before(path: &Path, now: Utc) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let old = Connection::open(path).unwrap();
    old.execute_batch(
        "CREATE TABLE polling (
            device_type TEXT NOT NULL, device_name TEXT NOT NULL, device_command TEXT NOT NULL,
            device_value TEXT, datetime TEXT NOT NULL, value_type TEXT NOT NULL, no_data TEXT, telescope TEXT NOT NULL,
            boot_id TEXT NOT NULL, seq INTEGER NOT NULL,
            UNIQUE (device_type, device_name, device_command, datetime, telescope)
        );
        CREATE TABLE images (
            filename TEXT NOT NULL, camera_name TEXT NOT NULL, complete_hdr INTEGER NOT NULL, date_obs TEXT NOT NULL,
            frame_id TEXT NOT NULL UNIQUE, file TEXT NOT NULL, sha256 TEXT NOT NULL, bytes INTEGER NOT NULL,
            stored TEXT NOT NULL, frame TEXT NOT NULL
        );
        CREATE TABLE writing (frame_id TEXT PRIMARY KEY, file TEXT NOT NULL);
        CREATE TABLE log (
            datetime TEXT NOT NULL, level TEXT NOT NULL, message TEXT NOT NULL, node TEXT NOT NULL, target TEXT NOT NULL,
            telescope TEXT NOT NULL, boot_id TEXT NOT NULL, seq INTEGER NOT NULL, UNIQUE (boot_id, seq, node)
        );
        PRAGMA user_version = 1;",
    )
    .unwrap();
    let put =
        "INSERT INTO polling VALUES ('ObservingConditions', 'wx', 'WindGust', ?, ?, 'float', NULL, 'callisto', 'b', ?)";
    for hour in 24..144 {
        let at = now.plus_seconds(-3600.0 * f64::from(hour)).strftime("%Y-%m-%d %H:%M:%S.%6f");
        let gust = if hour == 100 { "31.5".to_owned() } else { format!("{}.5", hour % 7) };
        old.execute(put, rusqlite::params![gust, at, hour]).unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_of_before_is_brought_up_to_date_copied_and_thinned_and_its_gust_is_still_seen() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("data/archive.db");
    let bus = private_bus(in_the_night()).await;
    let now = bus.clock().utc();
    database_of_before(&path, now);
    let running = archive(folder.path(), join(&bus).await);
    let copies = || {
        let entries = std::fs::read_dir(folder.path().join("data/backups")).into_iter().flatten();
        entries.filter(|entry| entry.as_ref().unwrap().path().extension().is_some_and(|ending| ending == "db")).count()
    };
    until("the night's copy", || copies() == 1).await;
    until("old values gone", || Reader::open(&path, "callisto").unwrap().days_of_values().unwrap() == 2).await;
    // The values went, their minutes did not.
    let rows = Connection::open(&path).unwrap();
    let count = |sql: &str| rows.query_row(sql, [], |row| row.get::<_, i64>(0)).unwrap();
    assert!(count("SELECT count(*) FROM samples") <= 48);
    assert_eq!(count("SELECT count(*) FROM minutes"), 120);
    let old = Connection::open(folder.path().join("data/archive.db.version-1-1")).unwrap();
    assert_eq!(old.query_row("SELECT count(*) FROM polling", [], |row| row.get::<_, i64>(0)).unwrap(), 120);

    // What is polled now comes on top, and the bus is answered from both.
    let publisher = bus.publisher(&Key::State(station())).await.unwrap();
    for second in 0..5 {
        let at = now.plus_seconds(f64::from(second));
        let state = DeviceState {
            link: Link::Connected,
            busy: false,
            period_s: 1.0,
            poll_s: None,
            last_command: None,
            fields: serde_json::Value::Null,
            readings: serde_json::from_value(serde_json::json!({
                "WindGust": { "value": 4.0 + f64::from(second), "at_utc": at },
                "RainRate": { "no_data": "timeout", "at_utc": at },
            }))
            .unwrap(),
        };
        publisher.put(state).await.unwrap();
    }
    let stored = async {
        loop {
            let series = ask(&bus, &["WindGust"], (now.plus_seconds(-1.0), now.plus_seconds(60.0)), 100).await;
            if series[0].points.len() == 5 {
                return series;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    let fresh = tokio::time::timeout(LIMIT, stored).await.unwrap();
    assert_eq!(fresh[0].points.iter().map(|point| point.max).collect::<Vec<_>>(), [4.0, 5.0, 6.0, 7.0, 8.0].map(Some));
    let week = (now.plus_seconds(-7.0 * DAY_S), now.plus_seconds(60.0));
    let both = ask(&bus, &["WindGust", "RainRate"], week, 50).await;
    let [gust, rain] = &both[..] else { panic!("two series: {both:?}") };
    assert_eq!(gust.points.iter().filter_map(|point| point.max).fold(0.0, f64::max), 31.5);
    assert_eq!(gust.points.iter().map(|point| point.count).sum::<u64>(), 125);
    assert!(gust.points.len() <= 50);
    assert!(!gust.gaps.is_empty(), "the day of which nothing is known, and the days before");
    assert_eq!((rain.points.len(), rain.gaps.len()), (0, 1), "asked for, and never answered");
    running.stop().await;

    // Started again: the same copy serves for this night, and nothing is converted a second time.
    let running = archive(folder.path(), join(&bus).await);
    let again = async {
        while ask(&bus, &["WindGust"], week, 50).await[0].points.len() != gust.points.len() {
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    tokio::time::timeout(LIMIT, again).await.unwrap();
    assert_eq!(copies(), 1);
    assert!(!folder.path().join("data/archive.db.version-7-1").exists());
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_telescopes_with_one_database_each_is_answered_with_its_own_values() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let alerts = node::NodeAlerts::new(Clock::machine_clock());
    let (database, writer) = Database::open(&path, "callisto", alerts).unwrap();
    let now = Clock::machine_clock().utc();
    for (telescope, value) in [("callisto", 1), ("io", 2), ("shared", 3)] {
        let address = Address::new("paranal", telescope).unwrap();
        for property in ["Humidity", if telescope == "shared" { "RainRate" } else { "Pressure" }] {
            let device = address.device(Kind::ObservingConditions, &"wx".parse().unwrap());
            let (property, value) = (property.to_owned(), Ok(contract::Scalar::Int(value)));
            database.commit(vec![Write::Reading { device, property, value, at: now }]).await.unwrap();
        }
    }
    let value = |telescope: &str, property: &str| {
        let ask =
            Ask::Readings { kind: Kind::ObservingConditions, device: "wx".to_owned(), property: property.to_owned() };
        let question = ArchiveQuestion { ask, from_utc: None, to_utc: None, limit: None };
        let rows = Reader::open(&path, telescope).unwrap().answer(&question, now).unwrap().rows;
        rows.into_iter().map(|row| match row {
            ArchiveRow::Reading { value: Some(contract::Scalar::Int(value)), .. } => value,
            other => panic!("{other:?}"),
        })
    };
    for (telescope, property, expected) in [
        ("callisto", "Humidity", &[1][..]),
        ("io", "Humidity", &[2]),
        ("io", "Pressure", &[2]),
        ("io", "RainRate", &[3]),
        ("europa", "Pressure", &[]),
        ("europa", "Humidity", &[3]),
    ] {
        assert_eq!(value(telescope, property).collect::<Vec<_>>(), expected, "{telescope} {property}");
    }
    drop(database);
    writer.end().await;
}
