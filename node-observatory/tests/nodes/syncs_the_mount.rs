//! `pointing_model` with `sync`: the mount itself is synchronised to where it looks, the learned misses are forgotten,
//! and its next slew is right.

use std::collections::{BTreeMap, HashMap};
use std::time::Duration;

use bus::Catch;
use contract::device::camera::Frame;
use contract::observatory::{FrameFacts, PointingState};
use contract::{Address, Key, Part, Topic};
use simulator::Quantity;

use crate::MOST;
use crate::sim::{Sim, misses, wide_field};

/// How far the telescope looks from where it is sent, arcmin to the east and to the north.
const MISS: [f64; 2] = [6.0, -4.0];
/// Drift and chance of the mount, and the error of a solution, arcmin.
const NEAR_ARCMIN: f64 = 0.3;

#[tokio::test(flavor = "multi_thread")]
async fn a_mount_that_was_misled_is_synchronised_and_its_next_slew_is_right() {
    let mut sim = Sim::new(wide_field(20.0), "").await;
    sim.simulator.world().set_weather(Quantity::StarFwhm, Some(0.1));
    sim.mislead(MISS).await;
    // The node knows, and corrects by it; after the sync that would be wrong by as much.
    sim.keep_pointing(&misses(MISS));
    let object =
        |(ra, dec): (f64, f64)| format!(r#"{{"object": "field", "ra": {ra}, "dec": {dec}, "exptime": 30, "n": 2}}"#);
    let (west, east) = (object(sim.place(1.5, -20.0)), object(sim.place(-1.5, -45.0)));
    // Read out off the middle: the mount is synchronised on the sensor's middle.
    let part = r#""subframe_width": 300, "subframe_height": 300, "subframe_center_x": 0.3, "subframe_center_y": 0.7"#;
    let sync = format!(r#"{{"n": 3, "exptime": 10, "sync": true, {part}}}"#);
    sim.write_schedule(&[("object", &west), ("pointing_model", &sync), ("object", &east)], 18_000.0);
    let frames = sim.bus.subscribe::<Frame>(Topic::Frame.everywhere(), Catch::All, 100).await.unwrap();
    let facts = sim.bus.subscribe::<FrameFacts>(Topic::Facts.everywhere(), Catch::All, 100).await.unwrap();
    let key = Key::Observatory(Address::new("test", "alpha").unwrap(), Part::Pointing);
    let pointing = sim.bus.latest::<PointingState>(&key).await.unwrap();
    let before = sim.last_put();
    sim.start().await;
    let (mut row_of, mut off, mut truth) = (HashMap::new(), BTreeMap::<u32, Vec<f64>>::new(), BTreeMap::new());
    let began = std::time::Instant::now();
    while off.get(&2).is_none_or(|off| off.len() < 2) {
        assert!(began.elapsed() < MOST, "{off:?}: {:#?}", sim.schedule.get().map(|received| received.sample.body));
        tokio::select! {
            received = frames.recv() => {
                let frame = received.sample.body;
                let row = frame.purpose.row.unwrap();
                if let Some((ra, dec)) = frame.purpose.ra_deg.zip(frame.purpose.dec_deg).filter(|_| row != 1) {
                    let looks_at = sim.simulator.world().looks_at();
                    let off_arcmin = sky::separation(&sky::Icrs::from_degrees(ra, dec), &looks_at).degrees() * 60.0;
                    // The first one, so that the mount is not yet on its way to the next row.
                    truth.entry(row).or_insert(off_arcmin);
                }
                row_of.insert(frame.id, row);
            }
            received = facts.recv() => {
                let facts = received.sample.body;
                let Some(row) = row_of.get(&facts.frame) else { continue };
                off.entry(*row).or_default().extend(facts.off_target_arcmin);
            }
            () = tokio::time::sleep(Duration::from_millis(100)) => {}
        }
    }
    sim.until("the night's work done", MOST, |sim| (0..3).all(|row| sim.ended(row).is_some())).await;
    println!("{}; off {off:?}, in truth {truth:?}", sim.ended(1).unwrap());
    let synced: Vec<_> =
        sim.sent_to_mount(before).into_iter().filter(|(member, _)| member == "synctocoordinates").collect();
    assert_eq!(synced.len(), 3, "at each place: {synced:?}");
    assert!(
        sim.ended(1)
            .unwrap()
            .contains("3 of 3 places show where the telescope looks; the mount was synchronised each time")
    );
    for row in [0, 2] {
        assert!(
            off[&row].iter().all(|off| *off < NEAR_ARCMIN) && truth[&row] < NEAR_ARCMIN,
            "row {row}: {off:?} {truth:?}"
        );
    }
    // The points that the node had learned of the mount before are no longer valid, here and for a standby.
    let models = pointing.get().unwrap().sample.body.models;
    assert!(models.iter().all(|model| !model.used && model.points.len() <= 1), "{models:?}");
    sim.stop().await;
}
