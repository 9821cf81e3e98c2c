//! A device that has moved comes to rest once: its device node waits for that, and nobody waits for it again.

use crate::MOST;
use crate::sim::{Sim, wide_field};

/// Rest of the focuser after a move, sky s.
const SETTLE_S: f64 = 60.0;

#[tokio::test(flavor = "multi_thread")]
async fn a_focuser_settles_once_before_the_exposure() {
    let more = format!(
        "[[focuser]]\nname = \"focuser\"\nserver = \"@simulator\"\nperiod_s = 0.5\nbest_position = 25000\nsettle_s = {SETTLE_S:?}\n"
    );
    let mut sim = Sim::new(wide_field(20.0), &more).await;
    let (ra, dec) = sim.place(-1.0, -25.0);
    let row = format!(r#"{{"object": "field", "ra": {ra}, "dec": {dec}, "exptime": 1, "n": 1, "focus_shift": 400}}"#);
    // The mount is there long before.
    sim.write_schedule(&[("object", &row)], 18_000.0);
    // The observatory node believes that the focuser needs so long that nobody would see the end of a second wait.
    sim.start_with(|of_observatory| of_observatory.focuser[0].settle_s = 1e6).await;
    sim.until("the row ends", MOST, |sim| sim.ended(0).is_some()).await;
    let puts = sim.simulator.world().puts_since(0);
    let first = |member: &str| {
        puts.iter().find(|put| put.member == member).unwrap_or_else(|| panic!("no {member}: {puts:?}")).sky_utc
    };
    let rested_s = first("startexposure").seconds_since(first("move"));
    assert!(rested_s >= SETTLE_S, "{rested_s} s from the move to the exposure");
    sim.stop().await;
}
