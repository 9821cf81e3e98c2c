//! The night of `examples/night`, with its files as they are: every action, in the order of a night, from dusk to dawn.
//! It ends closed and parked, and every exposure that the simulator's log knows is one whole FITS file and one row of
//! the archive.

#![allow(clippy::unwrap_used, reason = "a test ends by panicking")]

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use bus::{Catch, Latest, Subscriber};
use contract::device::camera::Frame;
use contract::observatory::{
    ActionAnswer, ActionQuestion, Alerts, FocusOutcome, FocusRun, GuidingState, PointingState, RowState, RowStatus,
    ScheduleState,
};
use contract::{Address, Key, Part};
use serde_json::{Value, json};
use simulator::Simulator;
use test_support::{Harness, example, header};

/// Sky seconds per machine second. On two slow and busy cores a frame takes 0.8 s from one to the next, and so long the
/// light of this slow twilight is the same within a tenth.
const SPEED: f64 = 100.0;
/// Half of it is there for a busy machine: the rows of the night need 40 s on a quiet one.
const MOST_S: f64 = 240.0;

/// Frames that each row ends with, in the order of the rows; `None` where the frames are as many as it takes.
const ROWS: [(&str, Option<u32>); 14] = [
    ("cool_camera", Some(0)),
    ("open", Some(0)),
    ("flats", Some(4)),
    ("autofocus", None),
    ("calibrate_guiding", None),
    ("pointing_model", Some(6)),
    ("object", Some(5)),
    ("object", Some(3)),
    ("object", Some(3)),
    ("flats", Some(4)),
    ("close", Some(0)),
    ("flats", Some(3)),
    ("calibration", Some(7)),
    ("complete_headers", Some(0)),
];

/// The simulator as README.md next to the files starts it.
fn world() -> simulator::Options {
    let mut world = simulator::Options {
        start: "2026-06-20T20:50:00Z".parse().unwrap(),
        speed: SPEED,
        latitude: units::Angle::from_degrees(56.773),
        longitude: units::Angle::from_degrees(24.404),
        ..Default::default()
    };
    world.dome.watchdog_s = Some(120.0);
    let camera = &mut world.camera;
    (camera.width, camera.height, camera.pixel_um, camera.optics_fwhm_arcsec) = (512, 512, 54.0, 25.0);
    world
}

/// The example's files, with this simulator for theirs and a bus of the test's own.
fn files(simulator: &Simulator) -> (String, String) {
    let config = example("night/observatory.toml").replace("127.0.0.1:11111", &simulator.address().to_string());
    (config + "\n[bus]\nmulticast = false\n[web]\nlisten = \"127.0.0.1:0\"\n", example("night/schedule.jsonl"))
}

/// The samples that the test received during the night.
struct Subscribers {
    schedule: Subscriber<ScheduleState>,
    guiding: Latest<GuidingState>,
    pointing: Latest<PointingState>,
    alerts: Latest<Alerts>,
    focus: Subscriber<FocusRun>,
}

impl Subscribers {
    async fn of(harness: &Harness, address: &Address) -> anyhow::Result<Self> {
        let part = |part| Key::Observatory(address.clone(), part);
        Ok(Self {
            schedule: harness.bus.subscribe(&part(Part::Schedule).to_string(), Catch::All, 10_000).await?,
            guiding: harness.bus.latest(&part(Part::Guiding)).await?,
            pointing: harness.bus.latest(&part(Part::Pointing)).await?,
            alerts: harness.bus.latest(&part(Part::Alerts)).await?,
            focus: harness.bus.subscribe(&Key::FocusRun(address.clone()).to_string(), Catch::All, 100).await?,
        })
    }
}

/// Waits until all rows are finished, and prints the progress. Returns them in the order in which they ran, and whether
/// a field was guided meanwhile.
async fn follow(harness: &Harness, subscribers: &Subscribers) -> anyhow::Result<(Vec<usize>, bool)> {
    let began = Instant::now();
    let (mut last, mut order, mut guided) = (Vec::<RowStatus>::new(), Vec::new(), false);
    while order.len() < ROWS.len() {
        anyhow::ensure!(began.elapsed().as_secs_f64() < MOST_S, "{order:?} are finished\n{}", harness.last_words());
        guided |= subscribers.guiding.get().is_some_and(|received| received.sample.body.active);
        let received = match tokio::time::timeout(Duration::from_millis(200), subscribers.schedule.recv()).await {
            Ok(received) => received.sample,
            Err(_) => continue,
        };
        last.resize(received.body.rows.len(), RowStatus::Pending);
        for (index, row) in received.body.rows.iter().enumerate() {
            if std::mem::replace(&mut last[index], row.status) == row.status {
                continue;
            }
            let (at_s, sky) = (began.elapsed().as_secs_f64(), received.at_utc);
            println!("{at_s:6.1} s {sky} {} {:?} {} frames, {}", row.action, row.status, row.frames, row.detail);
            match row.status {
                RowStatus::Finished => order.push(index),
                RowStatus::Failed | RowStatus::Skipped => anyhow::bail!("{row:?}\n{}", harness.last_words()),
                RowStatus::Pending | RowStatus::Running | RowStatus::Interrupted => {}
            }
        }
    }
    Ok((order, guided))
}

