//! Questions that are too large end in time, and say so; nobody waits for them.

use std::path::Path;
use std::time::{Duration, Instant};

use contract::archive::{ArchiveAnswer, ArchiveQuestion, Ask, SeriesName};
use contract::frame_search::FrameSearch;
use contract::{CommandId, Kind};
use rusqlite::{Connection, params};

use super::*;

const FRAMES: i64 = 40_000;

/// Adds nights of a frame each five minutes, a tenth of them bias, dark and flat frames.
fn fill(path: &Path, frame: &str) {
    let connection = Connection::open(path).unwrap();
    let sql = "WITH RECURSIVE numbers (n) AS (SELECT 0 UNION ALL SELECT n + 1 FROM numbers WHERE n + 1 < ?2),
        made AS (SELECT n, strftime('%Y-%m-%d %H:%M:%S', 1700000000 + 300 * n, 'unixepoch') || '.000000' AS at FROM numbers)
        INSERT INTO images SELECT n || '.fits', 'andor', 1, at, 'many-' || n, n || '.fits', '', 1, at,
            json_set(?1, '$.id', 'many-' || n, '$.started_utc', replace(at, ' ', 'T') || 'Z', '$.purpose.night',
                strftime('%Y%m%d', at), '$.exposure_s', n % 7, '$.purpose.image_type',
                CASE n % 30 WHEN 0 THEN 'Bias Frame' WHEN 1 THEN 'Dark Frame' WHEN 2 THEN 'Flat Frame' ELSE 'Light Frame' END),
            'callisto' FROM made";
    connection.execute(sql, params![frame, FRAMES]).unwrap();
}

fn everything() -> Ask {
    Ask::FindFrames(Box::new(FrameSearch { with_calibration: true, ..FrameSearch::default() }))
}

fn answer(path: &Path, ask: Ask, within: Duration) -> (ArchiveAnswer, Duration) {
    let question = ArchiveQuestion { ask, from_utc: None, to_utc: None, limit: Some(u32::MAX) };
    let began = Instant::now();
    let reader = Reader::open(path, "callisto").unwrap().until(began + within).unwrap();
    (reader.answer(&question, at(0.0)).unwrap(), began.elapsed())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_question_about_everything_ends_in_time_with_what_was_found_and_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = archive(folder.path()).await;
    fill(database.path(), &serde_json::to_string(&frame("x", ("20261121", 0.0), light("x", "r"), 30.0)).unwrap());
    let within = Duration::from_millis(200);
    let (cut, took) = answer(database.path(), everything(), within);
    assert!(
        cut.truncated && cut.cut.as_ref().is_some_and(|why| why.contains("ask for a shorter time")),
        "{:?}",
        cut.cut
    );
    assert!(!cut.rows.is_empty() && cut.rows.len() < 40_000, "{} rows", cut.rows.len());
    assert!(took < within + Duration::from_secs(5), "{took:?}");
    // No row is found, and SQLite has to look at all of them.
    let nothing = FrameSearch { stars_min: Some(u32::MAX), ..FrameSearch::default() };
    let wind = SeriesName { kind: Kind::ObservingConditions, device: "wx".to_owned(), property: "WindGust".to_owned() };
    for ask in [
        Ask::FindFrames(Box::new(nothing)),
        Ask::Frames,
        Ask::Log,
        Ask::Audit,
        Ask::Corrections,
        Ask::Series { properties: vec![wind], points: 10 },
    ] {
        let (cut, _) = answer(database.path(), ask.clone(), Duration::ZERO);
        let is_small = matches!(ask, Ask::Log | Ask::Audit | Ask::Corrections | Ask::Series { .. });
        assert!(cut.cut.is_some() && cut.rows.is_empty() || is_small, "{ask:?}: {cut:?}");
    }
    // With time enough nothing is cut.
    let (whole, _) = answer(database.path(), Ask::Frames, Duration::from_secs(600));
    assert_eq!((whole.rows.len(), whole.cut), (40_013, None));
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_are_stored_while_the_largest_questions_are_looked_up() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = archive(folder.path()).await;
    fill(database.path(), &serde_json::to_string(&frame("x", ("20261121", 0.0), light("x", "r"), 30.0)).unwrap());
    let questions: Vec<_> = (0..4)
        .map(|_| {
            let path = database.path().to_owned();
            std::thread::spawn(move || {
                let until = Instant::now() + Duration::from_secs(8);
                // Again and again, as by a page that is reloaded.
                while Instant::now() < until {
                    let (cut, _) = answer(&path, everything(), until.saturating_duration_since(Instant::now()));
                    assert!(cut.cut.is_some() || !cut.rows.is_empty());
                }
            })
        })
        .collect();
    for number in 0..20 {
        let frame = frame(&format!("new-{number}"), ("20261123", 2.0 * DAY_S), light("x", "r"), 30.0);
        let (path, file) = (format!("/images/new-{number}.fits").into(), format!("new-{number}.fits"));
        let stored = frame.started_utc;
        let image = StoredImage { frame, path, file, bytes: 5760, stored };
        database.commit(vec![Write::Stored(Box::new(image))]).await.unwrap();
    }
    assert!(questions.iter().all(|question| !question.is_finished()), "no frame waited for a question");
    let reader = Reader::open(database.path(), "callisto").unwrap();
    assert!(reader.image(&CommandId("new-19".to_owned())).unwrap().is_some());
    for question in questions {
        question.join().unwrap();
    }
    drop(database);
    writer.end().await;
}
