//! A database with rows of frames, files as the archive writes them, and what is answered about them.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use bus::Clock;
use config::Observatory;
use contract::CommandId;
use contract::archived_frame::{
    ArchiveRefusal, CardValue, FrameDetails, MOST_PIECE_BYTES, NotGiven, PictureWanted, ReportForm, ReportQuestion,
    Stretch,
};
use contract::device::camera::{Frame, Pixel, Purpose};
use node::NodeAlerts;
use units::Utc;

use super::file;
use super::found::Shelf;
use super::pixels::Decoder;
use super::report;
use crate::card::Card;
use crate::database::{Database, StoredImage, Write};
use crate::fits::{FitsFile, Shape};

const PLACE: &str = "[observatory]\nsite = \"paranal\"\ntelescope = \"callisto\"\nlatitude_deg = -24.6\n\
    longitude_deg = -70.4\nelevation_m = 2500\n";
const SIDE: u32 = 600;

struct Site {
    folder: tempfile::TempDir,
    config: Observatory,
    shelf: Shelf,
}

fn at(seconds: f64) -> Utc {
    Utc::from_seconds(1_795_230_000.0 + seconds)
}

fn soon() -> Instant {
    Instant::now() + Duration::from_secs(120)
}

fn count(x: u32, y: u32) -> u16 {
    (1000 + x * 3 + y * 7) as u16
}

impl Site {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let config = config::parse(PLACE, folder.path()).unwrap();
        fs::create_dir_all(config.folders.images.join("20261120")).unwrap();
        let shelf = Shelf::of(&config);
        Self { folder, config, shelf }
    }

    fn image(&self, file: &str) -> PathBuf {
        self.config.folders.images.join(file)
    }

    /// Rows of frames: id and file.
    async fn store(&self, rows: &[(&str, &str)]) {
        let alerts = NodeAlerts::new(Clock::machine_clock());
        let (database, writer) = Database::open(&self.config.archive.database, "callisto", alerts).unwrap();
        let stored = |(id, file): &(&str, &str)| {
            let path = self.image(file);
            let bytes = fs::metadata(&path).map_or(0, |metadata| metadata.len());
            let file = (*file).to_owned();
            Write::Stored(Box::new(StoredImage { frame: frame(id), file, bytes, stored: at(60.0) }), path)
        };
        database.commit(rows.iter().map(stored).collect()).await.unwrap();
        drop(database);
        writer.end().await;
    }

    fn find(&self, id: &str) -> Result<FrameDetails, ArchiveRefusal> {
        self.shelf.find(&CommandId(id.to_owned()), soon())
    }

    /// The reason for which the file of a frame is not opened.
    fn not_opened(&self, id: &str) -> NotGiven {
        let refusal = self.shelf.open(&self.find(id).unwrap()).unwrap_err();
        assert!(!refusal.detail.contains(&self.folder.path().display().to_string()), "{}", refusal.detail);
        refusal.reason
    }
}

fn frame(id: &str) -> Frame {
    Frame {
        purpose: Purpose { image_type: "Light Frame".to_owned(), night: "20261120".to_owned(), ..Purpose::default() },
        width_px: SIDE,
        height_px: SIDE,
        started_utc: at(0.0),
        exposure_s: 1.0,
        sha256: "ab".to_owned(),
        ..test_support::frame(id)
    }
}

/// A file as the archive writes it, plain or in compressed tiles.
fn write(path: &Path, is_compressed: bool) {
    let shape = Shape { pixel: Pixel::U16, width_px: SIDE, height_px: SIDE, planes: 1 };
    let mut file =
        if is_compressed { FitsFile::in_memory(path, &shape) } else { FitsFile::create(path, &shape) }.unwrap();
    file.set(&Card::new("OBJECT", "O'Neil / 1".into(), "the target")).unwrap();
    let pixels: Vec<u8> = (0..SIDE * SIDE).flat_map(|i| count(i % SIDE, i / SIDE).to_le_bytes()).collect();
    file.write_pixels(&shape, &pixels).unwrap();
    if is_compressed { file.compress_to(path, shape.pixel) } else { file.close() }.unwrap();
}

fn picture(longest_px: u32) -> PictureWanted {
    PictureWanted { longest_px, stretch: Stretch::Asinh, low_adu: None, high_adu: None, inverted: false }
}

