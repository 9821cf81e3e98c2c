//! An archive node on a real bus: frames from a spool that fails now and then, telemetry, questions, a restart.
mod answers_about_a_frame;
mod completes_again;
mod what_goes_wrong;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::http::{HeaderMap, Response, StatusCode};
use axum::routing::get;
use bus::{AskError, Bus, Catch, Clock, Quality, Service, Subscriber};
use config::header::HeaderTable;
use contract::archive::{ArchiveAnswer, ArchiveQuestion, ArchiveRow, Ask, Stored};
use contract::device::camera::{self, Frame, Pixel, Purpose};
use contract::node::{DiaryLine, Level};
use contract::{
    Accepted, Address, Command, CommandId, Device, DeviceState, Key, Kind, Link, NodeTopic, Payload, Reading, Reason,
    Refusal, Reply, Role,
};
use futures_util::StreamExt as _;
use node::Node;
use node_archive::database::{Database, Write};
use node_archive::fits::{FitsFile, Shape};
use node_archive::stored_header::Header;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};
use test_support::{LIMIT, PARANAL, RunningNode, block, join, private_bus, serve, until};
use units::Utc;

const SHAPE: Shape = Shape { pixel: Pixel::U16, width_px: 64, height_px: 32, planes: 1 };

fn pixels(seed: u16) -> Vec<u8> {
    (0..64 * 32u16).flat_map(|i| (i.wrapping_mul(31).wrapping_add(seed)).to_le_bytes()).collect()
}

fn address() -> Address {
    Address::new("paranal", "callisto").unwrap()
}

fn camera() -> Device {
    address().device(Kind::Camera, &"andor".parse().unwrap())
}

fn mount() -> Device {
    address().device(Kind::Telescope, &"mount".parse().unwrap())
}

/// The side of the device node: a spool over HTTP, and a camera that is asked to release.
struct Spool {
    bus: Bus,
    url: String,
    requests: Arc<AtomicUsize>,
    released: Arc<Mutex<Vec<Command<camera::Command>>>>,
    frames: bus::Publisher<Frame>,
    /// Commands are answered by the program that publishes the state.
    _state: bus::Publisher<DeviceState<camera::Fields>>,
    _commands: Service,
}

impl Spool {
    /// The first request breaks half way; the first release is refused for now.
    async fn start(bus: Bus) -> Self {
        let requests = Arc::new(AtomicUsize::new(0));
        let counted = requests.clone();
        let answers = move |headers: HeaderMap| {
            let count = counted.fetch_add(1, Ordering::SeqCst);
            async move { answer(count, &headers) }
        };
        let url = format!("http://{}/frame?token=t", serve(axum::Router::new().route("/frame", get(answers))).await);
        let released: Arc<Mutex<Vec<Command<camera::Command>>>> = Arc::default();
        let received = released.clone();
        let key = Key::Command(camera());
        let commands = bus.serve(&key, move |command: Result<Command<camera::Command>, String>| {
            let command = command.unwrap();
            let id = command.id.clone();
            let mut received = received.lock().unwrap();
            received.push(command);
            let reply = match received.len() {
                1 => Reply::Refusal(Refusal { id, reason: Reason::Busy, detail: "in a moment".to_owned() }),
                _ => Reply::Accepted(Accepted { id, token: None, not_written: None }),
            };
            async move { reply }
        });
        let commands = commands.await.unwrap();
        let frames = bus.publisher(&Key::Frame(camera())).await.unwrap();
        let state = bus.publisher(&Key::State(camera())).await.unwrap();
        let (fields, readings) = (camera::Fields::default(), Default::default());
        let (link, period_s) = (Link::Connecting, 1.0);
        let payload = DeviceState { link, busy: false, period_s, poll_s: None, last_command: None, fields, readings };
        state.put(payload).await.unwrap();
        Self { bus, url, requests, released, frames, _state: state, _commands: commands }
    }

