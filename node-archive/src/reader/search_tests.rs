//! A small archive of two nights, and what is found in it.

use std::path::Path;

use bus::Clock;
use contract::archive::{ArchiveQuestion, ArchiveRow, Ask};
use contract::device::camera::{Frame, Purpose};
use contract::frame_search::{CalibrationFrame, FrameSearch, SkyPlace};
use contract::observatory::{Distortion, FrameFacts, FrameWcs};
use contract::{BootId, CommandId};
use node::NodeAlerts;
use units::Utc;

use crate::database::{Database, StoredFacts, StoredImage, Write, Writer};
use crate::reader::Reader;
use crate::solution;

#[path = "deadline_tests.rs"]
mod deadlines;

const DAY_S: f64 = 86_400.0;

fn at(seconds: f64) -> Utc {
    Utc::from_seconds(1_795_230_000.0 + seconds)
}

/// A frame of a night; the id says which.
fn frame(id: &str, (night, seconds): (&str, f64), purpose: Purpose, exposure_s: f64) -> Frame {
    Frame {
        purpose: Purpose { night: night.to_owned(), ..purpose },
        width_px: 1000,
        height_px: 500,
        started_utc: at(seconds),
        exposure_s,
        bytes: 1_000_000,
        sha256: "ab".to_owned(),
        ..test_support::frame(id)
    }
}

fn light(object: &str, filter: &str) -> Purpose {
    let [object, filter] = [object, filter].map(|text| Some(text.to_owned()));
    Purpose { object, filter, image_type: "Light Frame".to_owned(), ..Purpose::default() }
}

fn calibration(kind: CalibrationFrame, filter: Option<&str>) -> Purpose {
    Purpose { image_type: kind.image_type().to_owned(), filter: filter.map(str::to_owned), ..Purpose::default() }
}

/// Facts of a frame whose middle is at a place, north up and east to the left, 1 arcsec per pixel.
fn facts(id: &str, (ra_deg, dec_deg): (f64, f64), fwhm_px: f64, stars: u32) -> FrameFacts {
    let scale_deg = 1.0 / 3600.0;
    let wcs = FrameWcs {
        ra_deg,
        dec_deg,
        x_px: 499.5,
        y_px: 249.5,
        cd_deg_px: [[-scale_deg, 0.0], [0.0, scale_deg]],
        sip: None,
    };
    FrameFacts {
        frame: CommandId(id.to_owned()),
        stars: Some(stars),
        fwhm_px: Some(fwhm_px),
        ra_deg: Some(ra_deg),
        dec_deg: Some(dec_deg),
        scale_arcsec_px: Some(1.0),
        wcs: Some(wcs),
        ..FrameFacts::default()
    }
}