#[tokio::test]
async fn a_plain_and_a_compressed_file_give_the_same_header_pixels_and_pictures() {
    let site = Site::new();
    let names = [("plain", "20261120/plain.fits"), ("tiled", "20261120/tiled.fits.fz")];
    for (id, name) in names {
        write(&site.image(name), id == "tiled");
    }
    site.store(&names).await;
    let mut pictures = Vec::new();
    for (id, name) in names {
        let details = site.find(id).unwrap();
        assert_eq!((details.frame.file.as_str(), details.frame.night.as_str()), (name, "20261120"));
        let header = file::header(&site.shelf.open(&details).unwrap(), None).unwrap();
        let mut cards = header.hdus.iter().flat_map(|hdu| &hdu.cards);
        let object = cards.find(|card| card.keyword == "OBJECT").unwrap();
        assert_eq!((&object.value, object.comment.as_str()), (&CardValue::Text("O'Neil / 1".into()), "the target"));

        let decoder = Decoder::default();
        let decoded = decoder.of(&site.shelf, &details).unwrap();
        let values = decoded.values((597, 10), (3, 2)).unwrap().values;
        let expected: Vec<Option<f32>> = [(597, 10), (598, 10), (599, 10), (597, 11), (598, 11), (599, 11)]
            .map(|(x, y)| Some(f32::from(count(x, y))))
            .into();
        assert_eq!(values, expected);
        let tile = decoded.tile((2, 2, 1)).unwrap();
        assert_eq!((tile.width_px, tile.height_px, tile.highest_z), (600 - 512, 256, 2));
        assert_eq!(tile.bytes.0[..2], count(512, 256).to_le_bytes());
        assert_eq!((tile.zero, tile.scale, tile.blank), (0.0, 1.0, None));
        let jpeg = decoder.picture(&site.shelf, &details, &picture(200)).unwrap();
        assert_eq!((jpeg.width_px, jpeg.height_px, &jpeg.bytes.0[..3]), (200, 200, &[0xFF, 0xD8, 0xFF][..]));
        pictures.push((decoder.picture(&site.shelf, &details, &picture(2048)).unwrap(), jpeg));
    }
    assert_eq!(pictures[0], pictures[1]);
    assert_eq!(pictures[0].0.width_px, SIDE, "a smaller frame keeps its size");
}

#[tokio::test]
async fn the_pieces_of_a_file_are_its_bytes_and_a_change_is_seen() {
    let site = Site::new();
    let path = site.image("20261120/f.fits");
    write(&path, false);
    site.store(&[("f", "20261120/f.fits")]).await;
    let details = site.find("f").unwrap();
    let piece = |from: u64, most: u32| file::piece(site.shelf.open(&details).unwrap(), from, most);
    let whole = fs::read(&path).unwrap();
    let (mut again, length) = (Vec::new(), whole.len() as u64);
    while (again.len() as u64) < length {
        let next = piece(again.len() as u64, u32::MAX).unwrap();
        assert!(next.bytes.0.len() <= MOST_PIECE_BYTES as usize && !next.bytes.0.is_empty());
        assert_eq!((next.name.as_str(), next.file_bytes, next.from), ("f.fits", length, again.len() as u64));
        again.extend(next.bytes.0);
    }
    assert_eq!(again, whole);
    assert_eq!(piece(length, 10).unwrap().bytes.0.len(), 0);
    assert_eq!(piece(0, 0).unwrap().file_bytes, length);
    for beyond in [length + 1, u64::MAX] {
        assert_eq!(piece(beyond, 1).unwrap_err().reason, NotGiven::OutOfRange);
    }
    let before = piece(0, 0).unwrap().version;
    std::thread::sleep(Duration::from_millis(20));
    fs::write(&path, &whole).unwrap();
    assert_ne!(piece(0, 0).unwrap().version, before);
}

#[tokio::test]
async fn no_row_and_no_link_leads_out_of_the_folder_of_images() {
    let site = Site::new();
    let secret = site.folder.path().join("secret.fits");
    write(&secret, false);
    let absolute = secret.display().to_string();
    let rows = [
        ("up", "../secret.fits"),
        ("deep", "20261120/../../secret.fits"),
        ("absolute", absolute.as_str()),
        ("none", ""),
    ];
    site.store(&rows).await;
    for (id, _) in rows {
        assert_eq!(site.not_opened(id), NotGiven::FileDamaged, "{id}");
    }
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(&secret, site.image("20261120/link.fits")).unwrap();
        std::os::unix::fs::symlink(site.folder.path(), site.image("linked")).unwrap();
        let links = [("link", "20261120/link.fits"), ("below", "linked/secret.fits")];
        site.store(&links).await;
        for (id, _) in links {
            assert_eq!(site.not_opened(id), NotGiven::FileDamaged, "{id}");
        }
    }
    for id in ["nobody", "", "../up", "up' OR '1'='1", "%"] {
        assert_eq!(site.find(id).unwrap_err().reason, NotGiven::Unknown, "{id}");
    }
    let other = config::parse(&PLACE.replace("callisto", "europa"), site.folder.path()).unwrap();
    let of_other = Shelf::of(&other).find(&CommandId("up".to_owned()), soon());
    assert_eq!(of_other.unwrap_err().reason, NotGiven::Unknown, "another telescope has no such frame");
}

