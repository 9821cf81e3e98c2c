//! Years of values: what a database of before brings, what stays for ever, and what a copy gives back.

use bus::Clock;
use contract::archive::{ArchiveAnswer, ArchiveQuestion, ArchiveRow, Ask, Series, SeriesName};
use contract::{Address, Kind};
use node::NodeAlerts;

use super::*;
use crate::database::{Database, Write, Writer};
use crate::reader::Reader;

const DAY_S: i64 = 86_400;

fn at(second: i64) -> Utc {
    Utc::from_micros((1_795_219_200 + second) * 1_000_000)
}

fn station() -> Device {
    Address::new("paranal", "callisto").unwrap().device(Kind::ObservingConditions, &"wx".parse().unwrap())
}

fn open(folder: &std::path::Path) -> (Database, Writer) {
    Database::open(&folder.join("archive.db"), "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap()
}

async fn poll(database: &Database, property: &str, second: i64, value: Result<Scalar, &str>) {
    let (property, value) = (property.to_owned(), value.map_err(str::to_owned));
    database.put(Write::Reading { device: station(), property, value, at: at(second) }).await.unwrap();
}

async fn close(database: Database, writer: Writer) {
    drop(database);
    writer.end().await;
}

fn ask(folder: &std::path::Path, properties: &[&str], (from, to): (i64, i64), points: u32) -> Vec<Series> {
    let property = |name: &&str| SeriesName {
        kind: Kind::ObservingConditions,
        device: "wx".to_owned(),
        property: (*name).to_owned(),
    };
    let properties = properties.iter().map(property).collect();
    let ask = Ask::Series { properties, points };
    let question = ArchiveQuestion { ask, from_utc: Some(at(from)), to_utc: Some(at(to)), limit: None };
    let reader = Reader::open(&folder.join("archive.db"), "callisto").unwrap();
    let answer: ArchiveAnswer = reader.answer(&question, at(to)).unwrap();
    let series = |row| match row {
        ArchiveRow::Series(series) => series,
        other => panic!("{other:?}"),
    };
    answer.rows.into_iter().map(series).collect()
}

fn seconds(at_utc: Utc) -> i64 {
    at_utc.seconds_since(at(0)) as i64
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gust_of_five_seconds_is_seen_in_three_days_drawn_with_a_hundred_points() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = open(folder.path());
    let (gust, silent) = (150_003..150_008, 60_000..70_000);
    for second in (0..3 * DAY_S).filter(|second| !silent.contains(second)) {
        let wind = if gust.contains(&second) { 31.5 } else { 2.0 + (second % 7) as f64 };
        poll(&database, "WindGust", second, Ok(Scalar::Float(wind))).await;
    }
    close(database, writer).await;
    let [wind] = &ask(folder.path(), &["WindGust"], (0, 3 * DAY_S), 100)[..] else { panic!("one series") };
    assert!(wind.points.len() <= 100 && wind.points.len() > 90, "{}", wind.points.len());
    let highest: Vec<i64> =
        wind.points.iter().filter(|point| point.max == Some(31.5)).map(|point| seconds(point.at_utc)).collect();
    assert_eq!(highest.len(), 1, "in the piece of time in which it blew");
    assert!((0..wind.piece_s as i64).contains(&(150_003 - highest[0])), "{highest:?} {}", wind.piece_s);
    assert!(wind.points.iter().all(|point| point.min == Some(2.0)));
    let all = wind.points.iter().map(|point| point.count).sum::<u64>();
    assert_eq!(all, (3 * DAY_S - 10_000) as u64, "each value counts once");
    let gaps: Vec<(i64, i64)> = wind.gaps.iter().map(|gap| (seconds(gap.from_utc), seconds(gap.to_utc))).collect();
    assert_eq!(gaps.len(), 1, "{gaps:?}");
    assert!((59_940..=60_000).contains(&gaps[0].0) && (69_960..=70_020).contains(&gaps[0].1), "{gaps:?}");
    // An hour of it: the values themselves, and the gust among them.
    let [wind] = &ask(folder.path(), &["WindGust"], (149_000, 149_000 + 3600), 4000)[..] else { panic!("one series") };
    assert_eq!((wind.points.len(), wind.piece_s), (3600, 0.0));
    assert_eq!(wind.points.iter().filter(|point| point.max == Some(31.5)).count(), 5);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_minute_keeps_what_its_values_were_however_they_came() {
    let folder = tempfile::tempdir().unwrap();
    let values = [(0, 3.0), (59, 5.0), (20, 1.0), (40, 7.0)];
    // In four batches, two of them after a restart, one value twice, and not in the order of time.
    for part in values.chunks(2) {
        let (database, writer) = open(folder.path());
        for (second, value) in part {
            for _ in 0..2 {
                let write = Write::Reading {
                    device: station(),
                    property: "WindSpeed".to_owned(),
                    value: Ok(Scalar::Float(*value)),
                    at: at(*second),
                };
                database.commit(vec![write]).await.unwrap();
            }
        }
        poll(&database, "WindSpeed", 30 + part[0].0, Err("timeout")).await;
        poll(&database, "SkyText", part[0].0, Ok(Scalar::Text("clear".to_owned()))).await;
        poll(&database, "Safe", part[0].0, Ok(Scalar::Bool(part[0].0 > 0))).await;
        close(database, writer).await;
    }
    let rows = rusqlite::Connection::open(folder.path().join("archive.db")).unwrap();
    type Row = (i64, i64, Option<f64>, Option<f64>, Option<f64>, Value);
    let minute = |name: &str| {
        let sql = "SELECT polled, missing, minimum, mean, maximum, last FROM minutes JOIN series ON id = series
            WHERE device_command = ?";
        let read = |row: &rusqlite::Row<'_>| -> rusqlite::Result<Row> {
            Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?, row.get(4)?, row.get(5)?))
        };
        rows.query_row(sql, [name], read).unwrap()
    };
    assert_eq!(minute("WindSpeed"), (6, 2, Some(1.0), Some(4.0), Some(7.0), Value::Real(5.0)));
    assert_eq!(minute("SkyText"), (2, 0, None, None, None, Value::Text("clear".to_owned())));
    assert_eq!(minute("Safe"), (2, 0, Some(0.0), Some(0.5), Some(1.0), Value::Integer(1)));
    // Text has no extremes; its last value is drawn.
    let [sky] = &ask(folder.path(), &["SkyText"], (-DAY_S, DAY_S), 10)[..] else { panic!("one series") };
    assert_eq!(sky.points[0].last, Some(Scalar::Text("clear".to_owned())));
    assert_eq!(ask(folder.path(), &["Nothing"], (0, DAY_S), 10)[0].points, []);
}

