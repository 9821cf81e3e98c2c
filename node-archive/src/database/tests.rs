//! Rows in, rows out.

use bus::Clock;
use contract::archive::{ArchiveQuestion, ArchiveRow, Ask, PastAlert};
use contract::device::camera::{Frame, Purpose};
use contract::node::Level;
use contract::observatory::{Alert, FrameFacts};
use contract::{Address, BootId, CommandId, Device, Kind, Scalar};
use units::Utc;

use super::stamp::stamp;
use super::*;
use crate::reader::Reader;

mod versions;

fn open(folder: &Path) -> (Database, Writer) {
    Database::open(&folder.join("deep/archive.db"), "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap()
}

fn at(second: i64) -> Utc {
    Utc::from_micros(1_795_230_000_000_000 + second * 1_000_000)
}

fn device() -> Device {
    Address::new("paranal", "callisto").unwrap().device(Kind::Telescope, &"mount".parse().unwrap())
}

fn reading(second: i64, value: Result<Scalar, String>) -> Write {
    Write::Reading { device: device(), property: "Altitude".to_owned(), value, at: at(second) }
}

fn image(id: &str, object: &str) -> StoredImage {
    let frame = Frame {
        purpose: Purpose { object: Some(object.to_owned()), ..Purpose::default() },
        started_utc: at(0),
        exposure_s: 1.0,
        url: "http://spool/?token=secret".to_owned(),
        sha256: "ab".to_owned(),
        ..test_support::frame(id)
    };
    StoredImage { frame, file: format!("{id}.fits"), bytes: 5760, stored: at(2) }
}

fn stored(image: StoredImage) -> Write {
    let path = image.path(Path::new("/images"));
    Write::Stored(Box::new(image), path)
}

fn ask(ask: Ask, from: Option<i64>, to: Option<i64>, limit: Option<u32>) -> ArchiveQuestion {
    ArchiveQuestion { ask, from_utc: from.map(at), to_utc: to.map(at), limit }
}

fn altitude() -> Ask {
    Ask::Readings { kind: Kind::Telescope, device: "mount".to_owned(), property: "Altitude".to_owned() }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reading_counts_once_and_keeps_its_type() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = open(folder.path());
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
            database.put(reading(second as i64, Ok(value.clone()))).await.unwrap();
        }
    }
    database.commit(vec![reading(6, Err("timeout".to_owned()))]).await.unwrap();
    assert_eq!(database.rows(), 7);
    let reader = Reader::open(database.path(), "callisto").unwrap();
    let answer = reader.answer(&ask(altitude(), None, None, None), at(0)).unwrap();
    let read: Vec<Option<Scalar>> = answer
        .rows
        .iter()
        .map(|row| match row {
            ArchiveRow::Reading { value, .. } => value.clone(),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(read[..6], values.map(Some));
    assert_eq!(read[6], None);

    let around = reader.around(&device(), "Altitude", at(1)).unwrap();
    assert_eq!((&around.before[0].value, &around.after[0].value), (&Scalar::Float(2.0), &Scalar::Float(1e-7)));
    assert_eq!((around.before.len(), around.after.len(), &around.after[1].value), (1, 2, &Scalar::Int(3)));
    let polls = reader.polls(&device(), "Altitude", (at(1), at(2))).unwrap();
    let times: Vec<Utc> = polls.iter().map(|(at, _)| *at).collect();
    assert_eq!(times, [at(0), at(1), at(2), at(3)], "with the one before and the one behind");
    let polls = reader.polls(&device(), "Altitude", (at(6), at(6))).unwrap();
    assert!(matches!(polls[..], [(_, Some(_)), (_, None)]), "it was received, with no value: {polls:?}");
    let around = reader.around(&device(), "Altitude", at(6)).unwrap();
    assert!(around.after.is_empty() && around.received_since, "it was received, with no value");
    assert!(!reader.around(&device(), "Altitude", at(7)).unwrap().received_since);
    let shared = device().address.shared().device(Kind::Telescope, &device().name);
    assert!(reader.around(&shared, "Altitude", at(1)).unwrap().before.is_empty(), "another telescope's");
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_is_the_newest_rows_that_fit_oldest_first() {
    let folder = tempfile::tempdir().unwrap();
    let (database, _writer) = open(folder.path());
    let boot_id = BootId::fresh();
    for second in 0..20 {
        database.put(reading(second, Ok(Scalar::Int(second)))).await.unwrap();
    }
    let line = |message: &str, seq| Write::Log {
        telescope: "callisto".to_owned(),
        node: "device/main".to_owned(),
        target: "x".to_owned(),
        level: Level::Warn,
        message: message.to_owned(),
        at: at(5),
        origin: (boot_id.clone(), seq),
    };
    database.commit(vec![line("it's O'Brien", 1), line("it's O'Brien", 1), line("again", 2)]).await.unwrap();
    let reader = Reader::open(database.path(), "callisto").unwrap();
    let seconds = |question: ArchiveQuestion| {
        let answer = reader.answer(&question, at(0)).unwrap();
        let seconds = answer.rows.iter().map(|row| match row {
            ArchiveRow::Reading { at_utc, .. } => at_utc.seconds_since(at(0)) as i64,
            other => panic!("{other:?}"),
        });
        (seconds.collect::<Vec<_>>(), answer.truncated)
    };
    assert_eq!(seconds(ask(altitude(), Some(5), Some(8), None)), (vec![5, 6, 7], false));
    assert_eq!(seconds(ask(altitude(), None, None, Some(3))), (vec![17, 18, 19], true));
    assert!(!seconds(ask(altitude(), None, None, Some(20))).1);
    assert_eq!(seconds(ask(altitude(), Some(100), None, None)), (vec![], false));
    let log = reader.answer(&ask(Ask::Log, None, None, None), at(0)).unwrap().rows;
    assert_eq!(log.len(), 2);
    assert!(
        matches!(&log[0], ArchiveRow::Log { level: Level::Warn, message, node, .. } if message == "it's O'Brien" && node == "device/main")
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn an_image_is_stored_once_and_completed_once() {
    let folder = tempfile::tempdir().unwrap();
    let (database, _writer) = open(folder.path());
    let named = Write::Writing { frame: CommandId("b".to_owned()), file: "b.fits".to_owned() };
    let image_a = image("a", "Barnard's '); DROP TABLE images; --");
    database.commit(vec![named, stored(image_a.clone()), stored(image_a.clone())]).await.unwrap();
    let reader = Reader::open(database.path(), "callisto").unwrap();
    assert_eq!(reader.writing(&CommandId("b".to_owned())).unwrap().as_deref(), Some("b.fits"));
    database.commit(vec![stored(image("b", "B"))]).await.unwrap();
    assert_eq!(reader.writing(&CommandId("b".to_owned())).unwrap(), None);
    let incomplete = reader.incomplete(10).unwrap();
    assert_eq!(incomplete.len(), 2);
    let found = reader.image(&image_a.frame.id).unwrap().unwrap();
    assert_eq!(found.frame.purpose, image_a.frame.purpose);
    assert_eq!(found.frame.url, "", "the token is nobody's business");
    assert_eq!((found.file, found.bytes, found.stored), (image_a.file, 5760, at(2)));
    // A row that was made from the file alone gets the fields of the announcement.
    let mut announced = image_a.frame.clone();
    announced.purpose.metadata.insert("visit".to_owned(), "7".into());
    database.commit(vec![Write::Announced(Box::new(announced.clone()))]).await.unwrap();
    let found = reader.image(&image_a.frame.id).unwrap().unwrap();
    assert_eq!((found.frame.purpose, found.frame.url.as_str(), found.bytes), (announced.purpose, "", 5760));
    database.commit(vec![Write::Complete(image_a.frame.id.clone())]).await.unwrap();
    assert_eq!(reader.incomplete(10).unwrap().len(), 1);
    assert_eq!(reader.image_counts().unwrap(), (2, 1));
    let frames = reader.answer(&ask(Ask::Frames, None, None, None), at(0)).unwrap().rows;
    let complete = frames.iter().filter(|row| matches!(row, ArchiveRow::Frame { header_complete: true, .. })).count();
    assert_eq!((frames.len(), complete), (2, 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_locked_database_is_alerted_and_loses_no_row() {
    let folder = tempfile::tempdir().unwrap();
    let alerts = NodeAlerts::new(Clock::machine_clock());
    let path = folder.path().join("archive.db");
    let (database, writer) = Database::open(&path, "callisto", alerts.clone()).unwrap();
    let other = Connection::open(&path).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    for second in 0..500 {
        database.put(reading(second, Ok(Scalar::Int(second)))).await.unwrap();
    }
    let mut displayed = alerts.watch();
    let raised =
        displayed.wait_for(|alerts| alerts.alerts.iter().any(|alert| alert.id == AlertKind::ArchiveDatabase.id("")));
    tokio::time::timeout(Duration::from_secs(120), raised).await.unwrap().unwrap();
    other.execute_batch("ROLLBACK").unwrap();
    database.commit(vec![reading(500, Ok(Scalar::Int(500)))]).await.unwrap();
    assert_eq!(database.rows(), 501);
    assert!(alerts.watch().borrow().alerts.is_empty());
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn facts_are_stored_once_and_what_was_measured_never_gives_way_to_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    let boot_id = BootId::fresh();
    let facts_of = |stars: Option<u32>, reason: Option<&str>, second: i64, seq: u64| {
        let facts = FrameFacts {
            frame: CommandId("frame-1".to_owned()),
            stars,
            fwhm_px: stars.map(|_| 2.5),
            reason: reason.map(str::to_owned),
            ..FrameFacts::default()
        };
        StoredFacts { facts, at: at(second), origin: (boot_id.clone(), seq) }
    };
    let reader = Reader::open(&path, "callisto").unwrap();
    let frame = CommandId("frame-1".to_owned());
    let put = async |stored: &StoredFacts| {
        database.commit(vec![Write::Facts(Box::new(stored.clone()))]).await.unwrap();
        reader.facts(&frame).unwrap().unwrap()
    };
    let missed = facts_of(None, Some("not fetched"), 1, 0);
    assert_eq!(put(&missed).await, missed);
    let measured = facts_of(Some(7), None, 2, 1);
    assert_eq!(put(&measured).await, measured);
    assert_eq!(put(&facts_of(None, Some("not fetched: HTTP 404"), 3, 2)).await, measured);
    assert_eq!(put(&facts_of(Some(9), None, 1, 0)).await, measured, "older facts, recovered late");
    let better = facts_of(Some(8), None, 4, 3);
    assert_eq!(put(&better).await, better);

    assert_eq!(reader.late_facts(10).unwrap(), [], "there is no image of it");
    let mut image = image("frame-1", "x");
    image.frame.url.clear();
    database.commit(vec![stored(image.clone())]).await.unwrap();
    assert_eq!(reader.late_facts(10).unwrap(), [], "its header is not complete yet and takes them then");
    database.commit(vec![Write::Complete(frame.clone())]).await.unwrap();
    assert_eq!(reader.late_facts(10).unwrap(), [(image, better.clone())]);
    let older = Write::FactsTaken { frame: frame.clone(), origin: measured.origin, in_header: true };
    database.commit(vec![older]).await.unwrap();
    assert_eq!(reader.late_facts(10).unwrap().len(), 1, "others stand in the header");
    let taken = Write::FactsTaken { frame, origin: better.origin, in_header: true };
    database.commit(vec![taken]).await.unwrap();
    assert_eq!(reader.late_facts(10).unwrap(), []);
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_correction_of_the_guiding_is_a_row_and_counts_once() {
    let samples: Vec<contract::observatory::Correction> =
        serde_json::from_str(include_str!("../../../common/contract/golden/v1/observatory.correction.json")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    let boot_id = BootId::fresh();
    for (seq, correction) in samples.iter().chain(&samples).enumerate() {
        let (correction, telescope) = (correction.clone(), "callisto".to_owned());
        let stored = StoredCorrection { correction, telescope, origin: (boot_id.clone(), seq as u64) };
        database.commit(vec![Write::Correction(Box::new(stored))]).await.unwrap();
    }
    drop(database);
    writer.end().await;
    // Opened again: the table exists already.
    let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    let connection = rusqlite::Connection::open(&path).unwrap();
    let mut asked = connection
        .prepare(
            "SELECT datetime, stage, shift_x, north_why, east_given_ms, reason IS NULL FROM guiding ORDER BY datetime",
        )
        .unwrap();
    type Row = (String, String, Option<f64>, String, i64, bool);
    let read = |row: &rusqlite::Row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?, row.get(4)?, row.get(5)?));
    let rows: Vec<Row> = asked.query_map([], read).unwrap().map(Result::unwrap).collect();
    let text = str::to_owned;
    let expected: [Row; 2] = [
        (text("2026-11-21 03:12:59.000000"), text("guide"), Some(0.21), text("reversal_resisted"), -61, true),
        (text("2026-11-21 03:13:29.000000"), text("lost"), None, text("not_measured"), 0, false),
    ];
    assert_eq!(rows, expected);
    let reader = Reader::open(&path, "callisto").unwrap();
    let corrections = |limit| {
        let answer = reader.answer(&ask(Ask::Corrections, None, None, limit), at(0)).unwrap();
        let corrections = answer.rows.into_iter().map(|row| match row {
            ArchiveRow::Correction(correction) => *correction,
            other => panic!("{other:?}"),
        });
        (corrections.collect::<Vec<_>>(), answer.truncated)
    };
    assert_eq!(corrections(None), (samples.clone(), false), "as they were published, the oldest first");
    assert_eq!(corrections(Some(1)), (samples[1..].to_vec(), true), "the newest");
    let other = Reader::open(&path, "io").unwrap();
    assert!(
        other.answer(&ask(Ask::Corrections, None, None, None), at(0)).unwrap().rows.is_empty(),
        "of another telescope"
    );
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_database_is_put_aside_and_a_new_one_takes_rows() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep/archive.db");
    let (database, writer) = open(folder.path());
    let objects = (0..400).map(|number| image(&format!("f{number}"), &"x".repeat(200)));
    database.commit(objects.map(stored).collect()).await.unwrap();
    drop(database);
    writer.end().await;
    let whole = std::fs::read(&path).unwrap();
    assert!(whole.len() > 8 * 4096);
    let mut holes = whole.clone();
    holes[4096..].fill(0);
    let damaged = [
        ("no database", b"half a page of something else".to_vec()),
        ("cut off", whole[..whole.len() / 2].to_vec()),
        ("cut within its first page", whole[..1000].to_vec()),
        ("filled with zeros from its second page on", holes),
    ];
    for (number, (what, bytes)) in damaged.into_iter().enumerate() {
        std::fs::write(&path, &bytes).unwrap();
        let alerts = NodeAlerts::new(Clock::machine_clock());
        let (database, writer) = Database::open(&path, "callisto", alerts.clone()).unwrap();
        let written = database.commit(vec![stored(image("new", "M31"))]);
        tokio::time::timeout(Duration::from_secs(120), written).await.unwrap_or_else(|_| panic!("{what}")).unwrap();
        assert!(
            Reader::open(&path, "callisto").unwrap().image(&CommandId("new".to_owned())).unwrap().is_some(),
            "{what}"
        );
        let aside = path.with_file_name(format!("archive.db.bad-{}", number + 1));
        assert_eq!(std::fs::read(aside).unwrap(), bytes, "{what}");
        drop(database);
        writer.end().await;
    }
    // SQLite handles half of a write-ahead log by itself.
    std::fs::write(path.with_file_name("archive.db-wal"), &whole[..5000]).unwrap();
    let (database, writer) = open(folder.path());
    database.commit(vec![stored(image("newer", "M31"))]).await.unwrap();
    assert!(Reader::open(&path, "callisto").unwrap().image(&CommandId("new".to_owned())).unwrap().is_some());
    drop(database);
    writer.end().await;
}

#[tokio::test]
async fn verdicts_are_rows_with_their_times_and_reasons() {
    let folder = tempfile::tempdir().unwrap();
    let connection = migrations::open(&folder.path().join("archive.db")).unwrap();
    let put = |part: &str, second: i64, state: &str| {
        let (began, last) = (stamp(at(second)), stamp(at(second + 60)));
        let row = rusqlite::params![part, began, last, state, state, "boot", second, "alpha"];
        connection.execute("INSERT INTO states VALUES (?,?,?,?,?,?,?,?)", row).unwrap();
    };
    put("night", 0, r#"{"doing":"waits"}"#);
    let rain = r#"{"input":"wx/RainRate","why":"3 is above 0"}"#;
    let monitor = r#"{"input":"safetymonitor/m","why":"says that it is not safe"}"#;
    put("safety", 0, &format!(r#"{{"verdict":"unsafe","reasons":[{rain},{monitor}],"suspended":[]}}"#));
    put("safety", 100, r#"{"verdict":"safe","reasons":[],"suspended":[]}"#);
    let mut statement = connection
        .prepare("SELECT began_utc, last_utc, verdict, input, why FROM verdicts ORDER BY began_utc, input")
        .unwrap();
    let rows = statement.query_map([], |row| {
        let text = |index| row.get::<_, Option<String>>(index);
        Ok([text(0)?, text(1)?, text(2)?, text(3)?, text(4)?].map(Option::unwrap_or_default))
    });
    let rows = rows.unwrap().collect::<rusqlite::Result<Vec<_>>>().unwrap();
    let [began, last, safe] = [0, 60, 100].map(|second| format!("{}Z", stamp(at(second)).replace(' ', "T")));
    let unsafe_of = |input: &str, why: &str| [began.as_str(), last.as_str(), "unsafe", input, why].map(str::to_owned);
    assert_eq!(rows[0], unsafe_of("safetymonitor/m", "says that it is not safe"));
    assert_eq!(rows[1], unsafe_of("wx/RainRate", "3 is above 0"));
    assert_eq!((rows.len(), &rows[2][0], &rows[2][2], &rows[2][3]), (3, &safe, &"safe".to_owned(), &String::new()));
}

#[tokio::test(flavor = "multi_thread")]
async fn the_alerts_of_a_time_are_those_that_stood_in_it_with_what_became_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = open(folder.path());
    let boot = BootId::fresh();
    let alert = |name: &str, raised: i64| AlertKind::DomeHeld.alert(name, at(raised), "nobody renewed it");
    let seen_to = Alert { acknowledged_by: Some("web/ana".to_owned()), ..alert("a", 25) };
    for (second, alerts) in [
        (10_i64, vec![alert("a", 5)]),
        (20, Vec::new()),
        (30, vec![seen_to.clone(), alert("b", 28)]),
        (40, vec![seen_to.clone()]),
    ] {
        let stored = StoredAlerts { alerts, at: at(second), origin: (boot.clone(), second.unsigned_abs()) };
        database.commit(vec![Write::Alerts(Box::new(stored))]).await.unwrap();
    }
    let asked = |telescope: &str, from, to, limit| {
        let reader = Reader::open(database.path(), telescope).unwrap();
        let answer = reader.answer(&ask(Ask::Alerts, from, to, limit), at(50)).unwrap();
        let alerts = answer.rows.into_iter().map(|row| match row {
            ArchiveRow::Alert(alert) => alert,
            other => panic!("{other:?}"),
        });
        (alerts.collect::<Vec<_>>(), answer.truncated)
    };
    let past = |alert: &Alert, cleared: Option<i64>| PastAlert {
        id: alert.id.clone(),
        priority: alert.priority,
        raised_utc: alert.raised_utc,
        cleared_utc: cleared.map(at),
        cause: alert.cause.clone(),
        acknowledged_by: alert.acknowledged_by.clone(),
    };
    let (first, again, other) = (past(&alert("a", 5), Some(20)), past(&seen_to, None), past(&alert("b", 28), Some(40)));
    assert_eq!(asked("callisto", None, None, None), (vec![first, again.clone(), other.clone()], false));
    assert_eq!(asked("callisto", Some(21), Some(28), None), (vec![again], false), "one is over, one is not raised yet");
    assert_eq!(asked("callisto", None, None, Some(1)), (vec![other], true), "the newest");
    assert_eq!(asked("io", None, None, None), (Vec::new(), false), "of another telescope");
    drop(database);
    writer.end().await;
}
