//! The same conditions find the same frames on the command line, over HTTP and on the bus, whatever names and places are in
//! them; and nights that are written as Parquet, where one of them cannot be.

use std::fmt::Write as _;
use std::path::Path;
use std::time::Duration;

use bus::{Bus, Clock};
use contract::archive::{ArchiveAnswer, ArchiveQuestion, Ask};
use contract::device::camera::Frame;
use contract::frame_search::{FrameSearch, SkyPlace};
use contract::observatory::{FrameFacts, FrameWcs};
use contract::{BootId, CommandId, Key, Role};
use node::{Node, NodeAlerts};
use node_archive::database::{Database, StoredFacts, StoredImage, Write as Stored};
use serde_json::{Value, json};
use test_support::{PARANAL, RunningNode, join, private_bus};
use units::Utc;

use crate::command::{Output, starmesh};

/// Names that are text in one language and something else in another.
const NAMES: [&str; 9] = [
    "WASP-12",
    "it's \"1\"",
    "50%",
    "a_b",
    "-- x; DROP TABLE images",
    "Żuraw & <i>",
    "a+b&c=d#e",
    "{\"a\":1}",
    "\u{1f52d} e\u{301}",
];
/// Right ascension and declination of the middles of frames of 1000 x 1000 pixels of 3.6 arcsec.
const PLACES: [(f64, f64); 6] = [(0.0, 0.0), (359.9, 10.0), (0.1, -10.0), (120.0, 89.9), (33.0, -90.0), (180.0, 45.0)];

fn at(second: f64) -> Utc {
    Utc::from_seconds(1_795_230_000.0 + second)
}

fn sample<T: serde::de::DeserializeOwned>(text: &str) -> T {
    let samples: Value = serde_json::from_str(text).unwrap();
    serde_json::from_value(samples.get(0).unwrap_or(&samples).clone()).unwrap()
}

/// A frame for each name and each place, and one that calibrates them.
fn frames() -> Vec<Stored> {
    let golden: Frame = sample(include_str!("../../../common/contract/golden/v1/camera.frame.json"));
    let mut writes = Vec::new();
    let mut add = |number: usize, object: &str, image_type: &str, facts: FrameFacts| {
        let mut frame =
            Frame { id: CommandId(format!("f{number:02}")), started_utc: at(60.0 * number as f64), ..golden.clone() };
        (frame.width_px, frame.height_px) = (1000, 1000);
        frame.purpose.object = Some(object.to_owned());
        frame.purpose.filter = Some(object.to_owned());
        (frame.purpose.image_type, frame.purpose.night) = (image_type.to_owned(), "20261121".to_owned());
        let (path, file) = (format!("/images/{number}.fits").into(), format!("{number}.fits"));
        let facts = FrameFacts { frame: frame.id.clone(), ..facts };
        let stored = frame.started_utc;
        writes.push(Stored::Stored(Box::new(StoredImage { frame, file, bytes: 5760, stored }), path));
        let origin = (BootId::fresh(), number as u64);
        writes.push(Stored::Facts(Box::new(StoredFacts { facts, at: at(0.0), origin })));
    };
    for (number, name) in NAMES.into_iter().enumerate() {
        add(number, name, "Light Frame", FrameFacts { stars: Some(number as u32), ..FrameFacts::default() });
    }
    for (number, (ra_deg, dec_deg)) in (NAMES.len()..).zip(PLACES) {
        let cd_deg_px = [[-0.001, 0.0], [0.0, 0.001]];
        let wcs = FrameWcs { ra_deg, dec_deg, x_px: 499.5, y_px: 499.5, cd_deg_px, sip: None };
        let facts = FrameFacts {
            ra_deg: Some(ra_deg),
            dec_deg: Some(dec_deg),
            scale_arcsec_px: Some(3.6),
            fwhm_px: Some(number as f64),
            wcs: Some(wcs),
            ..FrameFacts::default()
        };
        add(number, "field", "Light Frame", facts);
    }
    add(90, "bias", "Bias Frame", FrameFacts::default());
    writes
}