async fn archive(folder: &Path) -> (Database, Writer) {
    let (database, writer) =
        Database::open(&folder.join("archive.db"), "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    let bias = |id, night, seconds| frame(id, (night, seconds), calibration(CalibrationFrame::Bias, None), 0.0);
    let dark = |id, exposure_s| frame(id, ("20261121", 9000.0), calibration(CalibrationFrame::Dark, None), exposure_s);
    let flat = |id, filter, night, seconds| {
        frame(id, (night, seconds), calibration(CalibrationFrame::Flat, Some(filter)), 3.0)
    };
    let frames = [
        frame("a", ("20261121", 0.0), light("WASP-12", "r"), 30.0),
        frame("b", ("20261121", 60.0), light("WASP-12", "r"), 30.0),
        frame("c", ("20261121", 120.0), light("Ó Céu/1", "z"), 10.0),
        frame("d", ("20261122", DAY_S), light("wasp-12", "r"), 30.0),
        bias("bias-far", "20261115", -6.0 * DAY_S),
        bias("bias-1", "20261121", 8000.0),
        bias("bias-2", "20261121", 8001.0),
        dark("dark-30", 30.0),
        dark("dark-10", 10.0),
        flat("flat-r", "r", "20261120", -0.4 * DAY_S),
        flat("flat-r-refused", "r", "20261121", -3000.0),
        flat("flat-z-too-old", "z", "20261001", -50.0 * DAY_S),
        Frame { bin: 2, ..bias("bias-bin-2", "20261121", 8002.0) },
    ];
    let mut writes: Vec<Write> = Vec::new();
    for frame in frames {
        let id = frame.id.0.clone();
        let stored = frame.started_utc;
        let image = StoredImage { frame, file: format!("{id}.fits"), bytes: 5760, stored };
        writes.push(Write::Stored(Box::new(image), Default::default()));
    }
    let refused = FrameFacts {
        frame: CommandId("flat-r-refused".to_owned()),
        refused: Some("too bright".to_owned()),
        ..FrameFacts::default()
    };
    let measured = [
        facts("a", (97.6366, 29.6723), 1.4, 200),
        facts("b", (97.6366, 29.6723), 3.0, 20),
        facts("c", (359.99, -89.5), 1.0, 50),
        refused,
    ];
    for (seq, facts) in (1..).zip(measured) {
        writes.push(Write::Facts(Box::new(StoredFacts { facts, at: at(500.0), origin: (BootId::fresh(), seq) })));
    }
    database.commit(writes).await.unwrap();
    (database, writer)
}

fn found(database: &Database, search: FrameSearch) -> Vec<(String, Option<CalibrationFrame>)> {
    let question =
        ArchiveQuestion { ask: Ask::FindFrames(Box::new(search)), from_utc: None, to_utc: None, limit: Some(100) };
    let answer = Reader::open(database.path(), "callisto").unwrap().answer(&question, at(0.0)).unwrap();
    let rows = answer.rows.into_iter().map(|row| match row {
        ArchiveRow::FoundFrame(frame) => (frame.id.0, frame.calibrates),
        other => panic!("{other:?}"),
    });
    rows.collect()
}

fn ids(database: &Database, search: FrameSearch) -> Vec<String> {
    found(database, search).into_iter().map(|(id, _)| id).collect()
}

fn text(text: &str) -> Option<String> {
    Some(text.to_owned())
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_are_found_by_night_target_filter_type_and_quality() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = archive(folder.path()).await;
    let by_night = FrameSearch { night: text("20261121"), image_type: text("Light Frame"), ..FrameSearch::default() };
    assert_eq!(ids(&database, by_night), ["a", "b", "c"]);
    let by_object = FrameSearch { object: text("Wasp-12"), ..FrameSearch::default() };
    assert_eq!(ids(&database, by_object.clone()), ["a", "b", "d"]);
    assert_eq!(ids(&database, FrameSearch { object: text("Ó Céu/1"), ..FrameSearch::default() }), ["c"]);
    let sharp = FrameSearch { fwhm_max_arcsec: Some(2.0), ..by_object.clone() };
    assert_eq!(ids(&database, sharp), ["a"], "a frame without facts is not known to be sharp");
    assert_eq!(ids(&database, FrameSearch { stars_min: Some(100), ..by_object }), ["a"]);
    let z = FrameSearch { filter: text("z"), image_type: text("Light Frame"), ..FrameSearch::default() };
    assert_eq!(ids(&database, z), ["c"]);
    assert_eq!(ids(&database, FrameSearch { camera: text("other"), ..FrameSearch::default() }), [""; 0]);
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_are_found_by_a_place_that_they_show() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = archive(folder.path()).await;
    let covers = |ra_deg, dec_deg| {
        let covers = Some(SkyPlace { ra_deg, dec_deg });
        ids(&database, FrameSearch { covers, ..FrameSearch::default() })
    };
    let (ra_deg, dec_deg): (f64, f64) = (97.6366, 29.6723);
    let east_px = |pixels: f64| ra_deg + pixels / 3600.0 / dec_deg.to_radians().cos();
    assert_eq!(covers(ra_deg, dec_deg), ["a", "b"]);
    assert_eq!(covers(east_px(499.0), dec_deg), ["a", "b"], "the last column");
    assert_eq!(covers(east_px(501.0), dec_deg), [""; 0], "beyond the last column");
    assert_eq!(covers(ra_deg, dec_deg + 249.0 / 3600.0), ["a", "b"], "the last row");
    assert_eq!(covers(ra_deg, dec_deg + 251.0 / 3600.0), [""; 0], "beyond the last row");
    assert_eq!(covers(ra_deg + 360.0, dec_deg), ["a", "b"], "a right ascension beyond a turn is the same place");
    // Near the pole the frame spans many degrees of right ascension, and 0 h lies within it.
    assert_eq!(covers(5.0, -89.5), ["c"]);
    assert_eq!(covers(180.0, -89.5), [""; 0]);
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_come_with_those_that_calibrate_them() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = archive(folder.path()).await;
    let search = FrameSearch { object: text("WASP-12"), with_calibration: true, ..FrameSearch::default() };
    let mut all = found(&database, search);
    let calibrating = all.split_off(3);
    assert_eq!(all.iter().map(|(id, _)| id.as_str()).collect::<Vec<_>>(), ["a", "b", "d"]);
    assert!(all.iter().all(|(_, calibrates)| calibrates.is_none()));
    let mut calibrating: Vec<(&str, CalibrationFrame)> =
        calibrating.iter().map(|(id, kind)| (id.as_str(), kind.unwrap())).collect();
    calibrating.sort_unstable();
    // The nearest night of each kind: not the bias frames of a week before, nor another binning, exposure or filter.
    let expected = [
        ("bias-1", CalibrationFrame::Bias),
        ("bias-2", CalibrationFrame::Bias),
        ("dark-30", CalibrationFrame::Dark),
        ("flat-r", CalibrationFrame::Flat),
    ];
    assert_eq!(calibrating, expected);
    let other = FrameSearch { object: text("Ó Céu/1"), with_calibration: true, ..FrameSearch::default() };
    let other: Vec<String> = ids(&database, other);
    assert!(other.contains(&"dark-10".to_owned()) && !other.iter().any(|id| id.starts_with("flat")), "{other:?}");
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn more_frames_than_the_limit_are_the_newest_and_the_answer_shows_it() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = archive(folder.path()).await;
    let search = FrameSearch { object: text("WASP-12"), ..FrameSearch::default() };
    let question = ArchiveQuestion {
        ask: Ask::FindFrames(Box::new(search)),
        from_utc: None,
        to_utc: Some(at(DAY_S)),
        limit: Some(1),
    };
    let answer = Reader::open(database.path(), "callisto").unwrap().answer(&question, at(0.0)).unwrap();
    assert!(answer.truncated);
    assert!(matches!(&answer.rows[..], [ArchiveRow::FoundFrame(frame)] if frame.id.0 == "b"), "{answer:?}");
    drop(database);
    writer.end().await;
}

/// Solutions of frames of 1000 x 500 pixels, about 1 arcsec each, by what is special about them.
fn solutions() -> Vec<(&'static str, FrameWcs)> {
    let (scale, slant) = (1.0 / 3600.0, 1.0 / 3600.0 * std::f64::consts::FRAC_1_SQRT_2);
    let upright = [[-scale, 0.0], [0.0, scale]];
    let wcs = |ra_deg, dec_deg, cd_deg_px| FrameWcs { ra_deg, dec_deg, x_px: 499.5, y_px: 249.5, cd_deg_px, sip: None };
    let bent = Distortion { a: [1e-5, 0.0, 2e-6, 1e-9, 0.0, 0.0, 0.0], b: [0.0, 1e-5, 0.0, 0.0, 0.0, 0.0, -1e-9] };
    vec![
        ("upright", wcs(97.6, 29.6, upright)),
        ("mirrored", wcs(100.0, -20.0, [[scale, 0.0], [0.0, scale]])),
        ("upside down", wcs(110.0, -30.0, [[scale, 0.0], [0.0, -scale]])),
        ("a quarter turn", wcs(120.0, 45.0, [[0.0, scale], [scale, 0.0]])),
        ("an eighth of a turn", wcs(130.0, 70.0, [[-slant, slant], [slant, slant]])),
        ("a mirrored eighth", wcs(140.0, -70.0, [[slant, slant], [-slant, slant]])),
        ("its middle east of 0 h", wcs(0.01, 10.0, upright)),
        ("its middle west of 0 h", wcs(359.99, -10.0, upright)),
        ("its middle at 0 h on the equator", wcs(0.0, 0.0, upright)),
        ("the north pole in the middle", wcs(33.0, 90.0, upright)),
        ("the north pole in a corner", wcs(200.0, 89.87, upright)),
        ("the south pole, mirrored", wcs(77.0, -89.95, [[scale, 0.0], [0.0, scale]])),
        ("bent by a lens", FrameWcs { sip: Some(bent), ..wcs(160.0, 5.0, upright) }),
        ("its reference in a corner", FrameWcs { x_px: 0.0, y_px: 0.0, ..wcs(170.0, 60.0, upright) }),
    ]
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_shows_the_places_of_its_own_pixels_and_no_others_wherever_it_points() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = archive(folder.path()).await;
    let mut writes: Vec<Write> = Vec::new();
    for (seq, (name, wcs)) in (100..).zip(solutions()) {
        let frame = frame(name, ("20261122", DAY_S + 900.0), light(name, "r"), 30.0);
        let (file, stored) = ("x.fits".to_owned(), frame.started_utc);
        let image = StoredImage { frame, file, bytes: 5760, stored };
        writes.push(Write::Stored(Box::new(image), Default::default()));
        let (ra, dec) = solution::wcs(&wcs).pixel_to_sky(499.5, 249.5);
        let facts = FrameFacts { wcs: Some(wcs), ..facts(name, (ra.degrees(), dec.degrees()), 2.0, 100) };
        let origin = (BootId::fresh(), seq);
        writes.push(Write::Facts(Box::new(StoredFacts { facts, at: at(DAY_S + 950.0), origin })));
    }
    database.commit(writes).await.unwrap();
    let (right, top) = (999.4, 499.4);
    let inside = [(499.5, 249.5), (-0.4, -0.4), (right, -0.4), (-0.4, top), (right, top), (0.0, 250.0), (700.0, 0.0)];
    let outside = [(-0.6, 250.0), (999.6, 250.0), (500.0, -0.6), (500.0, 499.6), (1200.0, 700.0), (500.0, 5000.0)];
    for (name, wcs) in solutions() {
        let pixels = inside.map(|pixel| (pixel, true)).into_iter().chain(outside.map(|pixel| (pixel, false)));
        for ((x_px, y_px), is_inside) in pixels {
            let (ra, dec) = solution::wcs(&wcs).pixel_to_sky(x_px, y_px);
            let place = SkyPlace { ra_deg: ra.degrees(), dec_deg: dec.degrees() };
            let ids = ids(&database, FrameSearch { covers: Some(place), ..FrameSearch::default() });
            assert_eq!(ids.iter().any(|id| id == name), is_inside, "{name}: pixel {x_px}, {y_px}; found {ids:?}");
        }
    }
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn strange_conditions_find_nothing_and_end_no_search() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = archive(folder.path()).await;
    let long = "x".repeat(100_000);
    for word in ["", "%", "*", "'; DROP TABLE images; --", "WASP-12\0", "\u{202e}", "?", ":object", long.as_str()] {
        let by: [fn(Option<String>) -> FrameSearch; 5] = [
            |night| FrameSearch { night, ..FrameSearch::default() },
            |camera| FrameSearch { camera, ..FrameSearch::default() },
            |object| FrameSearch { object, ..FrameSearch::default() },
            |filter| FrameSearch { filter, ..FrameSearch::default() },
            |image_type| FrameSearch { image_type, ..FrameSearch::default() },
        ];
        for search in by {
            assert_eq!(ids(&database, search(text(word))), [""; 0], "{word:.40}");
        }
    }
    let (nan, endless) = (f64::NAN, f64::INFINITY);
    for (ra_deg, dec_deg) in
        [(nan, 29.6723), (97.6366, nan), (endless, 29.6723), (97.6366, -endless), (97.6366, 1e300), (97.6366, 389.6723)]
    {
        let search = FrameSearch { covers: Some(SkyPlace { ra_deg, dec_deg }), ..FrameSearch::default() };
        assert_eq!(ids(&database, search), [""; 0], "{ra_deg}, {dec_deg}");
    }
    for most in [nan, 0.0, -1.0, -endless] {
        let search = FrameSearch { fwhm_max_arcsec: Some(most), ..FrameSearch::default() };
        assert_eq!(ids(&database, search), [""; 0], "at most {most}");
    }
    assert_eq!(ids(&database, FrameSearch { stars_min: Some(u32::MAX), ..FrameSearch::default() }), [""; 0]);
    assert_eq!(ids(&database, FrameSearch::default()).len(), 13, "all frames are there still");
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn no_rows_all_rows_and_a_time_that_ends_before_it_begins_are_answered() {
    let folder = tempfile::tempdir().unwrap();
    let (database, writer) = archive(folder.path()).await;
    let (first, last) = (at(-365.0 * DAY_S), at(365.0 * DAY_S));
    for (limit, from_utc, to_utc, rows, truncated) in [
        (Some(0), None, None, 0, true),
        (Some(12), None, None, 12, true),
        (Some(13), None, None, 13, false),
        (Some(u32::MAX), None, None, 13, false),
        (None, Some(first), Some(last), 13, false),
        (None, Some(last), Some(first), 0, false),
        (Some(0), Some(last), None, 0, false),
        (None, Some(at(60.0)), Some(at(60.0)), 0, false),
        (None, Some(at(60.0)), Some(at(60.000_001)), 1, false),
        (None, Some(Utc::from_micros(i64::MIN)), Some(Utc::from_micros(i64::MAX)), 13, false),
    ] {
        let question = ArchiveQuestion { ask: Ask::FindFrames(Box::default()), from_utc, to_utc, limit };
        let answer = Reader::open(database.path(), "callisto").unwrap().answer(&question, at(0.0)).unwrap();
        assert_eq!((answer.rows.len(), answer.truncated), (rows, truncated), "{question:?}");
    }
    drop(database);
    writer.end().await;
}
