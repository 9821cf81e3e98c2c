//! The measured facts of a frame are on the bus within a second, in the header and in the database, and agree with the
//! simulated sky.

#![allow(clippy::unwrap_used, reason = "a test ends by panicking")]

use std::collections::HashMap;
use std::time::Duration;

use bus::{Catch, Received, Subscriber};
use contract::device::camera::Frame;
use contract::observatory::FrameFacts;
use contract::{Address, Payload, Role, Topic};
use serde_json::json;
use test_support::{Harness, HarnessOptions, Lateness, header, object, row};

/// Frames of the row.
const FRAMES: usize = 6;
/// FWHM of the stars at 20 deg from the zenith: optics alone, the seeing set to nearly nothing.
const FWHM_ARCSEC: f64 = 8.0;

/// A field of half a degree whose stars are 3 px wide, under a mount without errors.
fn options() -> HarnessOptions {
    let mut options = HarnessOptions::default();
    (options.world.camera.width, options.world.camera.height) = (640, 640);
    options.world.camera.pixel_um = 13.5;
    options.world.camera.optics_fwhm_arcsec = FWHM_ARCSEC;
    options.world.mount = simulator::MountOptions::perfect();
    options
}

async fn all<T: Payload>(harness: &Harness, topic: Topic) -> anyhow::Result<Subscriber<T>> {
    let address = Address::new(test_support::SITE, test_support::TELESCOPE)?;
    Ok(harness.bus.subscribe(topic.at(&address), Catch::All, 1000).await?)
}

async fn so_many<T: Payload>(of: &Subscriber<T>, id: fn(&T) -> &str) -> anyhow::Result<HashMap<String, Received<T>>> {
    let mut received: HashMap<String, Received<T>> = HashMap::new();
    while received.len() < FRAMES {
        let next = tokio::time::timeout(Duration::from_secs(90), of.recv()).await?;
        received.entry(id(&next.sample.body).to_owned()).or_insert(next);
    }
    Ok(received)
}

#[tokio::test(flavor = "multi_thread")]
async fn stars_and_fwhm_of_every_frame_are_on_the_bus_in_the_header_and_in_the_database() -> anyhow::Result<()> {
    let mut harness = Harness::new(options(), |world| {
        let rows = vec![row("open", json!({})), object(world, "Measured field", 10.0, FRAMES as u32)];
        [rows, vec![row("complete_headers", json!({}))]].concat()
    })
    .await?;
    harness.simulator.world().set_weather(simulator::Quantity::StarFwhm, Some(0.1));
    let frames = all::<Frame>(&harness, Topic::Frame).await?;
    let facts = all::<FrameFacts>(&harness, Topic::Facts).await?;
    // The archive starts later: no node waits for it.
    for role in [Role::Device, Role::Observatory] {
        harness.start(role)?;
    }
    let lateness = Lateness::begin();
    let announced = so_many(&frames, |frame| &frame.id.0).await?;
    let measured = so_many(&facts, |facts| &facts.frame.0).await?;
    let fwhm_px = FWHM_ARCSEC / harness.world.camera.pixel_scale().arcseconds();
    let mut slowest = Duration::ZERO;
    for (id, frame) in &announced {
        let received = &measured[id];
        let facts = &received.sample.body;
        slowest = slowest.max(received.arrived.since(frame.arrived));
        assert_eq!(facts.reason, None, "{facts:?}");
        assert!((facts.fwhm_px.unwrap() / fwhm_px - 1.0).abs() < 0.05, "{fwhm_px} px expected: {facts:?}");
        assert!(facts.stars.unwrap() > 20, "{facts:?}");
        assert!(facts.sky_adu.unwrap() > harness.world.camera.bias_adu, "{facts:?}");
        assert!(!facts.trailed.unwrap() && facts.ellipticity.unwrap() < 0.15, "{facts:?}");
    }
    println!(
        "facts at most {slowest:?} after the frame; {:?}",
        measured.values().next().map(|received| &received.sample.body)
    );
    // 1 s is promised of a release build.
    assert!(slowest < lateness.bound(Duration::from_secs(5)), "{slowest:?}");

    harness.start(Role::Archive)?;
    let stored = harness.stored().await?;
    let mut complete = HashMap::new();
    while complete.len() < FRAMES {
        let received = tokio::time::timeout(Duration::from_secs(90), stored.recv()).await?.sample.body;
        if received.header_complete {
            complete.insert(received.frame.0, received.file);
        }
    }
    let database = rusqlite::Connection::open(harness.path("data/archive.db"))?;
    for (id, file) in &complete {
        let facts = &measured[id].sample.body;
        let header = header(&harness.path("images").join(file))?;
        assert_eq!(header["NSTARS"], facts.stars.unwrap().to_string(), "{file}");
        assert_eq!(header["FWHM"].parse::<f64>()?, facts.fwhm_px.unwrap(), "{file}");
        assert_eq!(header["BKGLEVEL"].parse::<f64>()?, facts.sky_adu.unwrap(), "{file}");
        assert_eq!(header["TRAILED"], "F");
        let query = "SELECT stars, fwhm_px, in_header FROM facts WHERE frame_id = ?";
        let row: (u32, f64, u32) =
            database.query_row(query, [id], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?;
        assert_eq!(row, (facts.stars.unwrap(), facts.fwhm_px.unwrap(), 1), "{file}");
    }
    finds_them(&harness, &complete).await?;
    harness.until("the dome ends shut", 90.0, Harness::is_shut).await?;
    Ok(())
}

/// `starmesh archive frames`, as docs/operator/archive.md has it.
async fn finds_them(harness: &Harness, stored: &HashMap<String, String>) -> anyhow::Result<()> {
    let config = harness.path("observatory.toml");
    let config = config.to_str().unwrap();
    let find = async |words: &[&str]| -> anyhow::Result<Vec<String>> {
        let printed = harness.starmesh(&[&["archive", "frames", "--config", config, "--json"], words].concat()).await?;
        let rows = printed.lines().map(serde_json::from_str::<serde_json::Value>);
        let files = rows.map(|row| Ok(row?["file"].as_str().unwrap().to_owned()));
        files.collect()
    };
    let files: std::collections::BTreeSet<&String> = stored.values().collect();
    let found = find(&["--object", "measured field", "--type", "light", "--stars-min", "20"]).await?;
    assert_eq!(found.iter().collect::<std::collections::BTreeSet<_>>(), files);
    assert_eq!(find(&["--stars-min", "100000"]).await?, [""; 0]);
    // The simulated stars are not those of the catalogue: without a solution no width in arcsec and no place is known.
    assert_eq!(find(&["--fwhm-max", "100"]).await?, [""; 0]);
    assert_eq!(find(&["--night", "20010101"]).await?, [""; 0]);
    assert_eq!(find(&["--limit", "2"]).await?.len(), 2);
    assert_eq!(find(&["--covers", "10,-89.9"]).await?, [""; 0]);
    let listed = harness.starmesh(&["night", "list", "--config", config]).await?;
    assert!(listed.lines().nth(1).is_some_and(|line| line.contains(&format!("{FRAMES:>6}"))), "{listed}");
    Ok(())
}
