//! Databases of older and newer versions: what is kept, what is added, and what is refused.

use contract::observatory::{Unsolved, UnsolvedClass};

use super::*;

#[tokio::test(flavor = "multi_thread")]
async fn a_database_of_a_newer_starmesh_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    drop(migrations::open(&path).unwrap());
    drop(migrations::open(&path).unwrap());
    Connection::open(&path).unwrap().pragma_update(None, "user_version", migrations::VERSION + 1).unwrap();
    assert!(
        matches!(migrations::open(&path), Err(DatabaseError::Newer { found, .. }) if found == migrations::VERSION + 1)
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_of_version_1_gets_the_table_of_the_audit_and_keeps_its_rows() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let old = Connection::open(&path).unwrap();
    old.execute_batch(rows::SCHEMA).unwrap();
    old.execute("INSERT INTO writing VALUES ('frame-1', 'n/a.fits')", []).unwrap();
    old.pragma_update(None, "user_version", 1).unwrap();
    drop(old);
    let record = StoredRecord {
        node: "device/alpha/main".to_owned(),
        chain: "c".to_owned(),
        number: 0,
        at: Some(at(1)),
        from: "guard".to_owned(),
        device: "dome/roof".to_owned(),
        verb: "close_shutter".to_owned(),
        token: None,
        outcome: "done".to_owned(),
        line: "{}".to_owned(),
        sha256: "aa".to_owned(),
        fault: None,
    };
    for _ in 0..2 {
        let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
        let rival = StoredRecord { sha256: "bb".to_owned(), ..record.clone() };
        let writes = [record.clone(), record.clone(), rival].map(|one| Write::Audit(Box::new(one)));
        database.commit(writes.to_vec()).await.unwrap();
        drop(database);
        writer.end().await;
    }
    let reader = Reader::open(&path, "callisto").unwrap();
    assert_eq!(reader.audit_lines().unwrap().len(), 2, "each once, and two that claim one place both");
    assert_eq!(reader.audit_end("device/alpha/main").unwrap().unwrap().sha256, "bb");
    assert_eq!(reader.audit_end("device/beta/main").unwrap(), None);
    assert_eq!(reader.writing(&CommandId("frame-1".to_owned())).unwrap().as_deref(), Some("n/a.fits"));
}

#[tokio::test(flavor = "multi_thread")]
async fn rows_of_version_9_belong_to_the_only_telescope_that_the_database_knows_and_else_to_each_that_asks() {
    for (telescopes, owner) in [(vec!["callisto", "shared"], "callisto"), (vec!["callisto", "io"], ""), (vec![], "")] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("archive.db");
        let old = Connection::open(&path).unwrap();
        old.execute_batch(&migrations::STEPS[..9].concat()).unwrap();
        for telescope in telescopes {
            let sql =
                "INSERT INTO series (telescope, device_type, device_name, device_command) VALUES (?, 'Dome', 'd', 'x')";
            old.execute(sql, [telescope]).unwrap();
        }
        let (json, now) = (serde_json::to_string(&image("old", "x").frame).unwrap(), stamp::stamp(at(1)));
        let put = "INSERT INTO images VALUES ('/old.fits', 'andor', 0, ?1, 'old', 'old.fits', '', 1, ?1, ?2)";
        old.execute(put, [&now, &json]).unwrap();
        old.execute("INSERT INTO states VALUES ('night', ?1, ?1, '', '{}', 'b', 0)", [&now]).unwrap();
        old.execute("INSERT INTO alerts VALUES ('a', ?1, 'high', 'c', NULL, NULL, ?1, 'b', 0)", [&now]).unwrap();
        old.pragma_update(None, "user_version", 9).unwrap();
        drop(old);
        let opened = migrations::open(&path).unwrap();
        for table in ["images", "states", "alerts"] {
            let sql = format!("SELECT telescope FROM {table}");
            assert_eq!(opened.query_row(&sql, [], |row| row.get::<_, String>(0)).unwrap(), owner, "{table}");
        }
        let count = |telescope: &str| Reader::open(&path, telescope).unwrap().newest_images(10).unwrap().len();
        assert_eq!((count("callisto"), count("io")), (1, usize::from(owner.is_empty())));
    }
}

#[test]
fn the_views_of_another_starmesh_are_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let views = "DROP VIEW frames; CREATE VIEW frames AS SELECT 1 AS fewer_columns";
    migrations::open(&path).unwrap().execute_batch(views).unwrap();
    migrations::open(&path).unwrap().prepare("SELECT target_saturated FROM frames").unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_of_version_3_keeps_its_facts_and_takes_solutions() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let old = Connection::open(&path).unwrap();
    for made in [rows::SCHEMA, rows::AUDIT, rows::FACTS] {
        old.execute_batch(made).unwrap();
    }
    let known = FrameFacts { frame: CommandId("old".to_owned()), stars: Some(7), ..FrameFacts::default() };
    old.execute(
        "INSERT INTO facts (frame_id, stars, facts, datetime, boot_id, seq, in_header) VALUES ('old', 7, ?1, ?2, ?3, 0, 1)",
        rusqlite::params![serde_json::to_string(&known).unwrap(), stamp::stamp(at(1)), BootId::fresh().as_str()],
    )
    .unwrap();
    old.pragma_update(None, "user_version", 3).unwrap();
    drop(old);
    let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    let unsolved = Unsolved { class: UnsolvedClass::TooFewStars, detail: "2 stars".to_owned() };
    let frame = |id: &str| FrameFacts { frame: CommandId(id.to_owned()), ..FrameFacts::default() };
    let solved = FrameFacts { ra_deg: Some(83.5), dec_deg: Some(-5.25), matched: Some(40), ..frame("solved") };
    for facts in [solved, FrameFacts { unsolved: Some(unsolved), ..frame("unsolved") }] {
        let stored = StoredFacts { facts, at: at(2), origin: (BootId::fresh(), 0) };
        database.commit(vec![Write::Facts(Box::new(stored))]).await.unwrap();
    }
    drop(database);
    writer.end().await;
    assert_eq!(Reader::open(&path, "callisto").unwrap().facts(&known.frame).unwrap().unwrap().facts, known);
    let rows = Connection::open(&path).unwrap();
    let row = |id: &str| {
        let sql = "SELECT stars, ra_deg, dec_deg, matched, unsolved, in_header FROM facts WHERE frame_id = ?1";
        type Row = (Option<u32>, Option<f64>, Option<f64>, Option<u32>, Option<String>, u32);
        rows.query_row(sql, [id], |row| -> rusqlite::Result<Row> {
            Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?, row.get(4)?, row.get(5)?))
        })
        .unwrap()
    };
    assert_eq!(row("old"), (Some(7), None, None, None, None, 1));
    assert_eq!(row("solved"), (None, Some(83.5), Some(-5.25), Some(40), None, 0));
    assert_eq!(row("unsolved"), (None, None, None, None, Some("too_few_stars".to_owned()), 0));
}
