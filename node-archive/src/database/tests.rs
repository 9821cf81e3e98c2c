//! Rows in, rows out.

use std::collections::BTreeMap;

use bus::Clock;
use contract::archive::{Ask, Question, Row};
use contract::device::camera::{Pixel, Purpose};
use contract::{Address, Kind};

use super::*;
use crate::reader::Reader;

fn open(folder: &Path) -> (Database, Writer) {
    Database::open(&folder.join("deep/archive.db"), AlertBoard::new(Clock::machine_clock())).unwrap()
}

fn at(second: i64) -> Utc {
    Utc::from_micros(1_795_230_000_000_000 + second * 1_000_000)
}

fn device() -> Device {
    Address::new("paranal", "callisto").unwrap().device(Kind::Telescope, &"mount".parse().unwrap())
}

fn reading(boot_id: &BootId, second: i64, value: Result<Scalar, String>) -> Write {
    let said = (boot_id.clone(), second.unsigned_abs());
    Write::Reading { device: device(), property: "Altitude".to_owned(), value, at: at(second), said }
}

fn image(id: &str, object: &str) -> StoredImage {
    let frame = Frame {
        id: CommandId(id.to_owned()),
        camera: "andor".to_owned(),
        purpose: Purpose { object: Some(object.to_owned()), ..Purpose::default() },
        width_px: 1,
        height_px: 1,
        planes: 1,
        pixel: Pixel::U16,
        bin: 1,
        origin_px: [0, 0],
        started_utc: at(0),
        exposure_s: 1.0,
        url: "http://spool/?token=secret".to_owned(),
        bytes: 2,
        sha256: "ab".to_owned(),
        readings: BTreeMap::new(),
    };
    StoredImage {
        frame,
        path: format!("/images/{id}.fits").into(),
        file: format!("{id}.fits"),
        bytes: 5760,
        stored: at(2),
    }
}

fn ask(ask: Ask, from: Option<i64>, to: Option<i64>, limit: Option<u32>) -> Question {
    Question { ask, from_utc: from.map(at), to_utc: to.map(at), limit }
}

