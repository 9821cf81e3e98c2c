//! The keyword of guiding, from corrections in a real database.

use std::path::PathBuf;

use bus::Clock;
use contract::device::camera::Purpose;
use contract::observatory::{AxisCorrection, Correction, FrameFacts};
use contract::{BootId, CommandId};
use node::NodeAlerts;

use super::*;
use crate::database::{Database, StoredCorrection, StoredFacts, StoredImage, Write};
use crate::night::Night;

const START: &str = "2026-11-21T03:00:00Z";

fn at(second: f64) -> Utc {
    START.parse::<Utc>().unwrap().plus_seconds(second)
}

/// A frame of 30 s of this action, which began so many seconds after [`START`].
fn frame(action: &str, second: f64) -> Frame {
    let purpose = Purpose { action: action.to_owned(), ..Purpose::default() };
    Frame { purpose, started_utc: at(second), exposure_s: 30.0, ..test_support::frame("frame-1") }
}

/// The first of the frozen samples.
fn sample() -> Correction {
    let samples = include_str!("../../common/contract/golden/v1/observatory.correction.json");
    serde_json::from_str::<Vec<Correction>>(samples).unwrap().remove(0)
}

/// A correction of a frame whose stars stood so far from where they are held.
fn off(off_px: Option<f64>) -> Correction {
    let along = |share: f64| off_px.map(|off_px| share * off_px);
    Correction { dx_px: along(-1.0), dy_px: along(0.0), ..sample() }
}

/// What this telescope published.
fn published(correction: Correction, telescope: &str) -> Write {
    let (telescope, origin) = (telescope.to_owned(), (BootId::fresh(), 0));
    Write::Correction(Box::new(StoredCorrection { correction, telescope, origin }))
}

/// What a camera that guides wrote of a frame whose stars stood so far from where they are held.
fn correction(id: &str, camera: &str, second: f64, off_px: f64) -> Write {
    let guided = off(Some(off_px));
    let axis = |error_px| AxisCorrection { error_px: Some(error_px), ..guided.east.clone() };
    let correction = Correction {
        frame: CommandId(id.to_owned()),
        camera: camera.to_owned(),
        mid_utc: at(second),
        reference: CommandId("reference".to_owned()),
        east: axis(off_px),
        north: axis(0.0),
        ..guided
    };
    published(correction, "callisto")
}

/// A frame that is stored.
fn image(id: &str, frame: Frame) -> Write {
    let frame = Frame { id: CommandId(id.to_owned()), ..frame };
    let stored = frame.started_utc.plus_seconds(40.0);
    let image = StoredImage { frame, file: format!("{id}.fits"), bytes: 5760, stored };
    Write::Stored(Box::new(image), PathBuf::from(id))
}