/// The conditions of one question.
#[derive(Debug, Clone, Default)]
struct Question {
    search: FrameSearch,
    from: Option<f64>,
    to: Option<f64>,
    limit: Option<u32>,
}

impl Question {
    /// Each condition by its names in an address and on the command line.
    fn conditions(&self) -> Vec<(&'static str, &'static str, String)> {
        let FrameSearch { night, camera, object, filter, image_type, covers, fwhm_max_arcsec, stars_min, .. } =
            &self.search;
        let place = covers.map(|SkyPlace { ra_deg, dec_deg }| format!("{ra_deg},{dec_deg}"));
        let number = |value: Option<f64>| value.map(|value| value.to_string());
        let time = |second: Option<f64>| second.map(|second| at(second).to_string());
        let all = [
            ("night", "--night", night.clone()),
            ("camera", "--camera", camera.clone()),
            ("object", "--object", object.clone()),
            ("filter", "--filter", filter.clone()),
            ("image_type", "--type", image_type.clone()),
            ("covers", "--covers", place),
            ("fwhm_max_arcsec", "--fwhm-max", number(*fwhm_max_arcsec)),
            ("stars_min", "--stars-min", stars_min.map(|stars| stars.to_string())),
            ("from_utc", "--from", time(self.from)),
            ("to_utc", "--to", time(self.to)),
            ("limit", "--limit", self.limit.map(|limit| limit.to_string())),
        ];
        all.into_iter().filter_map(|(address, option, value)| Some((address, option, value?))).collect()
    }
}

/// An archive and a web node with these frames, and who asks them.
struct Site {
    folder: tempfile::TempDir,
    bus: Bus,
    url: String,
    nodes: [RunningNode; 2],
}

impl Site {
    async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let text = format!("{PARANAL}[web]\nlisten = \"127.0.0.1:0\"\n");
        std::fs::write(folder.path().join("observatory.toml"), &text).unwrap();
        let config = config::parse(&text, folder.path()).unwrap();
        // The disk of the frames is there.
        std::fs::create_dir_all(config.folders.images.join(".part")).unwrap();
        let alerts = NodeAlerts::new(Clock::machine_clock());
        let (database, writer) = Database::open(&config.archive.database, "callisto", alerts).unwrap();
        database.commit(frames()).await.unwrap();
        drop(database);
        writer.end().await;
        let bus = private_bus(Clock::machine_clock()).await;
        let node = |role, bus| Node::new(role, "main".parse().unwrap(), config.clone(), Default::default(), bus);
        let archive = RunningNode::live(node(Role::Archive, join(&bus).await), node_archive::run);
        let web = RunningNode::live(node(Role::Web, join(&bus).await), node_web::run);
        let url = web.page_url(&bus).await;
        Self { folder, bus, url, nodes: [archive, web] }
    }

    async fn on_the_bus(&self, question: &Question) -> Vec<Value> {
        let Question { search, from, to, limit } = question.clone();
        let ask = Ask::FindFrames(Box::new(search));
        let question = ArchiveQuestion { ask, from_utc: from.map(at), to_utc: to.map(at), limit };
        let key = Key::History(contract::Address::new("paranal", "callisto").unwrap());
        let answer: ArchiveAnswer = self.bus.ask(&key, &question, Duration::from_secs(10)).await.unwrap();
        rows(&serde_json::to_value(answer).unwrap())
    }

    async fn by_http(&self, question: &Question) -> Vec<Value> {
        let mut address = format!("{}/api/v1/telescopes/paranal/callisto/frames?", self.url);
        let calibration = question.search.with_calibration.then(|| ("with_calibration", "", "true".to_owned()));
        for (name, _, value) in question.conditions().into_iter().chain(calibration) {
            write!(address, "{name}=").unwrap();
            for byte in value.bytes() {
                match byte {
                    b'a'..=b'z' => address.push(byte.into()),
                    _ => write!(address, "%{byte:02X}").unwrap(),
                }
            }
            address.push('&');
        }
        let address = address.trim_end_matches('&');
        let response = reqwest::get(address).await.unwrap();
        let (status, body) = (response.status(), response.bytes().await.unwrap());
        assert!(status.is_success(), "{status} {}", String::from_utf8_lossy(&body));
        rows(&serde_json::from_slice(&body).unwrap())
    }

    fn by_command(&self, question: &Question) -> Vec<Value> {
        let config = self.folder.path().join("observatory.toml");
        let mut arguments = vec!["archive".to_owned(), "frames".to_owned(), "--json".to_owned()];
        arguments.push(format!("--config={}", config.display()));
        arguments.extend(question.conditions().into_iter().map(|(_, option, value)| format!("{option}={value}")));
        arguments.extend(question.search.with_calibration.then(|| "--with-calibration".to_owned()));
        let output = starmesh(arguments);
        assert!(output.success, "{}", output.err);
        output.json()
    }
}