/// A frame as the archive's row describes it.
struct ArchivedFrame {
    id: String,
    file: String,
    frame: Frame,
    is_complete: bool,
}

fn archived_frames(harness: &Harness) -> anyhow::Result<Vec<ArchivedFrame>> {
    let database = rusqlite::Connection::open(harness.path("data/archive.db"))?;
    let mut query = database.prepare("SELECT frame_id, file, frame, complete_hdr FROM images ORDER BY date_obs")?;
    let rows = query.query_map([], |row| {
        Ok((row.get::<_, String>(0)?, row.get::<_, String>(1)?, row.get::<_, String>(2)?, row.get::<_, bool>(3)?))
    })?;
    let mut found = Vec::new();
    for row in rows {
        let (id, file, frame, is_complete) = row?;
        found.push(ArchivedFrame { id, file, frame: serde_json::from_str(&frame)?, is_complete });
    }
    Ok(found)
}

/// The exposures that the simulator's cameras began, in ms and with or without light; each was let run to its end.
fn exposures(harness: &Harness) -> Vec<(i64, bool)> {
    let puts = harness.simulator.world().puts_since(0);
    let ended_early: Vec<_> =
        puts.iter().filter(|put| matches!(&*put.member, "abortexposure" | "stopexposure")).collect();
    assert!(ended_early.is_empty(), "{ended_early:?}");
    let value = |parameters: &str, name: &str| {
        let of = |pair: &str| pair.split_once('=').filter(|(key, _)| *key == name).map(|(_, value)| value.to_owned());
        parameters.split('&').find_map(of).unwrap()
    };
    let begun = puts.iter().filter(|put| put.member == "startexposure");
    begun
        .map(|put| {
            assert_eq!(put.error, Some(0), "{put:?}");
            let seconds: f64 = value(&put.parameters, "Duration").parse().unwrap();
            ((seconds * 1000.0).round() as i64, value(&put.parameters, "Light").eq_ignore_ascii_case("true"))
        })
        .collect()
}

/// Checks that every exposure is one whole file and one row, and that there are no others.
async fn account(harness: &Harness) -> anyhow::Result<()> {
    let begun = exposures(harness);
    let whole = |harness: &Harness| {
        archived_frames(harness)
            .is_ok_and(|archived| archived.len() == begun.len() && archived.iter().all(|it| it.is_complete))
    };
    harness.until(&format!("{} frames with whole headers", begun.len()), 60.0, whole).await?;
    let archived = archived_frames(harness)?;
    let events: Vec<(i64, bool)> =
        archived.iter().map(|it| ((it.frame.exposure_s * 1000.0).round() as i64, is_light(&it.frame))).collect();
    assert_eq!(events, begun, "one after another, as the simulator exposed them");
    let files: BTreeSet<_> = harness.fits().into_iter().collect();
    let of_rows: BTreeSet<_> = archived.iter().map(|it| harness.path("images").join(&it.file)).collect();
    assert_eq!((files.len(), &files), (begun.len(), &of_rows), "no file without a row, none twice");
    let mut counts = BTreeMap::<(u32, String), usize>::new();
    for it in &archived {
        let path = harness.path("images").join(&it.file);
        let header = header(&path)?;
        let purpose = &it.frame.purpose;
        *counts.entry((purpose.row.unwrap(), purpose.image_type.clone())).or_default() += 1;
        let text = |keyword: &str| header.get(keyword).map(|value| value.trim_matches(['\'', ' ']).to_owned());
        assert_eq!(text("FRAMEID").as_deref(), Some(it.id.as_str()), "{}", it.file);
        assert_eq!(text("IMAGETYP").as_deref(), Some(purpose.image_type.as_str()), "{}", it.file);
        assert!(header.contains_key("DATE-OBS") && header.contains_key("BKGLEVEL"), "{}: {header:?}", it.file);
        // A keyword that only a complete header has.
        let needs = if purpose.image_type == "Light Frame" { "OBJALT" } else { "CCD-TEMP" };
        assert!(header.contains_key(needs), "{}: no {needs} in {:?}", it.file, header.keys().collect::<BTreeSet<_>>());
    }
    println!("{} exposures: {counts:?}", begun.len());
    let of = |row: u32, image_type: &str| counts.get(&(row, image_type.to_owned())).copied().unwrap_or_default();
    assert_eq!(of(5, "Dark Frame"), 1, "the pointing model's own");
    assert_eq!((of(12, "Bias Frame"), of(12, "Dark Frame")), (3, 4));
    Ok(())
}