#[tokio::test(flavor = "multi_thread")]
async fn old_values_go_their_minutes_stay_and_a_clock_years_ahead_makes_none_old() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = open(folder.path());
    for second in (0..10 * DAY_S).step_by(600) {
        poll(&database, "Humidity", second, Ok(Scalar::Int(second / DAY_S))).await;
    }
    // For an hour the clock was 30 years ahead.
    poll(&database, "Humidity", 30 * 365 * DAY_S, Ok(Scalar::Int(99))).await;
    database.commit(vec![Write::ForgetOld { days: 4 }]).await.unwrap();
    close(database, writer).await;
    let path = folder.path().join("archive.db");
    assert_eq!(Reader::open(&path, "callisto").unwrap().days_of_values().unwrap(), 4);
    let rows = rusqlite::Connection::open(&path).unwrap();
    let count = |sql: &str| rows.query_row(sql, [], |row| row.get::<_, i64>(0)).unwrap();
    assert_eq!(count("SELECT count(*) FROM samples"), 3 * 144 + 1, "three days of the ten, and the one ahead");
    assert_eq!(count("SELECT count(*) FROM minutes"), 10 * 144 + 1);
    // What is older than the values is drawn from minutes however short the time is.
    let [humidity] = &ask(folder.path(), &["Humidity"], (DAY_S, DAY_S + 3600), 1000)[..] else { panic!("one series") };
    assert_eq!(humidity.points.iter().map(|point| point.max).collect::<Vec<_>>(), [Some(1.0); 6]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_of_version_4_keeps_every_value_and_a_copy_of_itself() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let old = rusqlite::Connection::open(&path).unwrap();
    for made in [super::super::rows::SCHEMA, super::super::rows::AUDIT, super::super::rows::FACTS] {
        old.execute_batch(made).unwrap();
    }
    old.execute_batch(super::super::rows::SOLUTIONS).unwrap();
    let polled = [
        ("WindGust", Some("12.25"), "2026-11-21 03:12:45.103000", "float", None),
        ("WindGust", Some("2.5e-07"), "2026-11-21 03:12:50.000001", "float", None),
        ("WindGust", None, "2026-11-21 03:12:55.000000", "none", Some("timeout")),
        ("Count", Some("-7"), "2026-11-21 03:12:45.103000", "int", None),
        ("Safe", Some("True"), "2026-11-21 03:12:45.103000", "bool", None),
        ("Sky", Some("O'Brien's"), "2026-11-21 03:12:45.103000", "text", None),
        ("Names", Some("[\"R\",1]"), "2026-11-21 03:12:45.103000", "list", None),
    ];
    let put = "INSERT INTO polling VALUES ('ObservingConditions', 'wx', ?1, ?2, ?3, ?4, ?5, 'callisto', 'boot', 3)";
    for (property, value, datetime, value_type, no_data) in polled {
        old.execute(put, params![property, value, datetime, value_type, no_data]).unwrap();
    }
    old.pragma_update(None, "user_version", 4).unwrap();
    type Row = (String, Option<String>, String, String, Option<String>, String);
    let all = |connection: &rusqlite::Connection| -> Vec<Row> {
        let sql =
            "SELECT device_command, device_value, datetime, value_type, no_data, telescope FROM polling ORDER BY 1, 3";
        let mut statement = connection.prepare(sql).unwrap();
        let rows = statement
            .query_map([], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?, row.get(4)?, row.get(5)?)));
        rows.unwrap().map(Result::unwrap).collect()
    };
    let before = all(&old);
    drop(old);
    let (database, writer) = open(folder.path());
    poll(&database, "WindGust", 0, Ok(Scalar::Float(1.0))).await;
    close(database, writer).await;
    let now = rusqlite::Connection::open(&path).unwrap();
    let after: Vec<Row> = all(&now).into_iter().filter(|row| row.2.as_str() > "2026-11-21 03").collect();
    assert_eq!(after, before);
    assert_eq!(all(&rusqlite::Connection::open(folder.path().join("archive.db.version-4-1")).unwrap()), before);
    let reader = Reader::open(&path, "callisto").unwrap();
    let instant = "2026-11-21T03:12:46Z".parse().unwrap();
    let around = |property: &str| reader.around(&station(), property, instant).unwrap().before.remove(0).value;
    assert_eq!(around("WindGust"), Scalar::Float(12.25));
    assert_eq!(around("Safe"), Scalar::Bool(true));
    assert_eq!(around("Names"), Scalar::List(vec![Scalar::Text("R".to_owned()), Scalar::Int(1)]));
    assert_eq!(reader.days_of_values().unwrap(), 1);
    let counted: i64 = now.query_row("SELECT sum(polled) FROM minutes", [], |row| row.get(0)).unwrap();
    assert_eq!(counted, polled.len() as i64 + 1);
}
