//! The measured facts of a frame are on the bus within a second, in the header and in the database, and agree with the
//! simulated sky.

#![allow(clippy::unwrap_used, reason = "a test ends by panicking")]

use std::collections::HashMap;
use std::time::Duration;

use bus::{Catch, Heard, Subscriber};
use contract::device::camera::Frame;
use contract::observatory::FrameFacts;
use contract::{Payload, Role};
use serde_json::json;
use test_support::{Lateness, Rig, RigOptions, header, object, row};

/// Frames of the row.
const FRAMES: usize = 6;
/// FWHM of the stars at 20 deg from the zenith: optics alone, the seeing set to nearly nothing.
const FWHM_ARCSEC: f64 = 8.0;

/// A field of half a degree whose stars are 3 px wide, under a mount without errors.
fn options() -> RigOptions {
    let mut options = RigOptions::default();
    (options.world.camera.width, options.world.camera.height) = (640, 640);
    options.world.camera.pixel_um = 13.5;
    options.world.camera.optics_fwhm_arcsec = FWHM_ARCSEC;
    options.world.mount = simulator::MountOptions::perfect();
    options
}

async fn all<T: Payload>(rig: &Rig, below: &str) -> anyhow::Result<Subscriber<T>> {
    let expression = format!("{}/{}/{}/{below}", contract::key::ROOT, test_support::SITE, test_support::TELESCOPE);
    Ok(rig.bus.subscribe(&expression, Catch::All, 1000).await?)
}

async fn so_many<T: Payload>(of: &Subscriber<T>, id: fn(&T) -> &str) -> anyhow::Result<HashMap<String, Heard<T>>> {
    let mut heard: HashMap<String, Heard<T>> = HashMap::new();
    while heard.len() < FRAMES {
        let next = tokio::time::timeout(Duration::from_secs(90), of.hear()).await?;
        heard.entry(id(&next.said.body).to_owned()).or_insert(next);
    }
    Ok(heard)
}

#[tokio::test(flavor = "multi_thread")]
async fn stars_and_fwhm_of_every_frame_are_on_the_bus_in_the_header_and_in_the_database() -> anyhow::Result<()> {
    let mut rig = Rig::new(options(), |world| {
        let rows = vec![row("open", json!({})), object(world, "Measured field", 10.0, FRAMES as u32)];
        [rows, vec![row("complete_headers", json!({}))]].concat()
    })
    .await?;
    rig.simulator.world().set_weather(simulator::Quantity::StarFwhm, Some(0.1));
    let frames = all::<Frame>(&rig, "device/camera/*/frame").await?;
    let facts = all::<FrameFacts>(&rig, "observatory/frame/*/facts").await?;
    // The archive starts later: no node waits for it.
    for role in [Role::Device, Role::Observatory] {
        rig.start(role)?;
    }
    let lateness = Lateness::begin();
    let announced = so_many(&frames, |frame| &frame.id.0).await?;
    let measured = so_many(&facts, |facts| &facts.frame.0).await?;
    let fwhm_px = FWHM_ARCSEC / rig.world.camera.pixel_scale().arcseconds();
    let mut slowest = Duration::ZERO;
    for (id, frame) in &announced {
        let heard = &measured[id];
        let facts = &heard.said.body;
        slowest = slowest.max(heard.arrived.since(frame.arrived));
        assert_eq!(facts.reason, None, "{facts:?}");
        assert!((facts.fwhm_px.unwrap() / fwhm_px - 1.0).abs() < 0.05, "{fwhm_px} px expected: {facts:?}");
        assert!(facts.stars.unwrap() > 20, "{facts:?}");
        assert!(facts.sky_adu.unwrap() > rig.world.camera.bias_adu, "{facts:?}");
        assert!(!facts.trailed.unwrap() && facts.ellipticity.unwrap() < 0.15, "{facts:?}");
    }
    println!("facts at most {slowest:?} after the frame; {:?}", measured.values().next().map(|heard| &heard.said.body));
    // 1 s is promised of a release build.
    assert!(slowest < lateness.bound(Duration::from_secs(5)), "{slowest:?}");

    rig.start(Role::Archive)?;
    let stored = rig.stored().await?;
    let mut complete = HashMap::new();
    while complete.len() < FRAMES {
        let heard = tokio::time::timeout(Duration::from_secs(90), stored.hear()).await?.said.body;
        if heard.header_complete {
            complete.insert(heard.frame.0, heard.file);
        }
    }
    let database = rusqlite::Connection::open(rig.path("data/archive.db"))?;
    for (id, file) in &complete {
        let facts = &measured[id].said.body;
        let header = header(&rig.path("images").join(file))?;
        assert_eq!(header["NSTARS"], facts.stars.unwrap().to_string(), "{file}");
        assert_eq!(header["FWHM"].parse::<f64>()?, facts.fwhm_px.unwrap(), "{file}");
        assert_eq!(header["BKGLEVEL"].parse::<f64>()?, facts.sky_adu.unwrap(), "{file}");
        assert_eq!(header["TRAILED"], "F");
        let query = "SELECT stars, fwhm_px, in_header FROM facts WHERE frame_id = ?";
        let row: (u32, f64, u32) =
            database.query_row(query, [id], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?;
        assert_eq!(row, (facts.stars.unwrap(), facts.fwhm_px.unwrap(), 1), "{file}");
    }
    rig.until("the dome ends shut", 90.0, Rig::is_shut).await?;
    Ok(())
}
