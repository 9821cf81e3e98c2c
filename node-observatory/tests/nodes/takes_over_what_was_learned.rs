//! A standby with a data folder of its own goes on with all that the commander had learned: the pointing model, the
//! optics, what guide pulses do, and where the field was.

use std::time::Duration;

use bus::Catch;
use contract::device::camera::Frame;
use contract::observatory::{CalibrationSource, FrameFacts, GuideCalibration, OpticsState};
use contract::{Address, Key, Part, Topic};
use node_observatory::guiding::learned::LearnedGuiding;
use node_observatory::pointing::learned::PointingModels;
use node_observatory::replicated::Replicate as _;
use simulator::Quantity;

use crate::MOST;
use crate::sim::{Sim, by_geometry, misses, wide_field};

/// How far the telescope looks from where it is sent, arcmin to the east and to the north.
const MISS: [f64; 2] = [-6.0, 4.0];

#[tokio::test(flavor = "multi_thread")]
async fn a_standby_points_solves_and_holds_the_field_as_the_commander_did() {
    let options = wide_field(20.0);
    let pulsed = by_geometry(&options.camera);
    let pulsed = GuideCalibration { source: CalibrationSource::Pulses, backlash_s: Some(0.2), ..pulsed };
    let mut sim = Sim::new(options, "").await;
    sim.simulator.world().set_weather(Quantity::StarFwhm, Some(0.1));
    sim.mislead(MISS).await;
    // Models of earlier nights, on the first node's disk only.
    sim.keep_calibration("camera", pulsed.clone());
    sim.keep_pointing(&misses(MISS));
    let (ra, dec) = sim.place(0.7, -20.0);
    let row = format!(
        r#"{{"object": "field", "ra": {ra}, "dec": {dec}, "exptime": 10, "n": 400, "pointing": true, "guiding": true}}"#
    );
    sim.write_schedule(&[("object", &row)], 18_000.0);
    let frames = sim.bus.subscribe::<Frame>(Topic::Frame.everywhere(), Catch::All, 1000).await.unwrap();
    let facts = sim.bus.subscribe::<FrameFacts>(Topic::Facts.everywhere(), Catch::All, 1000).await.unwrap();
    let key = Key::Observatory(Address::new("test", "alpha").unwrap(), Part::Optics).to_string();
    let optics = sim.bus.subscribe::<OpticsState>(&key, Catch::All, 1000).await.unwrap();
    sim.start().await;
    sim.until("held", MOST, |sim| sim.holds(4)).await;
    let first = sim.guiding.get().unwrap().sample;
    assert_eq!(first.body.calibration.as_ref().unwrap().source, CalibrationSource::Pulses);

    // It comes late: the reference was published before it was there.
    let folder = sim.start_standby().await;
    sim.until_up("second").await;
    tokio::time::sleep(Duration::from_secs(4)).await;
    assert!(!folder.join("guiding-alpha.json").exists(), "a standby writes nothing");
    let killed = sim.clock.utc();
    sim.kill_commander().await;
    let is_second = |sim: &Sim| sim.guiding.get().is_some_and(|received| received.sample.boot_id != first.boot_id);
    sim.until("held by the standby", MOST, |sim| is_second(sim) && sim.holds(2)).await;

    let second = sim.guiding.get().unwrap().sample.body;
    println!("{}", second.detail);
    assert_eq!(second.reference, first.body.reference, "on the pixels where it stood");
    let calibration = second.calibration.unwrap();
    assert_eq!((calibration.source, calibration.backlash_s), (CalibrationSource::Pulses, Some(0.2)));
    assert_eq!(calibration.made_utc, pulsed.made_utc, "of nights before, and none that it made itself");
    // The first slew was corrected by a model that is not on its disk.
    let (mut sent, mut off) = (None, None);
    while let Ok(received) = tokio::time::timeout(Duration::from_millis(300), frames.recv()).await {
        let frame = received.sample.body;
        if frame.purpose.action == "pointing" && frame.started_utc > killed {
            sent.get_or_insert(frame.id);
        }
    }
    while let Ok(received) = tokio::time::timeout(Duration::from_millis(300), facts.recv()).await {
        // The facts of a frame whose place takes long are published twice.
        if Some(&received.sample.body.frame) == sent.as_ref() {
            off = received.sample.body.off_target_arcmin.or(off);
        }
    }
    println!("first frame to point by: {sent:?}, {off:?} arcmin off");
    assert!(off.unwrap() < 0.5, "its first frame looks {off:?} arcmin off the target; without a model it is 7.2");
    // Its first state of the optics is what the commander had learned, or goes on from there: the next frame may be
    // quicker.
    let (mut had, mut taken_over) = (None, None);
    while let Ok(received) = tokio::time::timeout(Duration::from_millis(300), optics.recv()).await {
        let optics = received.sample.body.optics.into_iter().find(|optics| optics.camera == "camera");
        match received.sample.boot_id == first.boot_id {
            true => had = optics,
            false => taken_over = taken_over.or(Some(optics)),
        }
    }
    let (had, taken_over) = (had.unwrap(), taken_over.unwrap().unwrap());
    let goes_on = taken_over.at_utc > killed && taken_over.frames > had.frames;
    assert!(
        (taken_over.at_utc, taken_over.frames) == (had.at_utc, had.frames) || goes_on,
        "{taken_over:?} after {had:?}"
    );

    // And it is on its own disk, for its next incarnation.
    let reference = first.body.reference.unwrap();
    let is_written = |_: &Sim| {
        let learned = LearnedGuiding::read(&folder.join("guiding-alpha.json"));
        learned.references.iter().any(|known| known.frame == reference)
            && learned.calibrations.iter().any(|known| known.calibration.made_utc == pulsed.made_utc)
            && PointingModels::read(&folder.join("pointing-alpha.json"))
                .models
                .iter()
                .any(|model| model.points.len() >= 12)
            && std::fs::read_to_string(folder.join("optics-alpha.json")).is_ok_and(|text| text.contains("\"camera\""))
    };
    sim.until("written down", MOST, is_written).await;
    sim.stop().await;
}