fn rows(answer: &Value) -> Vec<Value> {
    answer["rows"].as_array().unwrap().iter().map(|row| row["found_frame"].clone()).collect()
}

/// Questions, and the numbers of the frames that are found.
fn questions() -> Vec<(Question, Vec<usize>)> {
    let of = |search: FrameSearch| Question { search, ..Question::default() };
    let all: Vec<usize> = (0..NAMES.len() + PLACES.len()).chain([90]).collect();
    let (lights, first_place) = (all[..all.len() - 1].to_vec(), NAMES.len());
    let text = |text: &str| Some(text.to_owned());
    let mut table = vec![
        (Question::default(), all.clone()),
        (of(FrameSearch { night: text("20261121"), ..Default::default() }), all.clone()),
        (of(FrameSearch { night: text("2026-11-21"), ..Default::default() }), all.clone()),
        (of(FrameSearch { night: text("20261122"), ..Default::default() }), vec![]),
        (of(FrameSearch { image_type: text("light"), ..Default::default() }), lights.clone()),
        (of(FrameSearch { image_type: text("LIGHT"), ..Default::default() }), lights.clone()),
        (of(FrameSearch { image_type: text("Light Frame"), ..Default::default() }), lights.clone()),
        (of(FrameSearch { image_type: text("light frame"), ..Default::default() }), vec![]),
        (of(FrameSearch { stars_min: Some(7), ..Default::default() }), vec![7, 8]),
        (of(FrameSearch { fwhm_max_arcsec: Some(3.6 * 10.0), ..Default::default() }), vec![9, 10]),
        (of(FrameSearch { fwhm_max_arcsec: Some(-1.0), ..Default::default() }), vec![]),
        (of(FrameSearch { object: text("wasp-12"), ..Default::default() }), vec![0]),
        (of(FrameSearch { object: text("WASP-12"), with_calibration: true, ..Default::default() }), vec![0, 90]),
        (Question { from: Some(60.0), to: Some(180.0), ..Default::default() }, vec![1, 2]),
        (Question { from: Some(180.0), to: Some(60.0), ..Default::default() }, vec![]),
        (Question { limit: Some(2), ..Default::default() }, vec![14, 90]),
        (Question { limit: Some(0), ..Default::default() }, vec![]),
    ];
    for (number, name) in NAMES.into_iter().enumerate() {
        table.push((of(FrameSearch { object: text(name), ..Default::default() }), vec![number]));
        table.push((of(FrameSearch { filter: text(name), ..Default::default() }), vec![number]));
        table.push((of(FrameSearch { camera: text(name), ..Default::default() }), vec![]));
    }
    let long = "x".repeat(10_000);
    for name in ["%", "_", "'", "\"", "WASP-12' OR '1'='1", "it", long.as_str(), "WASP-12\0"] {
        table.push((of(FrameSearch { object: text(name), ..Default::default() }), vec![]));
    }
    for (number, (ra_deg, dec_deg)) in (first_place..).zip(PLACES) {
        table
            .push((of(FrameSearch { covers: Some(SkyPlace { ra_deg, dec_deg }), ..Default::default() }), vec![number]));
    }
    for (ra_deg, dec_deg, found) in [
        (360.0, 0.0, vec![first_place]),
        (359.6, 0.0, vec![first_place]),
        (0.3, 10.0, vec![first_place + 1]),
        (359.7, -10.0, vec![first_place + 2]),
        (300.0, 90.0, vec![first_place + 3]),
        (0.0, -90.0, vec![first_place + 4]),
        (213.0, -89.6, vec![first_place + 4]),
        (180.0, 0.0, vec![]),
        (90.0, 89.0, vec![]),
    ] {
        table.push((of(FrameSearch { covers: Some(SkyPlace { ra_deg, dec_deg }), ..Default::default() }), found));
    }
    table
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_conditions_find_the_same_frames_wherever_they_are_asked() {
    let site = Site::start().await;
    for (question, expected) in questions() {
        let on_the_bus = site.on_the_bus(&question).await;
        let ids: Vec<&str> = on_the_bus.iter().map(|row| row["id"].as_str().unwrap()).collect();
        let expected: Vec<String> = expected.into_iter().map(|number| format!("f{number:02}")).collect();
        assert_eq!(ids, expected, "{question:.200?}");
        assert_eq!(site.by_http(&question).await, on_the_bus, "{question:.200?}");
        // No argument of a program has a NUL.
        if !question.search.object.as_ref().is_some_and(|object| object.contains('\0')) {
            assert_eq!(site.by_command(&question), on_the_bus, "{question:.200?}");
        }
    }
    let Site { nodes, folder, .. } = site;
    for node in nodes {
        node.stop().await;
    }
    drop(folder);
}

fn night(folder: &Path, arguments: &[&str]) -> Output {
    let config = format!("--config={}", folder.join("observatory.toml").display());
    starmesh(["night", "parquet"].into_iter().chain(arguments.iter().copied()).chain([config.as_str()]))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_night_that_cannot_be_written_as_parquet_is_named_and_the_others_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("observatory.toml"), PARANAL).unwrap();
    let config = config::parse(PARANAL, folder).unwrap();
    let alerts = NodeAlerts::new(Clock::machine_clock());
    let (database, writer) = Database::open(&config.archive.database, "callisto", alerts).unwrap();
    let golden: Frame = sample(include_str!("../../../common/contract/golden/v1/camera.frame.json"));
    for number in 0..3 {
        let started_utc = at(86_400.0 * f64::from(number));
        let frame = Frame { id: CommandId(format!("f{number}")), started_utc, ..golden.clone() };
        let (path, file) = (format!("/images/{number}.fits").into(), format!("{number}.fits"));
        let image = StoredImage { frame, file, bytes: 5760, stored: started_utc };
        database.commit(vec![Stored::Stored(Box::new(image), path)]).await.unwrap();
    }
    drop(database);
    writer.end().await;
    let out = folder.join("network");
    let out = format!("--out={}", out.display());
    let written = night(folder, &["--all", &out]);
    assert!(written.success, "{}{}", written.out, written.err);
    let nights: Vec<&str> = written.out.lines().skip(1).map(|line| line.split(' ').next().unwrap()).collect();
    assert_eq!(nights.len(), 3);
    // The file of the night in the middle is none.
    let part = format!("network/images/site=paranal/telescope=callisto/night={}/part-0.parquet", nights[1]);
    std::fs::write(folder.join(part), "no Parquet").unwrap();
    let again = night(folder, &["--all", &out]);
    assert!(
        !again.success && again.err.contains("1 of the nights could not be written") && again.err.contains(nights[1]),
        "{}",
        again.err
    );
    let lines: Vec<&str> = again.out.lines().skip(1).collect();
    assert_eq!(lines.len(), 3, "{}", again.out);
    assert!(lines[1].contains("part-0.parquet") && lines[2].contains("as before"), "{}", again.out);
    let alone = night(folder, &[nights[1], &out]);
    assert!(!alone.success && alone.err.contains("part-0.parquet"), "{}", alone.err);
    assert_eq!(json!(alone.out.lines().count()), 1);
}
