//! How long the report of a night of 1,000 frames takes, from the database to the page:
//! `cargo bench -p node-archive --bench report`.

#![allow(clippy::unwrap_used, reason = "a benchmark ends by panicking")]

use std::time::Instant;

use bus::Clock;
use contract::device::camera::Frame;
use contract::node::Level;
use contract::observatory::{ActionNow, FrameFacts, Posture};
use contract::{BootId, CommandId};
use node::NodeAlerts;
use node_archive::database::{Database, StarFlux, StoredFacts, StoredFluxes, StoredImage, StoredState, Write};
use node_archive::night::Night;
use node_archive::reader::Reader;
use report::events::Doing;
use units::Utc;

const FRAMES: u64 = 1000;
const STARS: u32 = 13;
const RUNS: usize = 10;

fn at(second: u64) -> Utc {
    Utc::from_micros((1_795_230_000 + second as i64) * 1_000_000)
}

fn golden<T: serde::de::DeserializeOwned>(text: &str) -> T {
    let samples: serde_json::Value = serde_json::from_str(text).unwrap();
    serde_json::from_value(samples.get(0).unwrap_or(&samples).clone()).unwrap()
}

fn writes(number: u64, boot: &BootId) -> Vec<Write> {
    let mut frame: Frame = golden(include_str!("../../common/contract/golden/v1/camera.frame.json"));
    frame.id = CommandId(format!("frame-{number}"));
    (frame.started_utc, frame.exposure_s) = (at(30 * number), 25.0);
    (frame.purpose.action, frame.purpose.image_type) = ("object".to_owned(), "Light Frame".to_owned());
    let mut facts: FrameFacts = golden(include_str!("../../common/contract/golden/v1/observatory.facts.json"));
    (facts.frame, facts.refused) = (frame.id.clone(), None);
    let file = format!("20261121/{}.fits", frame.id);
    let doing = |step: &str| Doing {
        robotic: true,
        posture: Posture::Open,
        ended: false,
        speed: 1.0,
        simulated: false,
        actions: vec![ActionNow {
            row: 0,
            action: "object".to_owned(),
            camera: frame.camera.clone(),
            object: frame.purpose.object.clone(),
            step: format!("{step} {number} of {FRAMES}"),
            started_utc: at(0),
            expected_by_utc: None,
        }],
    };
    let state = |step: &str, second: u64, seq: u64| {
        let state = serde_json::to_string(&doing(step)).unwrap();
        let origin = (boot.clone(), seq);
        Write::State(Box::new(StoredState {
            part: "night",
            same: state.clone(),
            state,
            at: at(second),
            gap_s: 15.0,
            origin,
        }))
    };
    let fluxes = (0..STARS).map(|star| StarFlux {
        star,
        x_px: 100.0,
        y_px: 100.0,
        flux_adu: 1e5 + f64::from(star) * 1e3 + (number % 17) as f64,
        error_adu: 300.0,
        is_saturated: false,
    });
    let log = |line: u64| Write::Log {
        telescope: "callisto".to_owned(),
        node: "observatory/main".to_owned(),
        target: "node_observatory::row_context".to_owned(),
        level: Level::Info,
        message: if line == 0 { "took row=0 span=spool took_s=1.5".to_owned() } else { format!("line {line}") },
        at: at(30 * number + 26),
        origin: (boot.clone(), 20 * number + line),
    };
    let mut all = vec![
        state("exposing", 30 * number, 2 * number),
        state("correcting by", 30 * number + 26, 2 * number + 1),
        Write::Facts(Box::new(StoredFacts { facts, at: at(30 * number + 28), origin: (boot.clone(), 0) })),
        Write::Fluxes(Box::new(StoredFluxes {
            frame: frame.id.clone(),
            series: "series".to_owned(),
            new_stars: vec![],
            fluxes: fluxes.collect(),
        })),
        Write::Stored(
            Box::new(StoredImage { file, bytes: 8_391_680, stored: at(30 * number + 28), frame }),
            Default::default(),
        ),
    ];
    all.extend((0..20).map(log));
    all
}

#[tokio::main]
async fn main() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    let boot = BootId::fresh();
    for number in 0..FRAMES {
        for write in writes(number, &boot) {
            database.put(write).await.unwrap();
        }
    }
    drop(database);
    writer.end().await;
    let night = Night {
        date: sky::NightDate::new(2026, 11, 21).unwrap(),
        from: at(0).plus_seconds(-20_000.0),
        to: at(0).plus_seconds(66_400.0),
    };
    let mut took_s: Vec<f64> = (0..RUNS)
        .map(|_| {
            let began = Instant::now();
            let mut events = Reader::open(&path, "callisto").unwrap().night_events(&night, night.to).unwrap();
            events.dark = Some((at(0), at(36_000)));
            let report = report::make(&events);
            assert_eq!((report.disk.frames, report.curves.len()), (FRAMES as u32, 1));
            let (page, json) = (report::html::page(&report), serde_json::to_vec(&report).unwrap());
            assert!(page.len() > 10_000 && json.len() > 10_000);
            if let Ok(file) = std::env::var("STARMESH_KEEP_PAGE") {
                std::fs::write(file, &page).unwrap();
            }
            began.elapsed().as_secs_f64()
        })
        .collect();
    took_s.sort_by(f64::total_cmp);
    println!("report of {FRAMES} frames: median {:.3} s, slowest {:.3} s", took_s[RUNS / 2], took_s[RUNS - 1]);
}
