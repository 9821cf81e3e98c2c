//! What goes wrong in the demo's night, so that everyone sees how a network answers.

use std::time::Duration;

use bus::Clock;
use simulator::{Fault, Kind, Quantity, Simulator};
use units::Utc;

use super::site::Plan;

/// The shower ends after this; the dome opens again when it has been dry for the dwell time.
const SHOWER_S: f64 = 720.0;
const STORM_S: f64 = 2400.0;
/// Over the limit of the demo's sites.
const STORM_MPS: f64 = 19.0;
/// A lost mount is noticed in machine time: at least so long in sky time, and in machine time. It begins shortly
/// before a row needs the mount, and ends while the row's window is open.
const LOST_S: (f64, f64) = (1200.0, 25.0);

/// Something that begins or ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum What {
    /// It rains at a site.
    Rain(bool),
    /// The wind at a site is over its limit.
    Storm(bool),
    /// A mount drops every connection.
    MountLost(bool),
}

/// Something that happens to one of the simulated observatories.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Happening {
    /// Sky time.
    pub at: Utc,
    /// The telescope, by its place in the plans.
    pub telescope: usize,
    /// What.
    pub what: What,
}

/// All of the night in the order of time: a shower over the first site; where there are more, a storm over the second one,
/// and a mount of the first site that is lost for a while.
pub fn happenings(plans: &[Plan], speed: f64) -> Vec<Happening> {
    let mut all = Vec::new();
    let mut lasting = |telescope: usize, from: Utc, seconds: f64, what: fn(bool) -> What| {
        for (at, is_on) in [(from, true), (from.plus_seconds(seconds), false)] {
            all.push(Happening { at, telescope, what: what(is_on) });
        }
    };
    let first_site = plans.first().map(|plan| plan.telescope.site);
    for (index, plan) in plans.iter().enumerate() {
        if Some(plan.telescope.site) == first_site {
            lasting(index, plan.night.at(0.55), SHOWER_S, What::Rain);
        } else {
            lasting(index, plan.night.at(0.3), STORM_S, What::Storm);
        }
    }
    if let Some(bad) = bad_night(plans) {
        lasting(bad, plans[bad].night.at(0.195), LOST_S.0.max(LOST_S.1 * speed), What::MountLost);
    }
    all.sort_by_key(|happening| happening.at);
    all
}

/// The telescope whose mount is lost, by its place.
pub fn bad_night(plans: &[Plan]) -> Option<usize> {
    (plans.len() > 1).then_some(1)
}

/// Lets them happen, each at its time; never ends.
pub async fn play(happenings: Vec<Happening>, plans: &[Plan], simulators: &[Simulator], clock: &Clock) {
    for Happening { at, telescope, what } in happenings {
        let wait_s = at.seconds_since(clock.utc()).max(0.0);
        clock.sleep_sky(Duration::from_secs_f64(wait_s)).await;
        let Some((simulator, plan)) = simulators.get(telescope).zip(plans.get(telescope)) else { continue };
        let world = simulator.world();
        let storm = |is_on: bool| is_on.then_some(STORM_MPS);
        let words = match what {
            What::Rain(is_on) => {
                world.rain(is_on);
                plan.is_first_of_site().then(|| format!("{} over {}", begins("rain", is_on), plan.telescope.site))
            }
            What::Storm(is_on) => {
                world.set_weather(Quantity::WindSpeed, storm(is_on));
                world.set_weather(Quantity::WindGust, storm(is_on).map(|mps| 1.3 * mps));
                plan.is_first_of_site().then(|| format!("{} over {}", begins("a storm", is_on), plan.telescope.site))
            }
            What::MountLost(true) => {
                world.fault(Kind::Telescope, Fault::refuse());
                Some(format!("the mount of {} is lost", plan.telescope.name))
            }
            What::MountLost(false) => {
                world.clear_faults();
                Some(format!("the mount of {} answers again", plan.telescope.name))
            }
        };
        // One line for a site.
        if let Some(words) = words.filter(|_| plans.len() > 1) {
            println!("{}  ** {words}", clock.utc().strftime("%H:%M:%S"));
        }
    }
    std::future::pending::<()>().await;
}

fn begins(what: &str, is_on: bool) -> String {
    format!("{what} {}", if is_on { "begins" } else { "ends" })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::site::MOST_TELESCOPES;

    #[test]
    fn each_site_has_a_weather_of_its_own_and_one_telescope_a_bad_night() {
        let now = "2026-06-21T12:00:00Z".parse().unwrap();
        for speed in [1.0, 150.0] {
            let plans = Plan::of(MOST_TELESCOPES, now).unwrap();
            let all = happenings(&plans, speed);
            assert!(all.windows(2).all(|pair| pair[0].at <= pair[1].at));
            let of = |telescope: usize| -> Vec<What> {
                all.iter().filter(|one| one.telescope == telescope).map(|one| one.what).collect()
            };
            let (rain, storm) = ([What::Rain(true), What::Rain(false)], [What::Storm(true), What::Storm(false)]);
            let lost = [What::MountLost(true), What::MountLost(false)];
            assert_eq!([of(0), of(1)], [rain.to_vec(), [lost, rain].concat()]);
            assert_eq!([of(2), of(3)], [storm.to_vec(), storm.to_vec()]);
            for one in &all {
                let night = &plans[one.telescope].night;
                assert!(night.dusk < one.at && one.at < night.dawn, "{one:?}");
            }
        }
        let alone = happenings(&Plan::of(1, now).unwrap(), 300.0);
        assert_eq!(alone.iter().map(|one| one.what).collect::<Vec<_>>(), [What::Rain(true), What::Rain(false)]);
    }
}
