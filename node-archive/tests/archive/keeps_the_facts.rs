//! Measured facts are in the header of their frame, whether they were published before the frame was stored or long
//! after.

use std::path::Path;
use std::time::{Duration, Instant};

use axum::routing::get;
use bus::{Bus, Catch, Clock, Publisher, Subscriber};
use config::header::HeaderTable;
use contract::archive::Stored;
use contract::device::camera::{Frame, Purpose};
use contract::observatory::{Distortion, FrameFacts, FrameWcs};
use contract::{Address, CommandId, Key, Kind, Role};
use node::Node;
use node_archive::stored_header::Header;
use sha2::{Digest, Sha256};
use test_support::{LIMIT, PARANAL, RunningNode, block, join, private_bus, serve, until};

const PIXELS: [u8; 64 * 32 * 2] = [3; 64 * 32 * 2];

fn address() -> Address {
    Address::new("paranal", "callisto").unwrap()
}

/// An archive whose table asks for nothing that is polled.
fn archive(folder: &Path, bus: Bus) -> Node {
    let config = config::parse(&(PARANAL.to_owned() + &block("camera", "andor", "localhost:1", "")), folder).unwrap();
    let table: HeaderTable =
        "header,dtype,fixed,device_type,device_command,comment\nDATE,str,false,astra,,written\n".parse().unwrap();
    Node::new(Role::Archive, "main".parse().unwrap(), config, table, bus)
}

async fn spool() -> String {
    format!("http://{}/frame", serve(axum::Router::new().route("/frame", get(async || PIXELS.to_vec()))).await)
}

fn frame(id: &str, url: &str, bus: &Bus) -> Frame {
    Frame {
        purpose: Purpose { image_type: "Light Frame".to_owned(), night: "20261120".to_owned(), ..Purpose::default() },
        width_px: 64,
        height_px: 32,
        started_utc: bus.clock().utc(),
        exposure_s: 0.5,
        url: url.to_owned(),
        bytes: PIXELS.len() as u64,
        sha256: Sha256::digest(PIXELS).iter().map(|byte| format!("{byte:02x}")).collect(),
        ..test_support::frame(id)
    }
}

/// A solution whose reference pixel lies at this right ascension.
fn wcs(ra_deg: f64) -> FrameWcs {
    let distortion = [0.0, 0.0, 0.0, 1e-9, 0.0, 1e-9, 0.0];
    FrameWcs {
        ra_deg,
        dec_deg: -5.25,
        x_px: 31.5,
        y_px: 15.5,
        cd_deg_px: [[-1e-4, 0.0], [0.0, 1e-4]],
        sip: Some(Distortion { a: distortion, b: distortion }),
    }
}

/// Publishes the facts of a frame, with a right ascension that equals its width; they can be recovered while the
/// publisher exists.
async fn publish(bus: &Bus, frame: &str, fwhm_px: f64) -> Publisher<FrameFacts> {
    let key = Key::Facts(address(), frame.parse().unwrap());
    let line = bus.publisher(&key).await.unwrap();
    let frame = CommandId(frame.to_owned());
    let facts = FrameFacts {
        frame,
        stars: Some(12),
        fwhm_px: Some(fwhm_px),
        wcs: Some(wcs(fwhm_px)),
        zero_point_mag: Some(21.5),
        ..FrameFacts::default()
    };
    line.put(facts).await.unwrap();
    line
}

async fn complete(stored: &Subscriber<Stored>, id: &str) -> Stored {
    let waiting = async {
        loop {
            let body = stored.recv().await.sample.body;
            if body.header_complete && body.frame.0 == id {
                return body;
            }
        }
    };
    tokio::time::timeout(LIMIT, waiting).await.unwrap()
}

fn value(folder: &Path, file: &str, keyword: &str) -> Option<String> {
    Header::read(&folder.join("images").join(file)).unwrap().unwrap().value(keyword)
}

#[tokio::test(flavor = "multi_thread")]
async fn facts_stand_in_the_header_early_or_late_and_a_header_waits_for_none_that_never_come() {
    let folder = tempfile::tempdir().unwrap();
    let devices = private_bus(Clock::machine_clock()).await;
    let node = archive(folder.path(), join(&devices).await);
    let stored = devices.subscribe::<Stored>(&Key::Stored(address()).to_string(), Catch::All, 100).await.unwrap();
    let camera = address().device(Kind::Camera, &"andor".parse().unwrap());
    let frames = devices.publisher::<Frame>(&Key::Frame(camera)).await.unwrap();
    let (url, running) = (spool().await, RunningNode::work(node, node_archive::run));

    // Published before the archive runs, for a frame that is not announced yet.
    let _early = publish(&devices, "early", 2.25).await;
    let _unknown = publish(&devices, "never-announced", 9.0).await;
    tokio::time::sleep(Duration::from_secs(2)).await;
    frames.put(frame("early", &url, &devices)).await.unwrap();
    let file = complete(&stored, "early").await.file;
    // On a busy machine they may come after the header was completed without them.
    until("the early facts are in the header", || value(folder.path(), &file, "FWHM").as_deref() == Some("2.25")).await;
    assert_eq!(value(folder.path(), &file, "NSTARS").as_deref(), Some("12"));
    let solution =
        |file: &str| ["CTYPE1", "CRVAL1", "CRPIX1", "A_ORDER", "MAGZPT"].map(|key| value(folder.path(), file, key));
    let expected = |ra: &str| ["RA---TAN-SIP", ra, "32.5", "3", "21.5"].map(|text| Some(text.to_owned()));
    assert_eq!(solution(&file), expected("2.25"));

    // No node measures this frame until its header is complete.
    let began = Instant::now();
    frames.put(frame("late", &url, &devices)).await.unwrap();
    let file = complete(&stored, "late").await.file;
    let waited = began.elapsed();
    assert!(waited >= node_archive::facts::TIMEOUT && value(folder.path(), &file, "FWHM").is_none(), "{waited:?}");
    let _late = publish(&devices, "late", 3.5).await;
    until("the late facts are in the header", || value(folder.path(), &file, "FWHM").as_deref() == Some("3.5")).await;
    assert_eq!(solution(&file), expected("3.5"));
    let mut fits = fitsio::FitsFile::open(folder.path().join("images").join(&file)).unwrap();
    let image: Vec<u16> = fits.primary_hdu().unwrap().read_image(&mut fits).unwrap();
    assert_eq!(image, [0x0303; 64 * 32], "the pixels are where they were");
    running.stop().await;
}
