//! A row whose target is behind the horizon of the site waits until it is clear, and others run meanwhile; one
//! whose target never will fails at once.

use contract::observatory::{RowState, RowStatus};
use sky::{EarthOrientation, Icrs, Observer, Place};
use units::Utc;

use crate::MOST;
use crate::sim::{NIGHT, Sim, wide_field};

const SPEED: f64 = 40.0;
/// How much higher than the rising target the horizon is at the start, deg: some 17 minutes of the night, which are 25 s
/// of this machine.
const HIDDEN_DEG: f64 = 3.8;

fn observer(options: &simulator::Options, at: Utc) -> Observer {
    let place = Place::new(options.latitude, options.longitude, options.elevation_m).unwrap();
    Observer::new(&place, &EarthOrientation::default(), at).unwrap()
}

fn row(sim: &Sim, row: usize) -> Option<RowState> {
    sim.schedule.get()?.sample.body.rows.get(row).cloned()
}

fn is(sim: &Sim, index: usize, status: RowStatus) -> bool {
    row(sim, index).is_some_and(|row| row.status == status)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_row_waits_for_its_target_behind_the_hill_and_others_run_meanwhile() {
    let mut options = wide_field(SPEED);
    options.mount = simulator::MountOptions { slew_deg_per_s: 20.0, ..simulator::MountOptions::perfect() };
    let sky = observer(&options, Utc::from_seconds(NIGHT));
    let at_hour_angle = |hours: f64| ((sky.sidereal_time().degrees() - 15.0 * hours).rem_euclid(360.0), -20.0);
    let [rising, high, setting] = [-3.5, -0.5, 4.5].map(at_hour_angle);
    let altitude_deg = |(ra, dec): (f64, f64)| sky.to_horizontal(&Icrs::from_degrees(ra, dec)).altitude.degrees();
    let hill_deg = altitude_deg(rising) + HIDDEN_DEG;
    assert!(altitude_deg(setting) < hill_deg && altitude_deg(high) > hill_deg + 20.0 && altitude_deg(rising) > 20.0);
    let more = "[imaging]\nsolve = false\n";
    let mut sim = Sim::with_mount(options, more, &format!("horizon = [[0.0, {hill_deg:?}]]\n")).await;
    let object =
        |(ra, dec): (f64, f64)| format!(r#"{{"object": "field", "ra": {ra}, "dec": {dec}, "exptime": 2, "n": 2}}"#);
    let [rising_row, setting_row, high_row] = [rising, setting, high].map(object);
    sim.write_schedule(&[("object", &rising_row), ("object", &setting_row), ("object", &high_row)], 14_400.0);
    sim.start().await;

    sim.until("waiting", MOST, |sim| is(sim, 0, RowStatus::Interrupted)).await;
    let waiting = row(&sim, 0).unwrap();
    assert_eq!(waiting.frames, 0, "{waiting:?}");
    assert!(waiting.detail.contains("below the horizon of the site"), "{waiting:?}");
    let clear = waiting.detail.rsplit_once("it stands clear from ").unwrap().1.strip_suffix(" on").unwrap();
    let clear: Utc = clear.parse().unwrap();
    sim.until("the high row observed", MOST, |sim| is(sim, 2, RowStatus::Finished)).await;
    assert_eq!(row(&sim, 0).unwrap().frames, 0, "others run meanwhile");
    let failed = row(&sim, 1).unwrap();
    assert_eq!(failed.status, RowStatus::Failed, "{failed:?}");
    assert!(failed.detail.contains("below the horizon of the site"), "{failed:?}");

    sim.until("the rising row observed", MOST, |sim| is(sim, 0, RowStatus::Finished)).await;
    assert!(sim.clock.utc() >= clear, "not before it stands clear");
    let (ra, dec) = rising;
    let higher =
        observer(&sim.options, clear).to_horizontal(&Icrs::from_degrees(ra, dec)).altitude.degrees() - hill_deg;
    assert!(
        (0.0..0.3).contains(&higher),
        "it counts as clear {higher} deg above the hill: it is looked for every minute"
    );
    assert_eq!(row(&sim, 0).unwrap().frames, 2);
    sim.stop().await;
}
