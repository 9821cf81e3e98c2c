//! How long questions about frames take in a database of a million, and how long a frame waits for its row meanwhile:
//! `cargo bench -p node-archive --bench search`. Needs some 2 GB in the system's folder for temporary files.

#![allow(clippy::unwrap_used, reason = "a benchmark ends by panicking")]

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use bus::Clock;
use contract::CommandId;
use contract::archive::{ArchiveQuestion, Ask};
use contract::device::camera::Frame;
use contract::frame_search::{FrameSearch, SkyPlace};
use node::NodeAlerts;
use node_archive::database::{Database, StoredImage, Write};
use node_archive::reader::Reader;
use rusqlite::{Connection, params};
use units::Utc;

const FRAMES: i64 = 1_000_000;
/// The archive node's own limit.
const BUDGET: Duration = Duration::from_secs(5);
const AT_ONCE: usize = 4;

fn golden() -> Frame {
    let text = include_str!("../../common/contract/golden/v1/camera.frame.json");
    let samples: serde_json::Value = serde_json::from_str(text).unwrap();
    serde_json::from_value(samples.get(0).unwrap_or(&samples).clone()).unwrap()
}

/// A frame each minute for two years, one in twenty for calibration, of a hundred targets.
fn fill(path: &Path) {
    let connection = Connection::open(path).unwrap();
    connection.execute_batch("PRAGMA synchronous = OFF").unwrap();
    let numbers = "WITH RECURSIVE numbers (n) AS (SELECT 0 UNION ALL SELECT n + 1 FROM numbers WHERE n + 1 < ?1)";
    let images = format!(
        "{numbers}, made AS (SELECT n, strftime('%Y-%m-%d %H:%M:%S', 1700000000 + 60 * n, 'unixepoch') || '.000000' AS at FROM numbers)
         INSERT INTO images SELECT '/images/' || n || '.fits', 'andor', 1, at, 'many-' || n, n || '.fits', '', 1, at,
            json_set(?2, '$.id', 'many-' || n, '$.started_utc', replace(at, ' ', 'T') || 'Z', '$.exposure_s', n % 7,
                '$.purpose.night', strftime('%Y%m%d', at), '$.purpose.object', 'target ' || (n / 500 % 100),
                '$.purpose.image_type', CASE n % 60 WHEN 0 THEN 'Bias Frame' WHEN 1 THEN 'Dark Frame' WHEN 2 THEN 'Flat Frame'
                    ELSE 'Light Frame' END), 'callisto' FROM made"
    );
    connection.execute(&images, params![FRAMES, serde_json::to_string(&golden()).unwrap()]).unwrap();
    let facts = format!(
        "{numbers} INSERT INTO facts (frame_id, stars, fwhm_px, scale_arcsec_px, ra_deg, dec_deg, facts, datetime, boot_id, seq,
            in_header, telescope) SELECT 'many-' || n, n % 500, 2.0 + n % 30 / 10.0, 0.6, n % 360, n % 180 - 90,
            json_object('frame', 'many-' || n, 'stars', n % 500), '2026-11-21 00:00:00.000000', 'b', n, 1, 'callisto' FROM numbers"
    );
    connection.execute(&facts, params![FRAMES]).unwrap();
}

fn ask(path: &Path, search: FrameSearch, limit: u32) -> (usize, bool, f64) {
    let question =
        ArchiveQuestion { ask: Ask::FindFrames(Box::new(search)), from_utc: None, to_utc: None, limit: Some(limit) };
    let began = Instant::now();
    let reader = Reader::open(path, "callisto").unwrap().until(began + BUDGET).unwrap();
    let answer = reader.answer(&question, Utc::EPOCH).unwrap();
    (answer.rows.len(), answer.cut.is_some(), began.elapsed().as_secs_f64())
}

/// The slowest and the middle of a hundred commits of a frame.
async fn store(database: &Database, from: usize) -> (f64, f64) {
    let mut took_ms = Vec::new();
    for number in from..from + 100 {
        let frame = Frame { id: CommandId(format!("new-{number}")), ..golden() };
        let (file, stored) = (format!("new-{number}.fits"), frame.started_utc);
        let began = Instant::now();
        let image = StoredImage { frame, file, bytes: 5760, stored };
        database.commit(vec![Write::Stored(Box::new(image), Default::default())]).await.unwrap();
        took_ms.push(began.elapsed().as_secs_f64() * 1e3);
    }
    took_ms.sort_by(f64::total_cmp);
    (took_ms[99], took_ms[50])
}

#[tokio::main]
async fn main() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    let began = Instant::now();
    fill(&path);
    println!(
        "{FRAMES} frames: {:.0} MB, made in {:.0} s",
        std::fs::metadata(&path).unwrap().len() as f64 / 1e6,
        began.elapsed().as_secs_f64()
    );
    let text = |text: &str| Some(text.to_owned());
    let none = FrameSearch::default;
    for (what, search, limit) in [
        ("the newest 1000", none(), 1000),
        (
            "a target, with calibration",
            FrameSearch { object: text("target 7"), with_calibration: true, ..none() },
            1000,
        ),
        ("a night, with calibration", FrameSearch { night: text("20240601"), with_calibration: true, ..none() }, 2000),
        ("a camera that is not there", FrameSearch { camera: text("other"), ..none() }, 1000),
        ("a filter that is not there", FrameSearch { filter: text("other"), ..none() }, 1000),
        ("a width that none has", FrameSearch { fwhm_max_arcsec: Some(0.1), ..none() }, 1000),
        (
            "a place that none shows",
            FrameSearch { covers: Some(SkyPlace { ra_deg: 1.0, dec_deg: 1.5 }), ..none() },
            1000,
        ),
        ("everything, with calibration", FrameSearch { with_calibration: true, ..none() }, u32::MAX),
    ] {
        let (rows, is_cut, took_s) = ask(&path, search, limit);
        println!("{what:30} {rows:>7} rows in {took_s:6.3} s{}", if is_cut { ", cut" } else { "" });
    }
    let (slowest, middle) = store(&database, 0).await;
    println!("a frame waits {middle:.1} ms for its row, at most {slowest:.1} ms");
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                while !is_over.load(Ordering::Relaxed) {
                    ask(&path, FrameSearch { with_calibration: true, ..none() }, u32::MAX);
                }
            });
        }
        let (slowest, middle) =
            tokio::task::block_in_place(|| tokio::runtime::Handle::current().block_on(store(&database, 100)));
        println!("while {AT_ONCE} questions about everything are looked up: {middle:.1} ms, at most {slowest:.1} ms");
        is_over.store(true, Ordering::Relaxed);
    });
    drop(database);
    writer.end().await;
}