/// Not how well the distance was measured, which is the `error_px` beside it.
#[tokio::test(flavor = "multi_thread")]
async fn the_guide_error_is_the_distance_of_the_stars_from_where_they_are_held() {
    let sample = sample();
    let off_px = sample.dx_px.unwrap().hypot(sample.dy_px.unwrap());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    let correction = Correction { mid_utc: at(15.0), ..sample };
    database.commit(vec![published(correction, "callisto")]).await.unwrap();
    let plan = plan(&Reader::open(&path, "callisto").unwrap(), "callisto", &frame("object", 0.0)).unwrap();
    let CardValue::Float(rms_px) = plan.cards[0].value else { panic!("{plan:?}") };
    assert!((rms_px - off_px).abs() < 1e-12, "{rms_px}");
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn guide_errors_during_the_exposure_make_the_keyword_and_those_of_other_telescopes_do_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    let measured = [
        (-20.0, Some(9.0), "callisto"),
        (0.0, Some(3.0), "callisto"),
        (10.0, Some(4.0), "callisto"),
        (20.0, None, "callisto"),
        (25.0, Some(50.0), "io"),
        (31.0, Some(9.0), "callisto"),
    ];
    for (number, (second, off_px, telescope)) in measured.into_iter().enumerate() {
        let frame = CommandId(format!("guide-{number}"));
        let correction = Correction { frame, mid_utc: at(second), ..off(off_px) };
        database.commit(vec![published(correction, telescope)]).await.unwrap();
    }
    let reader = Reader::open(&path, "callisto").unwrap();
    let guided = plan(&reader, "callisto", &frame("object", 0.0)).unwrap();
    assert_eq!(guided.cards.len(), 1);
    assert_eq!(
        (guided.cards[0].keyword.as_str(), &guided.cards[0].value),
        (GUIDED, &CardValue::Float(12.5_f64.sqrt()))
    );
    assert!(guided.cards[0].record().unwrap().contains("[pix] rms guide error, guide frames: 2"));
    assert!(guided.history.is_empty());
    // The next exposure is guided too, and what was measured during it is still to come.
    let awaited =
        |frame: &Frame, waited_s| is_awaited(&reader, "callisto", frame, Duration::from_secs(waited_s)).unwrap();
    assert!(awaited(&frame("object", 32.0), 0));
    assert!(!awaited(&frame("object", 0.0), 0) && !awaited(&frame("calibration", 32.0), 0));
    // Pulses of some seconds are given before it is published.
    assert_eq!([6, 9, 10].map(|waited_s| awaited(&frame("object", 32.0), waited_s)), [true, true, false]);
    // An hour later nothing is guided: nothing is awaited, and the history says why there is no keyword.
    let alone = frame("object", 3600.0);
    assert!(!awaited(&alone, 0));
    let plan_alone = plan(&reader, "callisto", &alone).unwrap();
    assert!(plan_alone.cards.is_empty());
    assert_eq!(plan_alone.history, ["not guided, as far as known at completion: GUIDERMS"]);
    assert_eq!(plan(&reader, "callisto", &frame("calibration", 3600.0)).unwrap(), Plan::default());
    drop(database);
    writer.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_counts_what_was_measured_from_its_first_to_its_last_moment_and_each_measurement_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    for (id, second, off_px) in [
        ("before", -0.000_001, Some(100.0)),
        ("first", 0.0, Some(6.0)),
        // Received a second time, as after a restart of the bus.
        ("first", 0.0, Some(6.0)),
        ("lost", 15.0, None),
        ("last", 30.0, Some(8.0)),
        ("behind", 30.000_001, Some(100.0)),
        ("much later", 3610.0, None),
    ] {
        let frame = CommandId(id.to_owned());
        let correction = Correction { frame, mid_utc: at(second), ..off(off_px) };
        database.commit(vec![published(correction, "callisto")]).await.unwrap();
    }
    let reader = Reader::open(&path, "callisto").unwrap();
    let guided = plan(&reader, "callisto", &frame("object", 0.0)).unwrap();
    assert_eq!(guided.cards[0].value, CardValue::Float(50_f64.sqrt()));
    assert!(guided.cards[0].comment.ends_with("guide frames: 2"), "{}", guided.cards[0].comment);
    // Stars were lost in the whole exposure: there is no number, and the history says so.
    let lost = plan(&reader, "callisto", &frame("object", 3600.0)).unwrap();
    assert_eq!((lost.cards.len(), lost.history.len()), (0, 1));
    // What was looked at in vain is not awaited.
    let looked = |second| is_awaited(&reader, "callisto", &frame("object", second), Duration::ZERO).unwrap();
    assert_eq!([3600.0, 3625.0].map(looked), [false, true]);
    // A frame without any exposure is one moment.
    let mut moment = frame("object", 30.0);
    moment.exposure_s = 0.0;
    assert_eq!(plan(&reader, "callisto", &moment).unwrap().cards[0].value, CardValue::Float(8.0));
    assert!(plan(&reader, "europa", &frame("object", 0.0)).unwrap().cards.is_empty());
    drop(database);
    writer.end().await;
}

