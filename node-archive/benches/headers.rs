//! 100 headers of 2048 x 2048 px completed: real files, a real database, the same code as the pass (figures, not a test). With
//! `BENCH_FOLDER` the frames stay there as they were before, for `tests/bench/headers.py`.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a bench ends at the first surprise")]

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use bus::Clock;
use config::header::HeaderTable;
use contract::device::camera::{Frame, Pixel, Purpose};
use contract::{CommandId, Kind, Scalar};
use node::NodeAlerts;
use node_archive::completion::Completer;
use node_archive::database::{Database, StoredImage, Write};
use node_archive::fits::{FitsFile, Shape};
use node_archive::header::{HeaderFacts, base, room};
use node_archive::pass::{Site, complete_image};
use node_archive::reader::Reader;
use node_archive::telemetry::Newest;
use units::Utc;

const FRAMES: u32 = 100;
const SHAPE: Shape = Shape { pixel: Pixel::U16, width_px: 2048, height_px: 2048, planes: 1 };
const KINDS: [Kind; 7] = [
    Kind::Telescope,
    Kind::Camera,
    Kind::FilterWheel,
    Kind::Focuser,
    Kind::Dome,
    Kind::SafetyMonitor,
    Kind::ObservingConditions,
];

fn observatory(folder: &Path) -> config::Observatory {
    let mut text = "[observatory]\nsite = \"bench\"\ntelescope = \"alpha\"\nlatitude_deg = -24.6\n\
                    longitude_deg = -70.4\nelevation_m = 2600\n"
        .to_owned();
    for kind in KINDS {
        text.push_str(&format!("[[{kind}]]\nname = \"{kind}\"\nserver = \"127.0.0.1:1\"\n"));
    }
    config::parse(&text, folder).unwrap()
}

fn frame(index: u32, start: Utc) -> Frame {
    let purpose = Purpose {
        action: "object".to_owned(),
        object: Some("Bench".to_owned()),
        image_type: "Light Frame".to_owned(),
        ra_deg: Some(80.0),
        dec_deg: Some(-20.0),
        night: "20261121".to_owned(),
        sequence: index,
        paired: KINDS.iter().map(|kind| (kind.ascom().to_owned(), kind.word().to_owned())).collect(),
        ..Purpose::default()
    };
    Frame {
        id: CommandId::fresh(),
        camera: "camera".to_owned(),
        purpose,
        width_px: 2048,
        height_px: 2048,
        planes: 1,
        pixel: Pixel::U16,
        bin: 1,
        origin_px: [0, 0],
        started_utc: start.plus_seconds(2.5 + 10.0 * f64::from(index)),
        exposure_s: 5.0,
        url: String::new(),
        bytes: 2048 * 2048 * 2,
        sha256: String::new(),
        readings: BTreeMap::new(),
    }
}

#[tokio::main]
async fn main() {
    let folder = tempfile::tempdir().unwrap();
    let (config, table) = (observatory(folder.path()), HeaderTable::default());
    let start: Utc = "2026-11-21T02:00:00Z".parse().unwrap();
    let path = folder.path().join("archive.db");
    let (database, _writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    for kind in KINDS {
        let device = config.address().device(kind, &kind.word().parse().unwrap());
        for property in table.properties(kind, false) {
            for poll in 0..=(10 * FRAMES / 5 + 2) {
                let at = start.plus_seconds(5.0 * f64::from(poll));
                let value = Ok(Scalar::Float(f64::from(poll) * 0.01));
                let row = Write::Reading { device: device.clone(), property: property.clone(), value, at };
                database.put(row).await.unwrap();
            }
        }
    }
    let pixels = vec![7u8; SHAPE.bytes().unwrap()];
    std::fs::create_dir_all(config.folders.images.join(".part")).unwrap();
    let mut images = Vec::new();
    for index in 0..FRAMES {
        let frame = frame(index, start);
        let path = config.folders.images.join(format!("{index}.fits"));
        let known = HeaderFacts {
            frame: &frame,
            place: &config.place,
            written: start,
            sensor: Default::default(),
            newest: &|_, _| None,
        };
        let mut file = FitsFile::create(&path, &SHAPE).unwrap();
        for card in base(&table, &known) {
            file.set(&card).unwrap();
        }
        file.reserve(room(&table)).unwrap();
        file.write_pixels(&SHAPE, &pixels).unwrap();
        file.write_checksums().unwrap();
        file.close().unwrap();
        // As the archive does before it names a file.
        std::fs::File::open(&path).unwrap().sync_all().unwrap();
        let file = format!("{index}.fits");
        images.push(StoredImage { frame, file, bytes: 8_388_608, stored: start });
    }
    let last = images.last().cloned().unwrap();
    database.commit(vec![Write::Stored(Box::new(last), Default::default())]).await.unwrap();

    if let Some(stored) = std::env::var_os("BENCH_FOLDER") {
        for image in images.iter().take(20) {
            std::fs::copy(image.path(&config.folders.images), Path::new(&stored).join(&image.file)).unwrap();
        }
    }
    let (reader, newest) = (Reader::open(&path, "callisto").unwrap(), Newest::default());
    let completer = Completer::new(&config.folders.images);
    let site = Site { config: &config, table: &table, newest: &newest, speed: 1.0, completer: &completer };
    let began = Instant::now();
    let mut added = 0;
    for image in &images {
        added += complete_image(&site, &reader, image, None, true).unwrap().map_or(0, |plan| plan.cards.len());
    }
    let each_ms = began.elapsed().as_secs_f64() * 1000.0 / f64::from(FRAMES);
    println!("headers: {each_ms:.2} ms each, {} keywords each", added / FRAMES as usize);
}