    fn frame(&self, id: &str, started_utc: Utc) -> Frame {
        let pixels = pixels(7);
        let reading = |value: serde_json::Value| -> Reading {
            serde_json::from_value(serde_json::json!({ "value": value, "at_utc": started_utc })).unwrap()
        };
        Frame {
            id: CommandId(id.to_owned()),
            camera: "andor".to_owned(),
            purpose: Purpose {
                action: "object".to_owned(),
                object: Some("../Bar\u{e9}/O'Neil".to_owned()),
                image_type: "Light Frame".to_owned(),
                filter: Some("I+z".to_owned()),
                ra_deg: Some(84.05),
                dec_deg: Some(-69.1),
                night: "20261120".to_owned(),
                paired: BTreeMap::from([("Telescope".to_owned(), "mount".to_owned())]),
                ..Purpose::default()
            },
            width_px: SHAPE.width_px,
            height_px: SHAPE.height_px,
            planes: 1,
            pixel: Pixel::U16,
            bin: 2,
            origin_px: [0, 0],
            started_utc,
            exposure_s: 0.5,
            url: self.url.clone(),
            bytes: pixels.len() as u64,
            sha256: Sha256::digest(&pixels).iter().map(|byte| format!("{byte:02x}")).collect(),
            readings: BTreeMap::from([
                ("BinX".to_owned(), reading(2.into())),
                ("PixelSizeX".to_owned(), reading(13.5.into())),
            ]),
        }
    }

    fn releases(&self, id: &str) -> usize {
        let frame = CommandId(id.to_owned());
        let released = self.released.lock().unwrap();
        released
            .iter()
            .filter(|c| matches!(&c.action, camera::Command::Release { frame: f, .. } if *f == frame))
            .count()
    }
}

fn answer(count: usize, headers: &HeaderMap) -> Response<Body> {
    let pixels = pixels(7);
    let range = headers.get("range").and_then(|range| range.to_str().ok());
    let start: usize =
        range.map_or(0, |range| range.trim_start_matches("bytes=").trim_end_matches('-').parse().unwrap());
    let mut answer = Response::builder();
    if range.is_some() {
        let range = format!("bytes {start}-{}/{}", pixels.len() - 1, pixels.len());
        answer = answer.status(StatusCode::PARTIAL_CONTENT).header("content-range", range);
    }
    let body = match count {
        0 => {
            let half = Bytes::copy_from_slice(&pixels[..1000]);
            // The half is on its way before the connection breaks.
            let broken = futures_util::stream::once(async move { Ok(half) }).chain(futures_util::stream::once(async {
                tokio::time::sleep(Duration::from_millis(100)).await;
                Err(std::io::Error::other("cable"))
            }));
            Body::from_stream(broken)
        }
        _ => Body::from(pixels[start..].to_vec()),
    };
    answer.body(body).unwrap()
}

fn observatory(folder: &Path) -> config::Observatory {
    let mount = block("telescope", "mount", "localhost:1", "equatorial_system = \"j2000\"");
    let camera = block("camera", "andor", "localhost:1", "");
    config::parse(&format!("{PARANAL}{mount}{camera}"), folder).unwrap()
}

/// The session of the device nodes, and one of an archive.
async fn two_buses() -> (Bus, Bus) {
    let first = private_bus(Clock::machine_clock()).await;
    let second = join(&first).await;
    (first, second)
}

fn archive(folder: &Path, bus: Bus) -> Node {
    let table: HeaderTable = "header,dtype,fixed,device_type,device_command,comment
DATE,str,false,astra,,written
XBINNING,int,true,Camera,BinX,binning
XPIXSZ,float,true,astra,,[um] pixel
CAM-DNAM,str,true,Camera,Name,camera
ALTITUDE,float,false,Telescope,Altitude,[deg] altitude
AZIMUTH,float,false,Telescope,Azimuth,[deg] azimuth
TRACKING,bool,false,Telescope,Tracking,tracks
RA,float,false,Telescope,RightAscension,[deg] RA
DEC,float,false,Telescope,Declination,[deg] Dec
AIRMASS,float,false,astra,,airmass
BJD-OBS,float,false,astra,,[d] BJD
HUMIDITY,float,false,ObservingConditions,Humidity,not paired
"
    .parse()
    .unwrap();
    Node::new(Role::Archive, "main".parse().unwrap(), observatory(folder), table, bus)
}

fn run(node: Node) -> RunningNode {
    RunningNode::work(node, node_archive::run)
}

/// Where the mount points at an instant: 0.01 deg/s up, and over north.
fn altitude_at(at: Utc, start: Utc) -> f64 {
    40.0 + 0.01 * at.seconds_since(start)
}

fn state_of_mount(readings: serde_json::Value) -> DeviceState<serde_json::Value> {
    DeviceState {
        link: Link::Connected,
        busy: false,
        period_s: 0.1,
        poll_s: None,
        last_command: None,
        fields: serde_json::Value::Null,
        readings: serde_json::from_value(readings).unwrap(),
    }
}

