//! Flats, end to end: real nodes under the simulated sky at dusk and at dawn, and before a lit panel. What was taken is
//! judged by the frames as the device node announces them and by their facts; what was moved, by the simulator's log.

use std::collections::BTreeMap;
use std::time::Duration;

use bus::{Catch, Subscriber};
use contract::device::camera::Frame;
use contract::observatory::{FrameFacts, RowStatus};
use contract::{CommandId, Order, OrderKind, Reply, Topic};
use simulator::Options;
use sky::{EarthOrientation, Place, next_sun_crossing};
use units::{Angle, Utc};

use crate::MOST;
use crate::sim::{Sim, telescope};

/// Sky seconds per machine second: a frame is fetched and measured within a second, and a node restarts within ten, which
/// must not miss much of the dusk, also on a busy machine.
const SPEED: f64 = 5.0;
const DEVICES: [(&str, &str); 2] = [("filterwheel", "wheel"), ("covercalibrator", "cover")];
/// Wanted level of a frame and how far off it may be, ADU.
const LEVEL: (f64, f64) = (28_000.0, 5600.0);
const CAMERA: &str = "flats = { target_adu = 28000 }\n";

/// The night of the other scenarios, from the moment at which the Sun passes an altitude.
fn twilight(sun_deg: f64, rising: bool) -> Options {
    let options = telescope(SPEED);
    let place = Place::new(options.latitude, options.longitude, options.elevation_m).unwrap();
    let noon = "2026-11-20T16:00:00Z".parse::<Utc>().unwrap();
    let altitude = Angle::from_degrees(sun_deg);
    let start = next_sun_crossing(&place, &EarthOrientation::default(), noon, altitude, rising).unwrap().unwrap();
    Options { start, ..options }
}

/// The received frames and facts.
struct Subscribers {
    frames: Subscriber<Frame>,
    facts: Subscriber<FrameFacts>,
    received: Vec<Frame>,
    reported: BTreeMap<String, FrameFacts>,
}

impl Subscribers {
    async fn of(sim: &Sim) -> Self {
        let frames = sim.bus.subscribe(Topic::Frame.everywhere(), Catch::All, 1000).await.unwrap();
        let facts = sim.bus.subscribe(Topic::Facts.everywhere(), Catch::All, 1000).await.unwrap();
        Self { frames, facts, received: Vec::new(), reported: BTreeMap::new() }
    }

    /// Takes in all samples until now.
    async fn listen(&mut self) {
        let quiet = Duration::from_millis(20);
        while let Ok(received) = tokio::time::timeout(quiet, self.frames.recv()).await {
            let frame = received.sample.body;
            // A spool announces again what nobody has taken.
            if !self.received.iter().any(|known| known.id == frame.id) {
                self.received.push(frame);
            }
        }
        // A frame that has just come is still being measured.
        let is_incomplete = |subscribers: &Self| {
            subscribers.flats().iter().any(|(frame, _)| !subscribers.reported.contains_key(&frame.id.0))
        };
        while let Ok(received) =
            tokio::time::timeout(if is_incomplete(self) { MOST } else { quiet }, self.facts.recv()).await
        {
            self.reported.insert(received.sample.body.frame.0.clone(), received.sample.body);
        }
    }

    /// The flats, and whether each counts by its facts.
    fn flats(&self) -> Vec<(&Frame, bool)> {
        let flats = self.received.iter().filter(|frame| frame.purpose.image_type == "Flat Frame");
        flats
            .map(|frame| (frame, self.reported.get(&frame.id.0).is_some_and(|facts| facts.refused.is_none())))
            .collect()
    }

    /// Filters of the flats that count, in the order in which they were taken, each with the number of its frames.
    fn filters(&self) -> Vec<(String, usize)> {
        let mut runs: Vec<(String, usize)> = Vec::new();
        for (frame, _) in self.flats().into_iter().filter(|(_, counts)| *counts) {
            let filter = frame.purpose.filter.clone().unwrap();
            match runs.last_mut().filter(|(last, _)| *last == filter) {
                Some((_, count)) => *count += 1,
                None => runs.push((filter, 1)),
            }
        }
        runs
    }

    /// Every flat counts if and only if its level is good.
    fn judged_rightly(&self) {
        for (frame, counts) in self.flats() {
            let facts = &self.reported[&frame.id.0];
            let is_good = facts.sky_adu.is_some_and(|adu| (adu - LEVEL.0).abs() <= LEVEL.1);
            println!(
                "{:?} {:.2} s: {:?} ADU {:?}",
                frame.purpose.filter, frame.exposure_s, facts.sky_adu, facts.refused
            );
            assert_eq!(counts, is_good, "{facts:?}");
        }
    }
}

fn row(sim: &Sim, index: usize) -> Option<(RowStatus, u32, String)> {
    let row = sim.schedule.get()?.sample.body.rows.get(index)?.clone();
    Some((row.status, row.frames, row.detail))
}

