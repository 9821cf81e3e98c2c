//! Questions that are too large end in time, and say so; nobody waits for them.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use contract::archive::{ArchiveAnswer, ArchiveQuestion, Ask, SeriesName};
use contract::frame_search::FrameSearch;
use contract::{CommandId, Kind};
use rusqlite::{Connection, params};

use super::*;

const FRAMES: i64 = 40_000;
/// What takes longer hangs, also on a busy machine.
const LIMIT: Duration = Duration::from_secs(120);

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

fn answer(path: &Path, ask: Ask, is_over: impl Fn() -> bool + Send + Sync + 'static) -> ArchiveAnswer {
    let question = ArchiveQuestion { ask, from_utc: None, to_utc: None, limit: Some(u32::MAX) };
    let reader = Reader::open(path, "callisto").unwrap().while_not(is_over).unwrap();
    reader.answer(&question, at(0.0)).unwrap()
}

/// Time for so many looks at the clock.
fn after_looks(looks: usize) -> impl Fn() -> bool + Send + Sync + 'static {
    let looked = AtomicUsize::new(0);
    move || looked.fetch_add(1, Ordering::Relaxed) >= looks
}

fn is_cut_with_its_reason(cut: &ArchiveAnswer) {
    let is_reason = cut.cut.as_ref().is_some_and(|why| why.contains("ask for a shorter time"));
    assert!(cut.truncated && is_reason, "{:?}", cut.cut);
    assert!(!cut.rows.is_empty() && cut.rows.len() < 40_000, "{} rows", cut.rows.len());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_question_about_everything_ends_with_what_was_found_and_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = archive(folder.path()).await;
    fill(database.path(), &serde_json::to_string(&frame("x", ("20261121", 0.0), light("x", "r"), 30.0)).unwrap());
    is_cut_with_its_reason(&answer(database.path(), everything(), after_looks(2000)));
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
        let cut = answer(database.path(), ask.clone(), || true);
        let is_small = matches!(ask, Ask::Log | Ask::Audit | Ask::Corrections | Ask::Series { .. });
        assert!(cut.cut.is_some() && cut.rows.is_empty() || is_small, "{ask:?}: {cut:?}");
    }
    // With time enough nothing is cut.
    let whole = answer(database.path(), Ask::Frames, || false);
    assert_eq!((whole.rows.len(), whole.cut), (40_013, None));
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_are_stored_while_the_largest_questions_are_looked_up() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = archive(folder.path()).await;
    fill(database.path(), &serde_json::to_string(&frame("x", ("20261121", 0.0), light("x", "r"), 30.0)).unwrap());
    let stop = Arc::new(AtomicBool::new(false));
    let questions: Vec<_> = (0..4)
        .map(|_| {
            let (path, stop) = (database.path().to_owned(), stop.clone());
            std::thread::spawn(move || {
                // Again and again, as by a page that is reloaded.
                while !stop.load(Ordering::Relaxed) {
                    let is_over = stop.clone();
                    let cut = answer(&path, everything(), move || is_over.load(Ordering::Relaxed));
                    assert!(cut.cut.is_some() || !cut.rows.is_empty());
                }
            })
        })
        .collect();
    for number in 0..20 {
        let frame = frame(&format!("new-{number}"), ("20261123", 2.0 * DAY_S), light("x", "r"), 30.0);
        let (file, stored) = (format!("new-{number}.fits"), frame.started_utc);
        let image = StoredImage { frame, file, bytes: 5760, stored };
        let committed = database.commit(vec![Write::Stored(Box::new(image), Default::default())]);
        tokio::time::timeout(LIMIT, committed).await.expect("a frame waited for a question").unwrap();
    }
    // They end after this, and no frame waited for that.
    assert!(questions.iter().all(|question| !question.is_finished()));
    stop.store(true, Ordering::Relaxed);
    let reader = Reader::open(database.path(), "callisto").unwrap();
    assert!(reader.image(&CommandId("new-19".to_owned())).unwrap().is_some());
    for question in questions {
        question.join().unwrap();
    }
    drop(database);
    writer.end().await;
}

mod proof {
    use super::*;

    /// A bound in seconds on a real clock; how much is found until then depends on the machine.
    #[tokio::test(flavor = "multi_thread")]
    async fn a_question_about_everything_ends_in_time() {
        let folder = tempfile::tempdir().unwrap();
        let (database, writer) = archive(folder.path()).await;
        fill(database.path(), &serde_json::to_string(&frame("x", ("20261121", 0.0), light("x", "r"), 30.0)).unwrap());
        let (began, within) = (Instant::now(), Duration::from_millis(200));
        let cut = answer(database.path(), everything(), move || began.elapsed() >= within);
        let took = began.elapsed();
        is_cut_with_its_reason(&cut);
        assert!(took < within + Duration::from_secs(5), "{took:?}");
        drop(database);
        writer.end().await;
    }
}