/// Polls the mount every 100 ms, for ever, and notes when it did.
async fn poll_mount(bus: Bus, start: Utc, polled: Arc<Mutex<Vec<Utc>>>) {
    let publisher = bus.publisher_as(&Key::State(mount()), Quality::State { cache: 600 }).await.unwrap();
    loop {
        let at = bus.clock().utc();
        let turned = (359.95 + 0.1 * at.seconds_since(start)).rem_euclid(360.0);
        let readings = serde_json::json!({
            "Altitude": { "value": altitude_at(at, start), "unit": "deg", "at_utc": at },
            "Azimuth": { "value": turned, "unit": "deg", "at_utc": at },
            "Tracking": { "value": true, "at_utc": at },
            "RightAscension": { "value": 1.0, "unit": "h", "at_utc": at },
            "Declination": { "no_data": "timeout", "at_utc": at },
        });
        publisher.put(state_of_mount(readings)).await.unwrap();
        polled.lock().unwrap().push(at);
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

async fn recv_stored(stored: &Subscriber<Stored>, complete: bool) -> Stored {
    let wait = async {
        loop {
            let sample = stored.recv().await.sample.body;
            if sample.header_complete == complete {
                return sample;
            }
        }
    };
    tokio::time::timeout(LIMIT, wait).await.unwrap()
}

async fn ask(bus: &Bus, ask: Ask) -> Vec<ArchiveRow> {
    let question = ArchiveQuestion { ask, from_utc: None, to_utc: None, limit: None };
    let answer: ArchiveAnswer = until_answered(bus, &Key::History(address()), &question).await;
    answer.rows
}

/// Asks again while the outcome is unknown: on a busy machine an answer may come too late to count.
pub async fn until_answered<Q: Payload, A: DeserializeOwned>(bus: &Bus, key: &Key, question: &Q) -> A {
    let asked = async {
        loop {
            match bus.ask(key, question, Duration::from_secs(10)).await {
                Err(AskError::Unknown { .. }) => tokio::time::sleep(Duration::from_millis(100)).await,
                answered => return answered.unwrap(),
            }
        }
    };
    tokio::time::timeout(LIMIT, asked).await.unwrap()
}

fn header_of(file: &Path) -> Header {
    Header::read(file).unwrap().unwrap()
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut found = Vec::new();
    for entry in entries {
        let path = entry.unwrap().path();
        // The journal of headers, which the next archive uses, the lock, and reports of nights, which depend on the time of day.
        let name = path.file_name().unwrap();
        if name == "spare.header" || name == "reports" || path.extension().is_some_and(|ending| ending == "lock") {
            continue;
        }
        if path.is_dir() { found.extend(files(&path)) } else { found.push(path) }
    }
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_is_stored_once_released_completed_and_found_again_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let images = folder.path().join("images");
    std::fs::create_dir_all(images.join(".part/paranal-callisto")).unwrap();
    std::fs::write(images.join(".part/paranal-callisto/left-by-a-kill.fits"), "half").unwrap();
    let (device_bus, archive_bus) = two_buses().await;
    let spool = Spool::start(device_bus.clone()).await;
    let stored = spool.bus.subscribe::<Stored>(&Key::Stored(address()).to_string(), Catch::All, 100).await.unwrap();
    let diary = Key::Node(address(), Role::Device, "pc".parse().unwrap(), NodeTopic::Diary);
    let diary = spool.bus.publisher(&diary).await.unwrap();
    let start = device_bus.clock().utc();
    let polled = Arc::default();
    let polling = tokio::spawn(poll_mount(device_bus.clone(), start, Arc::clone(&polled)));

    let running = run(archive(folder.path(), archive_bus));
    tokio::time::sleep(Duration::from_secs(1)).await;
    let line = DiaryLine {
        level: Level::Warn,
        target: "t".to_owned(),
        message: "it's cold".to_owned(),
        fields: BTreeMap::from([("ccd_c".to_owned(), "-60".to_owned())]),
    };
    diary.put(line).await.unwrap();

    let taken = device_bus.clock().utc();
    spool.frames.put(spool.frame("frame-1", taken)).await.unwrap();
    let first = recv_stored(&stored, false).await;
    assert_eq!(first.frame.0, "frame-1");
    until("released", || spool.releases("frame-1") >= 2).await;
    assert!(spool.requests.load(Ordering::SeqCst) >= 2, "the broken connection was taken up");
    let second = recv_stored(&stored, true).await;
    assert_eq!(second.file, first.file);

    let all = files(&images);
    assert_eq!(all.len(), 1, "{all:?}");
    let name = all[0].file_name().unwrap().to_str().unwrap();
    let started = taken.strftime("%Y%m%dT%H%M%S-%3f");
    assert_eq!(name, format!("{started}_andor_light_Bar-ONeil_I+z_500ms.fits"));
    assert_eq!(images.join(&first.file), all[0]);
    assert_eq!(std::fs::metadata(&all[0]).unwrap().len(), first.bytes);
    let header = Header::read(&all[0]).unwrap().unwrap();
    let number = |keyword: &str| -> f64 { header.value(keyword).unwrap().parse().unwrap() };
    assert_eq!(header.value("OBJECT").unwrap(), "../Bar?/O'Neil");
    assert_eq!(header.value("FRAMEID").unwrap(), "frame-1");
    assert_eq!((number("XPIXSZ"), number("XBINNING"), number("RA"), number("DEC")), (27.0, 2.0, 84.05, -69.1));
    assert!((number("ALTITUDE") - altitude_at(taken, start)).abs() < 1e-6);
    let azimuth = 359.95 + 0.1 * taken.seconds_since(start);
    assert!((number("AZIMUTH") - azimuth.rem_euclid(360.0)).abs() < 1e-6, "{} {azimuth}", number("AZIMUTH"));
    assert_eq!(header.value("TRACKING").unwrap(), "T");
    assert!(number("BJD-OBS") > 2_461_000.0 && header.value("HUMIDITY").is_none());
    let mut fits = fitsio::FitsFile::open(&all[0]).unwrap();
    let image: Vec<u16> = fits.primary_hdu().unwrap().read_image(&mut fits).unwrap();
    assert_eq!(image.iter().flat_map(|pixel| pixel.to_le_bytes()).collect::<Vec<u8>>(), pixels(7));

    // Announced again: not stored again, but released again.
    let releases = spool.releases("frame-1");
    spool.frames.put(spool.frame("frame-1", taken)).await.unwrap();
    until("released again", || spool.releases("frame-1") > releases).await;
    assert_eq!(files(&images).len(), 1);

    let altitude =
        || Ask::Readings { kind: Kind::Telescope, device: "mount".to_owned(), property: "Altitude".to_owned() };
    let asked = async {
        loop {
            let rows = ask(&spool.bus, altitude()).await;
            if rows.len() > 10 {
                return rows;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    let rows = tokio::time::timeout(LIMIT, asked).await.unwrap();
    for row in &rows {
        let ArchiveRow::Reading { at_utc, value: Some(value) } = row else { panic!("{row:?}") };
        assert!((value.number().unwrap() - altitude_at(*at_utc, start)).abs() < 1e-9);
    }
    let log = ask(&spool.bus, Ask::Log).await;
    let is_it = |row: &ArchiveRow| matches!(row, ArchiveRow::Log { message, node, .. } if message == "it's cold ccd_c=-60" && node == "device/pc");
    assert!(log.iter().any(is_it), "{log:?}");

    // An archive that was away misses nothing, and has the count of what it stored.
    running.stop().await;
    let before = polled.lock().unwrap().len();
    until("the mount was polled meanwhile", || polled.lock().unwrap().len() > before + 20).await;
    let restarted = device_bus.clock().utc();
    let running = run(archive(folder.path(), join(&device_bus).await));
    let releases = spool.releases("frame-1");
    until("released after the restart", || spool.releases("frame-1") > releases).await;
    assert_eq!(files(&images).len(), 1);
    let told = Mutex::new((0, Vec::new()));
    let caught_up = async {
        loop {
            let rows = ask(&spool.bus, altitude()).await;
            let times: Vec<Utc> = rows
                .iter()
                .map(|row| match row {
                    ArchiveRow::Reading { at_utc, .. } => *at_utc,
                    other => panic!("{other:?}"),
                })
                .collect();
            let is_stored = |at: &Utc| times.iter().any(|stored| stored.seconds_since(*at).abs() < 1e-3);
            let within = |at: &Utc| times.first() < Some(at) && Some(at) < times.last();
            let holes: Vec<Utc> =
                polled.lock().unwrap().iter().filter(|at| within(at) && !is_stored(at)).copied().collect();
            let goes_on = times.last() > Some(&restarted);
            if goes_on && holes.is_empty() {
                return;
            }
            *told.lock().unwrap() = (times.len(), holes);
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    let caught_up = tokio::time::timeout(LIMIT, caught_up).await;
    assert!(caught_up.is_ok(), "readings, and holes in them: {:?}", told.lock().unwrap());
    polling.abort();
    let frames = ask(&spool.bus, Ask::Frames).await;
    assert!(matches!(&frames[..], [ArchiveRow::Frame { header_complete: true, .. }]), "{frames:?}");
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_of_one_moment_have_files_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let images = folder.path().join("images");
    let (device_bus, archive_bus) = two_buses().await;
    let spool = Spool::start(device_bus.clone()).await;
    let mut node = archive(folder.path(), archive_bus);
    // A name that two frames share, and which are stored at the same time.
    let mut config = (*node.config).clone();
    config.archive.filename.insert("object".to_owned(), "{sequence_counter}".to_owned());
    node.config = config.into();
    let running = run(node);
    tokio::time::sleep(Duration::from_millis(500)).await;
    let ids: Vec<String> = (10..70).map(|index| format!("frame-{index}")).collect();
    for (id, index) in ids.iter().zip(0..) {
        let mut frame = spool.frame(id, device_bus.clock().utc());
        frame.purpose.sequence = index / 2;
        spool.frames.put(frame).await.unwrap();
    }
    until("all are released", || ids.iter().all(|id| spool.releases(id) >= 1)).await;
    let mut found: Vec<String> =
        files(&images).iter().map(|file| Header::read(file).unwrap().unwrap().value("FRAMEID").unwrap()).collect();
    found.sort();
    assert_eq!(found, ids);
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_that_was_named_just_before_a_kill_is_adopted() {
    let folder = tempfile::tempdir().unwrap();
    let images = folder.path().join("images");
    std::fs::create_dir_all(images.join("n")).unwrap();
    let (device_bus, archive_bus) = two_buses().await;
    let spool = Spool::start(device_bus.clone()).await;
    let node = archive(folder.path(), archive_bus);
    let mut fits = FitsFile::create(&images.join("n/a.fits"), &SHAPE).unwrap();
    fits.set(&node_archive::card::Card::new("FRAMEID", "frame-2".into(), "id")).unwrap();
    fits.reserve(60).unwrap();
    fits.write_pixels(&SHAPE, &pixels(7)).unwrap();
    fits.write_checksums().unwrap();
    fits.close().unwrap();
    let (database, writer) = Database::open(&node.config.archive.database, "callisto", node.alerts.clone()).unwrap();
    let named = |id: &str, file: &str| Write::Writing { frame: CommandId(id.to_owned()), file: file.to_owned() };
    // frame-3 was to be named, but the kill came first.
    database.commit(vec![named("frame-2", "n/a.fits"), named("frame-3", "n/b.fits")]).await.unwrap();
    drop(database);
    writer.end().await;

    let stored = spool.bus.subscribe::<Stored>(&Key::Stored(address()).to_string(), Catch::All, 100).await.unwrap();
    let running = run(node);
    tokio::time::sleep(Duration::from_millis(500)).await;
    let taken = device_bus.clock().utc();
    spool.frames.put(spool.frame("frame-2", taken)).await.unwrap();
    assert_eq!(recv_stored(&stored, false).await.file, "n/a.fits");
    assert_eq!(spool.requests.load(Ordering::SeqCst), 0, "it was not fetched");
    spool.frames.put(spool.frame("frame-3", taken)).await.unwrap();
    let written = recv_stored(&stored, false).await.file;
    assert!(written.starts_with("20261120/"), "{written}");
    // No telemetry comes; the headers are completed without it, and their history contains a line about it.
    for _ in 0..2 {
        let complete = recv_stored(&stored, true).await;
        let header = Header::read(&images.join(&complete.file)).unwrap().unwrap();
        assert!(header.value("ALTITUDE").is_none() && header.value("AIRMASS").is_some());
        assert!(
            header.cards().any(|card| card.starts_with("HISTORY not known at DATE-OBS:") && card.contains("ALTITUDE"))
        );
    }
    assert_eq!(files(&images).len(), 2);
    running.stop().await;
}
