//! Headers that are completed more than once, and facts that come late.

use std::path::PathBuf;

use bus::Clock;
use contract::Address;
use contract::device::camera::{Pixel, Purpose};
use contract::observatory::{Correction, FrameWcs, Unsolved, UnsolvedClass};
use node::NodeAlerts;
use test_support::{PARANAL, block};
use units::Utc;

use super::*;
use crate::completion::journal_of;
use crate::database::StoredCorrection;
use crate::fits::{FitsFile, Shape};
use crate::folder::PART_FOLDER;
use crate::header::{HeaderFacts, base, room};

const SHAPE: Shape = Shape { pixel: Pixel::U16, width_px: 4, height_px: 2, planes: 1 };

/// A frame that is stored, whose mount has an altitude and no side of its pier, and whose azimuth nobody polled.
struct Stage {
    _folder: tempfile::TempDir,
    config: Observatory,
    table: HeaderTable,
    image: StoredImage,
}

impl Stage {
    async fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let blocks = block("camera", "andor", "localhost:1", "") + &block("telescope", "mount", "localhost:1", "");
        let config = config::parse(&(PARANAL.to_owned() + &blocks), folder.path()).unwrap();
        let rows = ["Altitude", "SideOfPier", "Azimuth"].map(|property| {
            let keyword = property.to_ascii_uppercase().chars().take(8).collect::<String>();
            format!("{keyword},float,false,Telescope,{property},\n")
        });
        let table = format!("header,dtype,fixed,device_type,device_command,comment\n{}", rows.concat());
        let table: HeaderTable = table.parse().unwrap();
        let started_utc: Utc = "2026-11-21T03:00:00Z".parse().unwrap();
        let purpose = Purpose {
            action: "object".to_owned(),
            image_type: "Light Frame".to_owned(),
            paired: [("Telescope".to_owned(), "mount".to_owned())].into(),
            ..Purpose::default()
        };
        let frame = Frame { purpose, started_utc, ..test_support::frame("frame-1") };
        std::fs::create_dir_all(config.folders.images.join(PART_FOLDER)).unwrap();
        let (place, sensor) = (&config.place, Default::default());
        let known = HeaderFacts { frame: &frame, place, written: started_utc, sensor, newest: &|_, _| None };
        let mut fits = FitsFile::create(&config.folders.images.join("a.fits"), &SHAPE).unwrap();
        for card in base(&table, &known) {
            fits.set(&card).unwrap();
        }
        fits.reserve(room(&table)).unwrap();
        fits.write_pixels(&SHAPE, &[7; 16]).unwrap();
        fits.write_checksums().unwrap();
        fits.close().unwrap();
        let image = StoredImage { frame, file: "a.fits".to_owned(), bytes: 5760, stored: started_utc };
        let stage = Self { _folder: folder, config, table, image };
        let none = || Err("not implemented".to_owned());
        let polled = [-1.0, 1.0].map(|second| {
            [stage.polled("Altitude", second, Ok(Scalar::Float(50.0))), stage.polled("SideOfPier", second, none())]
        });
        stage.write(polled.into_iter().flatten().collect()).await;
        stage
    }

    /// A poll of the mount, so many seconds after the begin of the exposure.
    fn polled(&self, property: &str, second: f64, value: Result<Scalar, String>) -> Write {
        let device = Address::new("paranal", "callisto").unwrap().device(Kind::Telescope, &"mount".parse().unwrap());
        let (property, at) = (property.to_owned(), self.image.frame.started_utc.plus_seconds(second));
        Write::Reading { device, property, value, at }
    }

    async fn write(&self, writes: Vec<Write>) {
        let alerts = NodeAlerts::new(Clock::machine_clock());
        let (database, writer) = Database::open(&self.config.archive.database, "callisto", alerts).unwrap();
        database.commit(writes).await.unwrap();
        drop(database);
        writer.end().await;
    }

    fn path(&self) -> PathBuf {
        self.image.path(&self.config.folders.images)
    }

    fn header(&self) -> Header {
        read_header(&self.path()).unwrap()
    }

    /// The lines of history that begin so.
    fn said(&self, begins: &str) -> Vec<String> {
        let header = self.header();
        let lines = header.cards().filter_map(|card| Some(card.strip_prefix("HISTORY ")?.to_owned()));
        lines.filter(|line| line.starts_with(begins)).collect()
    }

    fn complete(&self, facts: Option<&FrameFacts>) {
        let reader = Reader::open(&self.config.archive.database, "callisto").unwrap();
        let (newest, completer) = (Newest::default(), Completer::new(&self.config.folders.images));
        let (config, table) = (&self.config, &self.table);
        let site = Site { config, table, newest: &newest, speed: 1.0, completer: &completer };
        complete_image(&site, &reader, &self.image, facts, true).unwrap().unwrap();
    }
}