fn altitude() -> Ask {
    Ask::Readings { kind: Kind::Telescope, device: "mount".to_owned(), property: "Altitude".to_owned() }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reading_counts_once_and_keeps_its_type() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = open(folder.path());
    let boot_id = BootId::fresh();
    let values = [
        Scalar::Float(2.0),
        Scalar::Float(1e-7),
        Scalar::Int(3),
        Scalar::Bool(true),
        Scalar::Text("12".to_owned()),
        Scalar::List(vec![Scalar::Text("R".to_owned()), Scalar::Int(1)]),
    ];
    for _ in 0..2 {
        for (second, value) in values.iter().enumerate() {
            database.put(reading(&boot_id, second as i64, Ok(value.clone()))).await.unwrap();
        }
    }
    database.commit(vec![reading(&boot_id, 6, Err("timeout".to_owned()))]).await.unwrap();
    assert_eq!(database.rows(), 7);
    let reader = Reader::open(database.path()).unwrap();
    let answer = reader.answer(&ask(altitude(), None, None, None)).unwrap();
    let told: Vec<Option<Scalar>> = answer
        .rows
        .iter()
        .map(|row| match row {
            Row::Reading { value, .. } => value.clone(),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(told[..6], values.map(Some));
    assert_eq!(told[6], None);

    let around = reader.around(&device(), "Altitude", at(1)).unwrap();
    assert_eq!((around.before.unwrap().value, around.after.unwrap().value), (Scalar::Float(2.0), Scalar::Float(1e-7)));
    let around = reader.around(&device(), "Altitude", at(6)).unwrap();
    assert!(around.after.is_none() && around.heard_since, "it was heard, with no value");
    assert!(!reader.around(&device(), "Altitude", at(7)).unwrap().heard_since);
    let shared = device().address.shared().device(Kind::Telescope, &device().name);
    assert!(reader.around(&shared, "Altitude", at(1)).unwrap().before.is_none(), "another telescope's");
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_is_the_newest_rows_that_fit_oldest_first() {
    let folder = tempfile::tempdir().unwrap();
    let (database, _writer) = open(folder.path());
    let boot_id = BootId::fresh();
    for second in 0..20 {
        database.put(reading(&boot_id, second, Ok(Scalar::Int(second)))).await.unwrap();
    }
    let line = |message: &str, seq| Write::Log {
        telescope: "callisto".to_owned(),
        node: "device/main".to_owned(),
        target: "x".to_owned(),
        level: Level::Warn,
        message: message.to_owned(),
        at: at(5),
        said: (boot_id.clone(), seq),
    };
    database.commit(vec![line("it's O'Brien", 1), line("it's O'Brien", 1), line("again", 2)]).await.unwrap();
    let reader = Reader::open(database.path()).unwrap();
    let seconds = |question: Question| {
        let answer = reader.answer(&question).unwrap();
        let seconds = answer.rows.iter().map(|row| match row {
            Row::Reading { at_utc, .. } => at_utc.seconds_since(at(0)) as i64,
            other => panic!("{other:?}"),
        });
        (seconds.collect::<Vec<_>>(), answer.truncated)
    };
    assert_eq!(seconds(ask(altitude(), Some(5), Some(8), None)), (vec![5, 6, 7], false));
    assert_eq!(seconds(ask(altitude(), None, None, Some(3))), (vec![17, 18, 19], true));
    assert!(!seconds(ask(altitude(), None, None, Some(20))).1);
    assert_eq!(seconds(ask(altitude(), Some(100), None, None)), (vec![], false));
    let log = reader.answer(&ask(Ask::Log, None, None, None)).unwrap().rows;
    assert_eq!(log.len(), 2);
    assert!(
        matches!(&log[0], Row::Log { level: Level::Warn, message, node, .. } if message == "it's O'Brien" && node == "device/main")
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn an_image_is_stored_once_and_completed_once() {
    let folder = tempfile::tempdir().unwrap();
    let (database, _writer) = open(folder.path());
    let named = Write::Writing { frame: CommandId("b".to_owned()), file: "b.fits".to_owned() };
    let image_a = image("a", "Barnard's '); DROP TABLE images; --");
    database
        .commit(vec![named, Write::Stored(Box::new(image_a.clone())), Write::Stored(Box::new(image_a.clone()))])
        .await
        .unwrap();
    let reader = Reader::open(database.path()).unwrap();
    assert_eq!(reader.writing(&CommandId("b".to_owned())).unwrap().as_deref(), Some("b.fits"));
    database.commit(vec![Write::Stored(Box::new(image("b", "B")))]).await.unwrap();
    assert_eq!(reader.writing(&CommandId("b".to_owned())).unwrap(), None);
    let incomplete = reader.incomplete(10).unwrap();
    assert_eq!(incomplete.len(), 2);
    let found = reader.image(&image_a.frame.id).unwrap().unwrap();
    assert_eq!(found.frame.purpose, image_a.frame.purpose);
    assert_eq!(found.frame.url, "", "the token is nobody's business");
    assert_eq!((found.path, found.bytes, found.stored), (image_a.path, 5760, at(2)));
    database.commit(vec![Write::Complete(image_a.frame.id.clone())]).await.unwrap();
    assert_eq!(reader.incomplete(10).unwrap().len(), 1);
    assert_eq!(reader.image_counts().unwrap(), (2, 1));
    let frames = reader.answer(&ask(Ask::Frames, None, None, None)).unwrap().rows;
    let complete = frames.iter().filter(|row| matches!(row, Row::Frame { header_complete: true, .. })).count();
    assert_eq!((frames.len(), complete), (2, 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_locked_database_is_alerted_and_loses_no_row() {
    let folder = tempfile::tempdir().unwrap();
    let alerts = AlertBoard::new(Clock::machine_clock());
    let path = folder.path().join("archive.db");
    let (database, writer) = Database::open(&path, alerts.clone()).unwrap();
    let other = Connection::open(&path).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    let boot_id = BootId::fresh();
    for second in 0..500 {
        database.put(reading(&boot_id, second, Ok(Scalar::Int(second)))).await.unwrap();
    }
    let mut shown = alerts.watch();
    let raised =
        shown.wait_for(|alerts| alerts.alerts.iter().any(|alert| alert.id == AlertKind::ArchiveDatabase.id("")));
    tokio::time::timeout(Duration::from_secs(20), raised).await.unwrap().unwrap();
    other.execute_batch("ROLLBACK").unwrap();
    database.commit(vec![reading(&boot_id, 500, Ok(Scalar::Int(500)))]).await.unwrap();
    assert_eq!(database.rows(), 501);
    assert!(alerts.watch().borrow().alerts.is_empty());
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_of_a_newer_starmesh_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    drop(prepare(&path).unwrap());
    drop(prepare(&path).unwrap());
    Connection::open(&path).unwrap().pragma_update(None, "user_version", VERSION + 1).unwrap();
    assert!(matches!(prepare(&path), Err(DatabaseError::Newer { found, .. }) if found == VERSION + 1));
}
