//! Stops a mount that tracks towards its limits, whichever other process is dead: without the schedule and without the
//! bus.
//!
//! Only tracking is watched. The driver brings a slew to its end, and a parked mount may be as low as it likes.

use std::time::Duration;

use bus::MachineTime;
use config::MountLimits;
use contract::device::telescope::{Command, Fields, PierSide};
use sky::{Observer, OfDate};

/// Tracking is stopped so long before a limit is reached: two polls and a slow answer.
const AHEAD_S: f64 = 10.0;
/// The sky turns by so much in a second, degrees.
const TURN_DEG_PER_S: f64 = 360.985_647_366 / 86_400.0;
/// A command that did not help is given again so much later.
const RETRY: Duration = Duration::from_secs(5);

/// The pier side that a mount reported while it tracked towards the meridian. A mount that reports the same side beyond
/// it has not turned over, by whatever name it calls the side: some drivers have the two the wrong way round.
#[derive(Debug, Default)]
pub struct Approach {
    side: Option<PierSide>,
}

impl Approach {
    /// Notes the mount's state. A slew, which may turn it over, begins anew; a value that is missing for a while does
    /// not.
    fn note(&mut self, fields: &Fields, hour_angle_h: f64) {
        // By six hours from the meridian it is the other passage, below the pole.
        if (-6.0..0.0).contains(&hour_angle_h) {
            self.side = reported_side(fields).or(self.side);
        } else if !(0.0..6.0).contains(&hour_angle_h) {
            self.side = None;
        }
    }

    /// Is the mount past the meridian on the side on which it came?
    fn stayed(&self, fields: &Fields) -> bool {
        self.side.is_some() && reported_side(fields).is_none_or(|side| self.side == Some(side))
    }
}

fn reported_side(fields: &Fields) -> Option<PierSide> {
    fields.pier_side.known().copied().filter(|side| *side != PierSide::Unknown)
}

/// Which limit a tracking mount reaches within the next seconds, in words with numbers and units.
pub fn reached(limits: &MountLimits, approach: &mut Approach, fields: &Fields, sky: &Observer) -> Option<String> {
    if fields.slewing.known() == Some(&true) || fields.at_park.known() == Some(&true) {
        *approach = Approach::default();
        return None;
    }
    let tracks = fields.tracking.known() == Some(&true);
    if !tracks {
        return None;
    }
    let place = fields.ra_deg.known().zip(fields.dec_deg.known()).map(|(ra, dec)| OfDate::from_degrees(*ra, *dec));
    // The altitude that the mount reports, else the one that follows from where it points.
    let altitude_deg = match fields.altitude_deg.known() {
        Some(altitude_deg) => Some(*altitude_deg),
        None => place.as_ref().map(|place| sky.of_date_to_horizontal(place).altitude.degrees()),
    };
    let margin_deg = AHEAD_S * TURN_DEG_PER_S;
    if let Some(altitude_deg) = altitude_deg.filter(|altitude_deg| *altitude_deg < limits.altitude_min_deg + margin_deg)
    {
        return Some(format!("altitude {altitude_deg:.2} deg, the limit is {} deg", limits.altitude_min_deg));
    }
    let ra_deg = place?.ra.degrees();
    let hour_angle_deg = (sky.sidereal_time().degrees() - ra_deg + margin_deg + 180.0).rem_euclid(360.0) - 180.0;
    let hour_angle_h = hour_angle_deg / 15.0;
    // Only the western limit is approached by tracking.
    if let Some(most_h) = limits.hour_angle_max_h.filter(|most_h| hour_angle_h > *most_h) {
        return Some(format!("hour angle {hour_angle_h:.3} h, the limit is {most_h} h"));
    }
    let past_min = hour_angle_h * 60.0;
    approach.note(fields, hour_angle_h);
    let looks_east = fields.pier_side.known() == Some(&PierSide::West) || approach.stayed(fields);
    // Within 90 deg of the meridian above the pole; below the pole a mount on that side moves away from it.
    let most_min = limits.meridian_past_min.filter(|most_min| looks_east && past_min > *most_min && past_min < 360.0);
    most_min
        .map(|most_min| format!("{past_min:.1} min past the meridian on the same pier side, the limit is {most_min}"))
}

/// What is done about it; pure.
#[derive(Debug, Default)]
pub struct LimitWatch {
    tries: u32,
    last: Option<MachineTime>,
}