/// The members of all PUTs to a device.
fn puts(sim: &Sim, device: &str) -> Vec<String> {
    let all = sim.simulator.world().puts_since(0).into_iter();
    all.filter(|put| put.device.path() == device).map(|put| put.member).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn at_dusk_the_least_sensitive_filter_comes_first_and_a_restart_goes_on_counting() {
    let mut sim = Sim::with(twilight(-3.6, false), "", CAMERA, &DEVICES).await;
    let mut subscribers = Subscribers::of(&sim).await;
    sim.write_schedule(&[("flats", r#"{"filter": ["Clear", "B"], "n": [2, 3]}"#)], 3600.0);
    sim.start().await;
    sim.until("a flat that counts", MOST, |sim| row(sim, 0).is_some_and(|(_, frames, _)| frames > 0)).await;
    sim.kill_commander().await;
    sim.start_observatory().await;
    sim.until("finished", MOST, |sim| sim.ended(0).is_some()).await;
    subscribers.listen().await;
    subscribers.judged_rightly();
    assert_eq!(subscribers.filters(), [("B".to_owned(), 3), ("Clear".to_owned(), 2)]);
    assert_eq!(row(&sim, 0).unwrap(), (RowStatus::Finished, 5, String::new()));
    // The light goes, so what is exposed grows, filter by filter.
    let exposures: Vec<f64> =
        subscribers.flats().iter().filter(|(_, counts)| *counts).map(|(f, _)| f.exposure_s).collect();
    assert!(exposures[..3].is_sorted() && exposures[3..].is_sorted(), "{exposures:?}");
    // Test frames that only show the level are none of the flats, and are small.
    let looks = subscribers.received.iter().filter(|frame| frame.purpose.image_type == "Test Frame");
    assert!(looks.clone().count() >= 2);
    assert!(looks.clone().all(|frame| frame.width_px == 256 && frame.purpose.action == "flats_level"));
    // So is the level without light: small frames among a night's biases would be combined with them.
    assert!(looks.clone().any(|frame| frame.exposure_s == 0.0));
    assert!(subscribers.received.iter().all(|frame| frame.purpose.image_type != "Bias Frame"));
    // Each flat looked elsewhere, and none near the Sun.
    let slews = sim.simulator.world().puts_since(0).into_iter().filter(|put| put.member == "slewtocoordinatesasync");
    let places: Vec<String> = slews.map(|put| put.parameters).collect();
    let others: std::collections::BTreeSet<&String> = places.iter().collect();
    assert!(places.len() >= 5 && others.len() >= 5, "{places:?}");
    sim.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn at_dawn_what_is_still_too_dark_is_waited_for_and_the_most_sensitive_filter_comes_first() {
    let mut sim = Sim::with(twilight(-7.5, true), "", CAMERA, &DEVICES).await;
    let mut subscribers = Subscribers::of(&sim).await;
    sim.write_schedule(&[("flats", r#"{"filter": ["B", "Clear"], "n": [1, 1]}"#)], 3600.0);
    sim.start().await;
    sim.until("finished", MOST, |sim| sim.ended(0).is_some()).await;
    subscribers.listen().await;
    subscribers.judged_rightly();
    assert_eq!(subscribers.filters(), [("Clear".to_owned(), 1), ("B".to_owned(), 1)]);
    let exposures: Vec<f64> = subscribers.flats().iter().map(|(frame, _)| frame.exposure_s).collect();
    assert!(exposures.iter().all(|exposure_s| (5.0..=60.0).contains(exposure_s)), "{exposures:?}");
    sim.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panel_is_lit_behind_its_cover_and_left_dark_also_by_a_row_that_is_stopped() {
    let mut sim = Sim::with(telescope(SPEED), "", CAMERA, &DEVICES).await;
    let mut subscribers = Subscribers::of(&sim).await;
    let (short, long) =
        (r#"{"filter": ["V", "B"], "n": [2, 1], "source": "panel"}"#, r#"{"n": [500], "source": "panel"}"#);
    sim.write_schedule(&[("flats", short), ("flats", long)], 7200.0);
    sim.start().await;
    sim.until("the first row", MOST, |sim| sim.ended(0).is_some()).await;
    assert_eq!(row(&sim, 0).unwrap(), (RowStatus::Finished, 3, String::new()));
    sim.until("a flat of the second row", MOST, |sim| row(sim, 1).is_some_and(|(_, frames, _)| frames > 0)).await;
    subscribers.listen().await;
    subscribers.judged_rightly();
    let taken = subscribers.filters();
    assert!(taken.len() == 2 && taken[0] == ("V".to_owned(), 2), "{taken:?}");
    assert!(taken[1].0 == "B" && taken[1].1 >= 2, "that of the first row, and the second row's: {taken:?}");
    // Closed, lit, dark, and open as it was found on a safe sky; and the same again.
    let before = puts(&sim, "covercalibrator");
    let commands: Vec<&str> = before.iter().map(String::as_str).filter(|put| *put != "connected").collect();
    assert_eq!(commands.first(), Some(&"closecover"), "{commands:?}");
    let dark = commands.iter().position(|put| *put == "calibratoroff").unwrap();
    assert!(commands[1..dark].iter().all(|put| *put == "calibratoron") && dark > 1, "{commands:?}");
    assert_eq!(commands[dark + 1..dark + 4], ["opencover", "closecover", "calibratoron"], "{commands:?}");

    let order = Order {
        id: CommandId::fresh(),
        from: "test".to_owned(),
        reason: "a test".to_owned(),
        kind: OrderKind::Robotic(false),
        seen: None,
    };
    let address = contract::Address::new("test", "alpha").unwrap();
    let reply = crate::site::ask(&sim.bus, &address, &order).await;
    assert!(matches!(reply, Reply::Accepted(_)), "{reply:?}");
    let dark_again = |sim: &Sim| puts(sim, "covercalibrator")[before.len()..].contains(&"calibratoroff".to_owned());
    sim.until("dark", MOST, dark_again).await;
    sim.until("interrupted", MOST, |sim| row(sim, 1).is_some_and(|(status, ..)| status == RowStatus::Interrupted))
        .await;
    let after = puts(&sim, "covercalibrator")[before.len()..].to_vec();
    assert!(!after.contains(&"opencover".to_owned()), "{after:?}");
    // Nothing of the sky was needed.
    assert!(!puts(&sim, "dome").contains(&"openshutter".to_owned()));
    assert!(!puts(&sim, "telescope").contains(&"unpark".to_owned()));
    sim.stop().await;
}