#[tokio::test]
async fn a_file_that_is_away_cut_or_no_fits_is_refused_with_its_reason() {
    let site = Site::new();
    let whole = site.folder.path().join("whole.fits");
    write(&whole, false);
    let bytes = fs::read(&whole).unwrap();
    let cases: [(&str, &[u8]); 4] =
        [("cut", &bytes[..bytes.len() / 2]), ("head", &bytes[..1000]), ("empty", b""), ("noise", b"no FITS at all")];
    let files: Vec<(&str, String)> = cases.iter().map(|(id, _)| (*id, format!("20261120/{id}.fits"))).collect();
    for ((_, bytes), (_, file)) in cases.iter().zip(&files) {
        fs::write(site.image(file), bytes).unwrap();
    }
    fs::create_dir(site.image("20261120/folder.fits")).unwrap();
    let mut rows: Vec<(&str, &str)> = files.iter().map(|(id, file)| (*id, file.as_str())).collect();
    rows.extend([
        ("away", "20261120/away.fits"),
        ("folder", "20261120/folder.fits"),
        ("under", "20261120/cut.fits/x.fits"),
    ]);
    site.store(&rows).await;
    let decoder = Decoder::default();
    for (id, _) in &files {
        let details = site.find(id).unwrap();
        let refusal = decoder.of(&site.shelf, &details).unwrap_err();
        assert_eq!(refusal.reason, NotGiven::FileDamaged, "{id}: {}", refusal.detail);
        assert!(!refusal.detail.contains(&site.folder.path().display().to_string()), "{}", refusal.detail);
        let refusal = decoder.picture(&site.shelf, &details, &picture(100)).unwrap_err();
        assert_eq!(refusal.reason, NotGiven::FileDamaged, "{id}: {}", refusal.detail);
        let header = file::header(&site.shelf.open(&details).unwrap(), None);
        assert_eq!(header.is_ok(), *id == "cut", "{id}: a header that is whole is given");
    }
    assert_eq!(site.not_opened("away"), NotGiven::FileAway);
    assert_eq!(site.not_opened("folder"), NotGiven::FileDamaged);
    assert_eq!(site.not_opened("under"), NotGiven::FileAway);
}

#[tokio::test]
async fn what_a_frame_does_not_have_is_out_of_range() {
    let site = Site::new();
    write(&site.image("20261120/f.fits"), false);
    site.store(&[("f", "20261120/f.fits")]).await;
    let details = site.find("f").unwrap();
    let decoder = Decoder::default();
    let decoded = decoder.of(&site.shelf, &details).unwrap();
    let again = decoder.of(&site.shelf, &details).unwrap();
    assert!(std::sync::Arc::ptr_eq(&decoded, &again), "a frame that was decoded stays in memory for a while");
    for (from, size) in [
        ((0, 0), (0, 1)),
        ((0, 0), (601, 1)),
        ((599, 599), (2, 1)),
        ((u32::MAX, 0), (u32::MAX, 1)),
        ((0, 0), (600, 600)),
    ] {
        assert_eq!(decoded.values(from, size).unwrap_err().reason, NotGiven::OutOfRange, "{from:?} {size:?}");
    }
    for place in [(3, 0, 0), (2, 3, 0), (0, 0, 1), (u32::MAX, u32::MAX, u32::MAX)] {
        assert_eq!(decoded.tile(place).unwrap_err().reason, NotGiven::OutOfRange, "{place:?}");
    }
    let limits = |low, high| PictureWanted { low_adu: Some(low), high_adu: Some(high), ..picture(100) };
    for wanted in [picture(0), picture(15), picture(2049), picture(u32::MAX), limits(5.0, 5.0), limits(1e300, 2e300)] {
        assert_eq!(
            decoder.picture(&site.shelf, &details, &wanted).unwrap_err().reason,
            NotGiven::OutOfRange,
            "{wanted:?}"
        );
    }
    let opened = || site.shelf.open(&details).unwrap();
    for hdu in [0, 2, u32::MAX] {
        assert_eq!(file::header(&opened(), Some(hdu)).unwrap_err().reason, NotGiven::OutOfRange);
    }
    assert_eq!(file::header(&opened(), Some(1)).unwrap().hdus.len(), 1);
}

#[tokio::test]
async fn a_night_with_frames_has_a_report_and_another_one_has_none() {
    let site = Site::new();
    write(&site.image("20261120/f.fits"), false);
    site.store(&[("f", "20261120/f.fits")]).await;
    let night = crate::night::Night::at(at(0.0), &site.config.place).date.to_string();
    let make = |night: &str, form| {
        let question = ReportQuestion { night: night.to_owned(), form };
        report::make(&site.config, &site.shelf, &question, at(3600.0), soon())
    };
    let json: serde_json::Value = serde_json::from_str(&make(&night, ReportForm::Json).unwrap()).unwrap();
    assert_eq!((json["telescope"].as_str(), json["night"].as_str()), (Some("callisto"), Some(night.as_str())));
    assert!(make(&night, ReportForm::Html).unwrap().starts_with("<!doctype html>"));
    assert_eq!(make("20200101", ReportForm::Json).unwrap_err().reason, NotGiven::Unknown);
    for wrong in ["", "2026", "20261399", "../../etc", "2026112\u{660}"] {
        assert_eq!(make(wrong, ReportForm::Json).unwrap_err().reason, NotGiven::Malformed, "{wrong}");
    }
}