/// A camera of its own guides, and the first frame of the row, too, is looked at.
#[tokio::test(flavor = "multi_thread")]
async fn the_frames_that_guided_are_the_same_for_the_keyword_the_view_of_the_database_and_the_report() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    // A pixel of both is 2 arcsec.
    let scale = |id: &str, camera: &str| {
        let (frame, camera) = (CommandId(id.to_owned()), Some(camera.to_owned()));
        let facts = FrameFacts { frame, camera, scale_arcsec_px: Some(2.0), ..Default::default() };
        Write::Facts(Box::new(StoredFacts { facts, at: at(0.0), origin: (BootId::fresh(), 0) }))
    };
    let writes = vec![
        image("own", frame("object", 0.0)),
        image("other", frame("object", 100.0)),
        scale("own", "andor"),
        scale("g-1", "guider"),
        // Guided on itself; what the guide camera saw meanwhile is in other pixels, whatever their number.
        correction("own", "andor", 15.0, 3.0),
        correction("g-1", "guider", 10.0, 50.0),
        correction("g-2", "guider", 20.0, 50.0),
        // Guided by the guide camera, whose first frame is the reference, and by a frame of a third one.
        correction("reference", "guider", 101.0, 0.0),
        correction("g-3", "guider", 110.0, 6.0),
        correction("g-4", "guider", 120.0, 8.0),
        correction("third", "third", 115.0, 50.0),
    ];
    database.commit(writes).await.unwrap();
    let reader = Reader::open(&path, "callisto").unwrap();
    let view = rusqlite::Connection::open(&path).unwrap();
    for (id, second, rms_px) in [("own", 0.0, 3.0), ("other", 100.0, 50_f64.sqrt())] {
        let keyword = plan(&reader, "callisto", &frame("object", second)).unwrap().cards.remove(0).value;
        assert_eq!(keyword, CardValue::Float(rms_px), "{id}");
        let sql = "SELECT guide_rms_arcsec FROM frames WHERE frame_id = ?";
        let rms_arcsec: f64 = view.query_row(sql, [id], |row| row.get(0)).unwrap();
        assert!((rms_arcsec - 2.0 * rms_px).abs() < 1e-9, "{id}: {rms_arcsec}");
    }
    // Pixels of two cameras are two units: each has a figure of its own.
    let night = Night { date: "20261120".parse().unwrap(), from: at(-3600.0), to: at(3600.0) };
    let held = report::make(&reader.night_events(&night, night.to).unwrap()).guiding;
    let held: Vec<_> = held.iter().map(|of| (of.camera.as_str(), of.bin.is_some(), of.frames, of.rms_px)).collect();
    assert_eq!(held, [("andor", true, 1, 3.0), ("guider", false, 2, 50_f64.sqrt())]);
    drop(database);
    writer.end().await;
}

/// The night is asked about in one question; each of its frames is held by what held it alone.
#[tokio::test(flavor = "multi_thread")]
async fn a_night_was_held_by_what_held_each_frame_of_a_target_and_each_measurement_counts_once_for_an_object() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    let image = |id: &str, camera: &str, object: &str, second: f64| {
        let plain = frame("object", second);
        let purpose = Purpose { object: Some(object.to_owned()), ..plain.purpose };
        image(id, Frame { purpose, camera: camera.to_owned(), ..plain })
    };
    let writes = vec![
        image("a", "andor", "A", 0.0),
        // Exposed by another camera meanwhile.
        image("b", "second", "A", 10.0),
        image("c", "andor", "B", 40.0),
        image("d", "andor", "B", 100.0),
        image("nobody held it", "andor", "C", 1000.0),
        self::image("of no target", frame("calibration", 20.0)),
        correction("g-1", "guider", 15.0, 3.0),
        correction("g-2", "guider", 35.0, 4.0),
        // In the last moment of one exposure and the first of the next.
        correction("g-3", "guider", 40.0, 5.0),
        correction("g-4", "guider", 60.0, 6.0),
        correction("g-5", "guider", 70.000_001, 50.0),
        // A camera that measured less.
        correction("third-1", "third", 50.0, 50.0),
        // Guided on itself, while the guide camera measured more.
        correction("d", "andor", 115.0, 2.0),
        correction("g-6", "guider", 110.0, 50.0),
        correction("g-7", "guider", 120.0, 50.0),
    ];
    database.commit(writes).await.unwrap();
    let reader = Reader::open(&path, "callisto").unwrap();
    let night = |from_s, to_s| Night { date: "20261120".parse().unwrap(), from: at(from_s), to: at(to_s) };
    let held = |night: Night| {
        let guiding = reader.night_events(&night, night.to).unwrap().guiding;
        let of = |of: report::events::GuideRecord| (of.object.unwrap_or_default(), of.camera, of.bin, of.off_px);
        guiding.into_iter().map(of).collect::<Vec<_>>()
    };
    let of = |object: &str, camera: &str, bin, off_px| (object.to_owned(), camera.to_owned(), bin, off_px);
    let expected = [
        of("A", "guider", None, 3.0),
        of("A", "guider", None, 4.0),
        of("A", "guider", None, 5.0),
        of("B", "guider", None, 5.0),
        of("B", "guider", None, 6.0),
        of("B", "andor", Some(1), 2.0),
    ];
    assert_eq!(held(night(-3600.0, 3600.0)), expected);
    assert!(held(night(500.0, 3600.0)).is_empty(), "no frame of it was held");
    assert!(held(night(2000.0, 3600.0)).is_empty(), "it has no frame");
    drop(database);
    writer.end().await;
}

#[test]
fn the_root_mean_square_of_nothing_is_nothing() {
    assert_eq!(rms(&[]), None);
    assert_eq!(rms(&[3.0, 4.0, 0.0, 5.0]), Some(12.5_f64.sqrt()));
    assert_eq!(rms(&[f64::NAN]), None);
}