impl LimitWatch {
    /// What the mount must do now: tracking off, and from the second time on a stop of all movement before it.
    pub fn look(&mut self, now: MachineTime, reached: bool) -> Vec<Command> {
        if !reached {
            *self = Self::default();
            return Vec::new();
        }
        if self.last.is_some_and(|last| now.since(last) < RETRY) {
            return Vec::new();
        }
        self.last = Some(now);
        self.tries += 1;
        let off = Command::Track { on: false };
        if self.tries == 1 { vec![off] } else { vec![Command::Abort, off] }
    }
}

#[cfg(test)]
#[path = "mount_limits_scenario_tests.rs"]
mod scenario_tests;

#[cfg(test)]
mod tests {
    use contract::Datum;
    use sky::{EarthOrientation, Place};
    use units::{Angle, Utc};

    use super::*;

    fn sky() -> Observer {
        let place = Place::new(Angle::from_degrees(-24.6), Angle::from_degrees(-70.4), 2500.0).unwrap();
        Observer::new(&place, &EarthOrientation::default(), Utc::from_seconds(1_795_228_200.0)).unwrap()
    }

    /// A mount that tracks at this hour angle and altitude.
    fn mount(hour_angle_h: f64, altitude_deg: Option<f64>, pier_side: PierSide) -> Fields {
        Fields {
            ra_deg: Datum::Known((sky().sidereal_time().degrees() - hour_angle_h * 15.0).rem_euclid(360.0)),
            dec_deg: Datum::Known(-24.6),
            altitude_deg: altitude_deg.map_or(Datum::default(), Datum::Known),
            tracking: Datum::Known(true),
            slewing: Datum::Known(false),
            at_park: Datum::Known(false),
            pier_side: Datum::Known(pier_side),
            ..Fields::default()
        }
    }

    const LIMITS: MountLimits =
        MountLimits { altitude_min_deg: 20.0, hour_angle_max_h: Some(5.0), meridian_past_min: Some(15.0) };

    fn why(fields: &Fields) -> String {
        reached(&LIMITS, &mut Approach::default(), fields, &sky()).unwrap_or_default()
    }

    #[test]
    fn tracking_ends_just_before_the_limit() {
        assert_eq!(why(&mount(4.0, Some(20.1), PierSide::East)), "");
        assert!(why(&mount(4.0, Some(20.03), PierSide::East)).starts_with("altitude 20.03 deg"));
        assert!(why(&mount(4.999, Some(30.0), PierSide::East)).starts_with("hour angle 5.00"));
        assert_eq!(why(&mount(-4.999, Some(30.0), PierSide::West)), "", "rising");
    }

    #[test]
    fn the_altitude_of_a_mount_that_does_not_report_it_is_reckoned() {
        // A star of declination = latitude passes the zenith, and stands 20 deg high 5.17 h later.
        assert_eq!(why(&mount(4.9, None, PierSide::East)), "");
        let low = mount(5.3, None, PierSide::East);
        assert!(why(&low).starts_with("altitude"), "{}", why(&low));
    }

    #[test]
    fn past_the_meridian_only_the_wrong_side_of_the_pier_is_stopped() {
        assert_eq!(why(&mount(0.24, Some(80.0), PierSide::West)), "");
        assert!(why(&mount(0.26, Some(80.0), PierSide::West)).contains("past the meridian"));
        assert_eq!(why(&mount(0.26, Some(80.0), PierSide::East)), "");
    }

    #[test]
    fn parked_slewing_and_resting_mounts_are_left_alone() {
        let low = mount(4.0, Some(1.0), PierSide::East);
        assert_eq!(why(&Fields { at_park: Datum::Known(true), ..low.clone() }), "");
        assert_eq!(why(&Fields { slewing: Datum::Known(true), ..low.clone() }), "");
        assert_eq!(why(&Fields { tracking: Datum::Known(false), ..low.clone() }), "");
        assert_ne!(why(&Fields { slewing: Datum::default(), ..low }), "", "unknown is no excuse");
    }

    #[test]
    fn the_command_is_sent_again_until_the_device_executes_it() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let mut watch = LimitWatch::default();
        let off = Command::Track { on: false };
        assert_eq!(watch.look(at(0), true), std::slice::from_ref(&off));
        assert_eq!(watch.look(at(1), true), []);
        assert_eq!(watch.look(at(5), true), [Command::Abort, off.clone()]);
        assert_eq!(watch.look(at(6), false), []);
        assert_eq!(watch.look(at(7), true), [off]);
    }
}