fn unsolved() -> FrameFacts {
    let detail = "3 stars are seen, at least 8 are needed for a solution; the sky is bright, and the frame is short";
    let why = Unsolved { class: UnsolvedClass::Clouds, detail: detail.to_owned() };
    FrameFacts { stars: Some(3), fwhm_px: Some(2.5), unsolved: Some(why), ..FrameFacts::default() }
}

fn solved() -> FrameFacts {
    let cd_deg_px = [[-1e-4, 0.0], [0.0, 1e-4]];
    let wcs = FrameWcs { ra_deg: 80.0, dec_deg: -5.0, x_px: 1.5, y_px: 0.5, cd_deg_px, sip: None };
    FrameFacts { stars: Some(30), wcs: Some(wcs), scale_arcsec_px: Some(0.36), ..FrameFacts::default() }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_header_that_is_completed_again_from_forgotten_telemetry_stays_as_it_is() {
    let mut stage = Stage::new().await;
    stage.complete(Some(&unsolved()));
    assert_eq!(stage.header().value("ALTITUDE").as_deref(), Some("50.0"));
    assert_eq!(stage.said("not known"), ["not known at DATE-OBS: AZIMUTH"]);
    let once = std::fs::read(stage.path()).unwrap();
    let database = rusqlite::Connection::open(&stage.config.archive.database).unwrap();
    database.execute("DELETE FROM samples", []).unwrap();
    stage.complete(Some(&unsolved()));
    assert!(std::fs::read(stage.path()).unwrap() == once, "{:?}", stage.header().cards().collect::<Vec<_>>());
    // The folder has moved to another disk.
    let moved = stage.config.folders.images.with_file_name("moved");
    std::fs::rename(&stage.config.folders.images, &moved).unwrap();
    stage.config.folders.images = moved;
    stage.complete(Some(&solved()));
    assert_eq!(stage.header().value("SOLVED").as_deref(), Some("T"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_behind_a_slew_has_the_altitude_since_and_not_one_on_the_way_there() {
    let stage = Stage::new().await;
    let slews = [(-1.1, true), (-0.5, true), (-0.1, false), (1.0, false)];
    let said = slews.map(|(second, slews)| stage.polled("Slewing", second, Ok(Scalar::Bool(slews))));
    let altitudes = [(-0.6, 42.0), (2.0, 50.01)];
    let altitudes = altitudes.map(|(second, deg)| stage.polled("Altitude", second, Ok(Scalar::Float(deg))));
    stage.write(said.into_iter().chain(altitudes).collect()).await;
    stage.complete(None);
    let altitude_deg: f64 = stage.header().value("ALTITUDE").unwrap().parse().unwrap();
    assert!((altitude_deg - 49.99).abs() < 1e-9, "{altitude_deg}: on the line of the two polls behind the slew");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_said_of_a_frame_goes_with_the_facts_that_said_it() {
    let stage = Stage::new().await;
    stage.complete(Some(&unsolved()));
    assert_eq!((stage.said("not solved: ").len(), stage.header().value("SOLVED").as_deref()), (1, Some("F")));
    let said = stage.header().cards().filter(|card| card.starts_with("HISTORY")).count();
    stage.complete(Some(&solved()));
    assert_eq!(stage.header().value("SOLVED").as_deref(), Some("T"));
    assert_eq!(stage.header().value("CTYPE1").as_deref(), Some("RA---TAN-SIP"));
    assert_eq!(stage.header().value("FWHM"), None, "the newest facts have none");
    // Both cards of the line.
    assert_eq!(stage.said("not solved: "), [""; 0]);
    assert_eq!(stage.header().cards().filter(|card| card.starts_with("HISTORY")).count(), said - 2);
    stage.complete(Some(&unsolved()));
    let header = stage.header();
    assert_eq!((header.value("SOLVED").as_deref(), header.value("FWHM").as_deref()), (Some("F"), Some("2.5")));
    for keyword in ["CTYPE1", "CRVAL1", "CD1_1", "A_ORDER", "PIXSCALE"] {
        assert_eq!(header.value(keyword), None, "{keyword}");
    }
    assert_eq!(header.value("RADESYS").as_deref(), Some("ICRS"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_whose_guiding_is_known_later_is_no_more_one_that_was_not_guided() {
    let stage = Stage::new().await;
    stage.complete(None);
    assert_eq!(stage.said("not guided").len(), 1);
    let samples = include_str!("../../common/contract/golden/v1/observatory.correction.json");
    let sample = serde_json::from_str::<Vec<Correction>>(samples).unwrap().remove(0);
    let correction = Correction { mid_utc: stage.image.frame.started_utc.plus_seconds(2.5), ..sample };
    let stored = StoredCorrection { correction, telescope: "callisto".to_owned(), origin: (BootId::fresh(), 0) };
    stage.write(vec![Write::Correction(Box::new(stored))]).await;
    stage.complete(None);
    assert!(stage.header().value(GUIDED).is_some() && stage.said("not guided").is_empty());
    // It is there also when the corrections are forgotten.
    let database = rusqlite::Connection::open(&stage.config.archive.database).unwrap();
    database.execute("DELETE FROM guiding", []).unwrap();
    stage.complete(None);
    assert!(stage.header().value(GUIDED).is_some() && stage.said("not guided").is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn late_facts_are_given_up_only_where_the_file_is_gone() {
    let mut stage = Stage::new().await;
    stage.complete(None);
    let (images, path) = (&stage.config.folders.images, stage.path());
    let put = || put_late(images, &stage.table, &stage.image, &solved());
    // The disk refuses for now.
    let journal = journal_of(&path);
    std::fs::create_dir(&journal).unwrap();
    assert!(matches!(put(), Late::Failed(_)));
    std::fs::remove_dir(&journal).unwrap();
    assert!(matches!(put(), Late::InHeader));
    assert_eq!(stage.header().value("NSTARS").as_deref(), Some("30"));
    assert_eq!(stage.said("not known"), ["not known at DATE-OBS: AZIMUTH"], "the facts do not know otherwise");
    let away = images.with_file_name("away.fits");
    std::fs::rename(&path, &away).unwrap();
    assert!(matches!(put(), Late::Gone(_)));
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(&away, &path).unwrap();
        assert!(matches!(put(), Late::Gone(_)), "a link");
        std::fs::remove_file(&path).unwrap();
    }
    std::fs::remove_dir_all(images.join(PART_FOLDER)).unwrap();
    let Late::Failed(why) = put() else { panic!("the disk is away") };
    assert!(why.contains(".part is not there: its disk may be away. Mount it"), "{why}");
    // An archive was started meanwhile, and made its own folder.
    std::fs::create_dir(images.join(PART_FOLDER)).unwrap();
    assert!(matches!(put(), Late::Gone(_)));
    stage.image.file = "20261121/a.fits".to_owned();
    let images = &stage.config.folders.images;
    let put = || put_late(images, &stage.table, &stage.image, &solved());
    assert!(matches!(put(), Late::Failed(_)), "the folder of the night is away");
    std::fs::create_dir(images.join("20261121")).unwrap();
    assert!(matches!(put(), Late::Gone(_)));
}

#[tokio::test(flavor = "multi_thread")]
async fn the_file_of_another_frame_that_has_taken_the_name_keeps_its_header() {
    let mut stage = Stage::new().await;
    let before = std::fs::read(stage.path()).unwrap();
    stage.image.frame.id = CommandId("frame-2".to_owned());
    let reader = Reader::open(&stage.config.archive.database, "callisto").unwrap();
    let (newest, completer) = (Newest::default(), Completer::new(&stage.config.folders.images));
    let (config, table) = (&stage.config, &stage.table);
    let site = Site { config, table, newest: &newest, speed: 1.0, completer: &completer };
    let why = complete_image(&site, &reader, &stage.image, None, true).unwrap_err().to_string();
    assert!(why.contains("a.fits is the file of frame frame-1; put that of frame frame-2 back"), "{why}");
    let late = put_late(&stage.config.folders.images, &stage.table, &stage.image, &solved());
    assert!(matches!(late, Late::Gone(_)), "the facts stay in the database");
    assert!(std::fs::read(stage.path()).unwrap() == before);
    // A file of before there was a FRAMEID is taken as it is.
    let mut header = stage.header();
    header.retain(|keyword| keyword != "FRAMEID");
    completer.complete(&stage.path(), header, &Plan::default()).unwrap();
    complete_image(&site, &reader, &stage.image, None, true).unwrap().unwrap();
    assert_eq!(stage.header().value("ALTITUDE").as_deref(), Some("50.0"));
}