/// Compares each row with its forecast: the same action, finished, with the same frames.
fn went_as_planned(rows: &[RowState], plan: &str) -> anyhow::Result<()> {
    let plan: Vec<Value> = plan.lines().map(serde_json::from_str).collect::<Result<_, _>>()?;
    let plan: Vec<&Value> = plan.iter().filter(|line| line["row"].is_number()).collect();
    assert_eq!(plan.len(), rows.len());
    for (row, planned) in rows.iter().zip(plan) {
        assert_eq!((&planned["action"], &planned["status"]), (&json!(row.action), &json!("finished")), "{planned}");
        // How many frames a focus run and a guide calibration need depends on what they see.
        let is_open = matches!(&*row.action, "autofocus" | "calibrate_guiding");
        let (frames, taken) = (planned["frames"].as_u64().unwrap(), u64::from(row.frames));
        assert!(frames == taken || is_open && frames > 0 && taken > 0, "{frames} frames planned: {row:?}");
    }
    Ok(())
}

/// The level without light that flats begin with is a test frame of no exposure.
fn is_light(frame: &Frame) -> bool {
    frame.exposure_s > 0.0 && !matches!(&*frame.purpose.image_type, "Bias Frame" | "Dark Frame")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_night_with_every_action_ends_closed_with_every_frame_accounted_for() -> anyhow::Result<()> {
    let mut harness = Harness::of_files(world(), files).await?;
    let config = config::parse(&std::fs::read_to_string(harness.path("observatory.toml"))?, &harness.path(""))?;
    let address = config.address();
    let [toml, schedule] = ["observatory.toml", "schedule.jsonl"].map(|name| harness.path(name).display().to_string());
    for words in [vec!["check", &toml], vec!["check", &schedule, "--at", "2026-06-20T20:50:00Z"]] {
        let output = harness.starmesh(&words).await?;
        assert!(!output.contains("warning") && !output.contains("error"), "{output}");
    }
    let plan = harness.starmesh(&["plan", &schedule, "--config", &toml, "--json"]).await?;
    let subscribers = Subscribers::of(&harness, &address).await?;
    harness.start_all()?;
    let (order, guided) = follow(&harness, &subscribers).await?;
    assert_eq!(order, (0..ROWS.len()).collect::<Vec<_>>(), "one row after another");
    harness
        .until("the night ends", 60.0, |harness| harness.night.get().is_some_and(|night| night.sample.body.ended))
        .await?;

    let rows = harness.schedule.get().unwrap().sample.body.rows;
    let actions: Vec<_> = rows.iter().map(|row| row.action.as_str()).collect();
    assert_eq!(actions, ROWS.map(|(action, _)| action));
    for (row, (_, frames)) in rows.iter().zip(ROWS) {
        assert_eq!(row.status, RowStatus::Finished, "{row:?}");
        assert!(frames.is_none_or(|frames| row.frames == frames), "{frames:?} expected: {row:?}");
    }
    went_as_planned(&rows, &plan)?;
    // No action is left out: the bus lists all actions.
    let answer: ActionAnswer =
        harness.bus.ask(&Key::Actions(address.clone()), &ActionQuestion::default(), Duration::from_secs(5)).await?;
    let all: BTreeSet<&str> = answer.actions.iter().map(|action| action.name.as_str()).collect();
    assert_eq!(actions.into_iter().collect::<BTreeSet<_>>(), all);
    assert!(answer.actions.iter().all(|action| action.schema["type"] == "object" && action.example.is_object()));

    let run = tokio::time::timeout(Duration::from_secs(5), subscribers.focus.recv()).await?.sample.body;
    assert_eq!(run.outcome, FocusOutcome::Focused, "{run:?}");
    assert!(guided, "a field was held by guiding");
    let points: usize =
        subscribers.pointing.get().unwrap().sample.body.models.iter().map(|model| model.points.len()).sum();
    assert!(points >= 6, "the pointing model has learned {points} places");

    assert!(
        harness.is_shut() && harness.is_parked() && harness.simulator.world().is_parked(),
        "{}",
        harness.last_words()
    );
    let mut lamp =
        harness.simulator.world().puts_since(0).into_iter().filter(|put| put.member.starts_with("calibrator"));
    assert_eq!(lamp.next_back().map(|put| put.member), Some("calibratoroff".to_owned()), "the panel is dark");
    account(&harness).await?;
    let active = subscribers.alerts.get().unwrap().sample.body.alerts;
    assert!(active.is_empty(), "{active:?}");
    let chains = ["device", "observatory"].map(|role| harness.path(&format!("data/audit-{role}-alpha-main.jsonl")));
    let chains = chains.map(|file| file.display().to_string());
    println!("{}", harness.starmesh(&["audit", "verify", &chains[0], &chains[1]]).await?);
    Ok(())
}
