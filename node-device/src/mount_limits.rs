//! Stops a mount that tracks towards its limits, whichever other process is dead: without the schedule and without the
//! bus.
//!
//! Only tracking is watched. The driver brings a slew to its end, and a parked mount may be as low as it likes. A mount
//! is believed by its coordinates where its flags say otherwise, and no reading from before a slew or an order is judged
//! by ([`crate::mount_sight`]).

mod stopping;

use std::time::Duration;

use bus::MachineTime;
use config::MountLimits;
use contract::device::telescope::{BeyondLimit, Command, EquatorialSystem, PierSide};
use sky::{Icrs, Meridian, Observer, OfDate, nearest_meridian};
use units::Angle;

use self::stopping::{Says, Stopping};
use crate::mount_motion::{Coordinates, Motion, TURN_DEG_PER_S, pair};
use crate::mount_sight::{MountSight, Ordered, ReadAt, asked_since};
use crate::now::Now;

/// Tracking is stopped so long before a limit is reached: two polls and a slow answer.
const AHEAD_S: f64 = 10.0;
/// Altitudes that a mount reports and that follow from its place differ by less, deg: refraction, frames of coordinates
/// and pointing models.
const SAME_ALTITUDE_DEG: f64 = 1.5;
/// A mount that begins to track beyond a limit has so long to be slewed away from there, machine time.
const BEGINS: Duration = Duration::from_secs(30);
/// A mount that was sent somewhere reports that it moves within this, machine time.
const GOES: Duration = Duration::from_secs(15);
/// However often it is ordered to go, a mount tracks beyond a limit no longer than this, machine time.
const LONGEST: Duration = Duration::from_secs(120);
/// A mount that says for so long that it slews, and does not move against the stars, tracks; machine time.
const STILL: Duration = Duration::from_secs(60);
/// A mount that tracks is stopped if nobody knows for so long where it points, machine time.
const UNKNOWN: Duration = Duration::from_secs(60);

/// The pier side that a mount reported while it tracked towards a meridian. A mount that reports the same side beyond
/// it has not turned over, by whatever name it calls the side: some drivers have the two the wrong way round.
#[derive(Debug, Default)]
struct Approach {
    side: Option<PierSide>,
}

impl Approach {
    /// Notes the side before a meridian. A value that is missing for a while changes nothing.
    fn note(&mut self, side: Option<PierSide>, past_h: f64) {
        if past_h < 0.0 {
            self.side = side.or(self.side);
        }
    }

    /// Is the mount past the meridian on the side on which it came?
    fn stayed(&self, side: Option<PierSide>) -> bool {
        self.side.is_some() && side.is_none_or(|side| self.side == Some(side))
    }
}

/// Where a mount points, as far as that is known.
#[derive(Debug, Clone, Copy, Default)]
struct Pointing {
    place: Option<OfDate>,
    altitude_deg: Option<f64>,
    side: Option<PierSide>,
}

/// Which limit a tracking mount reaches within the next seconds, in words with numbers and units.
fn reached(limits: &MountLimits, approach: &mut Approach, pointing: &Pointing, sky: &Observer) -> Option<String> {
    let reckoned_deg = pointing.place.map(|place| sky.of_date_to_horizontal(&place).altitude.degrees());
    // The altitude that the mount reports, unless its own place contradicts: then the lower one.
    let altitude_deg = match (pointing.altitude_deg, reckoned_deg) {
        (Some(reported), Some(reckoned)) if (reported - reckoned).abs() > SAME_ALTITUDE_DEG => {
            Some(reported.min(reckoned))
        }
        (reported, reckoned) => reported.or(reckoned),
    };
    let margin_deg = AHEAD_S * TURN_DEG_PER_S;
    if let Some(altitude_deg) = altitude_deg.filter(|altitude_deg| *altitude_deg < limits.altitude_min_deg + margin_deg)
    {
        return Some(format!("altitude {altitude_deg:.2} deg, the limit is {} deg", limits.altitude_min_deg));
    }
    let ra_deg = pointing.place?.ra.degrees();
    let hour_angle_deg = (sky.sidereal_time().degrees() - ra_deg + margin_deg + 180.0).rem_euclid(360.0) - 180.0;
    let hour_angle_h = hour_angle_deg / 15.0;
    // Only the western limit is approached by tracking.
    if let Some(most_h) = limits.hour_angle_max_h.filter(|most_h| hour_angle_h > *most_h) {
        return Some(format!("hour angle {hour_angle_h:.3} h, the limit is {most_h} h"));
    }
    let (meridian, past) = nearest_meridian(Angle::from_degrees(hour_angle_deg));
    approach.note(pointing.side, past.hours());
    // Past the upper meridian a tube west of the pier looks back over it; past the lower one, one east of it.
    let (wrong, which) = match meridian {
        Meridian::Upper => (PierSide::West, "meridian"),
        Meridian::Lower => (PierSide::East, "lower meridian"),
    };
    let past_min = past.hours() * 60.0;
    let most_min = limits.meridian_past_min.filter(|most_min| past_min > *most_min)?;
    (pointing.side == Some(wrong) || approach.stayed(pointing.side))
        .then(|| format!("{past_min:.1} min past the {which} on the same pier side, the limit is {most_min}"))
}

/// What becomes of the alert about a mount's limits.
#[derive(Debug, Clone, PartialEq)]
pub enum Alarm {
    /// It is raised, with this cause.
    Raise(String),
    /// It ends: the mount tracks within its limits.
    Clear,
    /// It stays as it is: a mount that stops at once would otherwise clear it before a person could see it.
    Leave,
}

/// What a look at a mount led to.
#[derive(Debug, Clone, PartialEq)]
pub struct Looked {
    /// The mount must do this now, one after the other.
    pub commands: Vec<Command>,
    /// What is published of it.
    pub beyond: Option<BeyondLimit>,
    /// The alert.
    pub alarm: Alarm,
}

impl Looked {
    fn nothing(alarm: Alarm) -> Self {
        Self { commands: Vec::new(), beyond: None, alarm }
    }
}

/// A mount that says that it is parked, and whose coordinates do not tell, is believed after so long.
const SHOWS_PARKED: Duration = Duration::from_secs(20);

/// Watches one mount; pure.
#[derive(Debug)]
pub struct LimitWatch {
    limits: MountLimits,
    /// A park that takes longer has failed.
    park: Duration,
    approach: Approach,
    coordinates: Coordinates,
    /// When it was first read that the mount does not slew and is not parked.
    at_rest: Option<MachineTime>,
    /// Right ascension and declination of the last reading at rest, degrees.
    place_deg: Option<[f64; 2]>,
    /// Where it was when it said that it slews, and since when it has not moved from there.
    still: Option<([f64; 2], MachineTime)>,
    /// It tracked when that was known last.
    tracked: Option<bool>,
    /// It has tracked within its limits since it was moved or stood.
    was_within: bool,
    /// The last that was seen of its motion before it came to rest is a slew: it is where somebody sent it.
    has_arrived: bool,
    /// The order after which it was read last that it slews.
    went: Option<MachineTime>,
    /// It tracks beyond a limit.
    beyond_since: Option<MachineTime>,
    /// Since when it says that it is parked.
    parked: Option<MachineTime>,
    /// Its coordinates follow the sky although it says that it is parked.
    parked_lies: bool,
    stopping: Option<Stopping>,
}

impl LimitWatch {
    /// A watch that has seen nothing; a park takes at most so long.
    pub fn new(limits: MountLimits, park: Duration) -> Self {
        Self {
            limits,
            park,
            approach: Approach::default(),
            coordinates: Coordinates::default(),
            at_rest: None,
            place_deg: None,
            still: None,
            tracked: None,
            was_within: false,
            has_arrived: false,
            went: None,
            beyond_since: None,
            parked: None,
            parked_lies: false,
            stopping: None,
        }
    }

    /// What the mount must do now.
    pub fn look(&mut self, now: MachineTime, sight: &MountSight, sky: &Observer, can_park: bool) -> Looked {
        let ordered = sight.ordered.map_or(MachineTime::from_boot(Duration::ZERO), |(_, at)| at);
        match asked_since(sight.at_park, ordered) {
            Some((true, asked)) => {
                if let Some(looked) = self.rests_in_park(now, asked.machine, sight) {
                    return looked;
                }
            }
            Some((false, _)) => (self.parked, self.parked_lies) = (None, false),
            None => {}
        }
        if let Some((true, asked)) = asked_since(sight.slewing, ordered)
            && !self.is_still(sight, asked)
        {
            self.slews(sight.ordered);
            self.went = Some(ordered);
            return self.go_on(now, Says::Slews, can_park);
        }
        let Some(rest_since) = self.rest_since(sight, ordered, now) else {
            return self.go_on(now, Says::Nothing, can_park);
        };
        self.coordinates.note(sight, rest_since);
        let place = pair(sight.ra_deg, sight.dec_deg, rest_since);
        self.place_deg = place.map(|(place, _)| place).or(self.place_deg);
        let flag = asked_since(sight.tracking, rest_since).map(|(tracking, _)| tracking);
        let says = if flag == Some(false) { Says::StandsStill } else { Says::Nothing };
        let motion = self.coordinates.motion();
        if self.stopping.is_some() && (motion == Motion::Stands || (flag == Some(false) && motion == Motion::Moves)) {
            // Its own coordinates show that it does not follow the sky any more.
            self.stopping = None;
        }
        if self.stopping.as_ref().is_some_and(Stopping::has_slewed)
            && place.is_some()
            && self.why(now, rest_since, sight, sky).is_none()
        {
            // A slew has brought it back within its limits.
            self.stopping = None;
        }
        if self.stopping.is_some() {
            return self.go_on(now, says, can_park);
        }
        let tracks = self.tracks(flag, motion);
        if flag.is_some() {
            self.tracked = Some(tracks);
        }
        if !tracks {
            (self.was_within, self.beyond_since) = (false, None);
            // Once it was read that it stands, it is not where a slew has left it any more.
            self.has_arrived &= flag.is_none() && motion != Motion::Stands;
            return Looked::nothing(Alarm::Leave);
        }
        let Some(why) = self.why(now, rest_since, sight, sky) else {
            (self.was_within, self.beyond_since) = (true, None);
            return Looked::nothing(if place.is_some() { Alarm::Clear } else { Alarm::Leave });
        };
        let since = *self.beyond_since.get_or_insert(now);
        if self.may_yet_go(now, since, sight.ordered) {
            return Looked::nothing(Alarm::Leave);
        }
        self.stopping = Some(Stopping::begin(why));
        self.go_on(now, says, can_park)
    }

    /// It says that it is parked: what follows, unless its coordinates show that it goes on with the sky. A mount that was
    /// being stopped has a moment to show by them that it stands.
    fn rests_in_park(&mut self, now: MachineTime, asked: MachineTime, sight: &MountSight) -> Option<Looked> {
        if self.parked.is_none() {
            self.moved(false);
        }
        let since = *self.parked.get_or_insert(asked);
        self.coordinates.note(sight, since);
        let dec = pair(sight.ra_deg, sight.dec_deg, since).map(|([_, dec], _)| dec);
        let turns = dec.and_then(|dec| self.coordinates.turns_with_the_sky(dec));
        let motion = self.coordinates.motion();
        let is_shown = match (motion, turns) {
            (Motion::Follows, Some(turns)) => {
                self.parked_lies = turns;
                true
            }
            (Motion::Stands | Motion::Moves, _) => {
                self.parked_lies = false;
                true
            }
            _ => false,
        };
        if self.parked_lies {
            return None;
        }
        match &self.stopping {
            Some(stopping) if !is_shown && now.since(since) < SHOWS_PARKED => {
                Some(Looked { commands: Vec::new(), beyond: Some(stopping.published()), alarm: Alarm::Leave })
            }
            _ => {
                self.stopping = None;
                Some(Looked::nothing(Alarm::Leave))
            }
        }
    }

    /// It says that it slews. Where nobody has ordered that since it was ordered to stop, it may only slow down: the stopping
    /// goes on where it comes to rest, and the pier side on which it came there still counts.
    fn slews(&mut self, ordered: Option<(Ordered, MachineTime)>) {
        if self.stopping.as_ref().is_some_and(|stopping| stopping.is_sent_away(ordered)) {
            self.stopping = None;
        }
        let approach = std::mem::take(&mut self.approach);
        self.moved(true);
        if self.stopping.is_some() {
            self.approach = approach;
        }
    }

    /// The mount was moved, by a slew or with its park: what was read before shows nothing of now.
    fn moved(&mut self, by_slew: bool) {
        (self.approach, self.at_rest, self.place_deg, self.tracked) = (Approach::default(), None, None, None);
        (self.was_within, self.has_arrived, self.beyond_since) = (false, by_slew, None);
        self.coordinates.forget();
    }

    /// Readings since then show the mount at rest; `None` while the newest order is not read back yet.
    fn rest_since(&mut self, sight: &MountSight, ordered: MachineTime, now: MachineTime) -> Option<MachineTime> {
        // Unknown is no excuse: a mount that does not say whether it slews is watched all the same.
        let asked = match (sight.slewing, asked_since(sight.slewing, ordered)) {
            (Some(_), None) => return None,
            (_, read) => read.map_or(now, |(_, asked)| asked.machine),
        };
        if sight.slewing.is_none_or(|(slews, _)| !slews) {
            self.still = None;
        }
        let at_rest = *self.at_rest.get_or_insert(asked);
        Some(at_rest.max(ordered))
    }

    /// It says that it slews, and has not moved against the stars for long.
    fn is_still(&mut self, sight: &MountSight, asked: Now) -> bool {
        let place: ReadAt<[f64; 2]> = pair(sight.ra_deg, sight.dec_deg, MachineTime::from_boot(Duration::ZERO));
        let Some(([ra, dec], _)) = place else { return false };
        let near = |[ra0, dec0]: [f64; 2]| (ra - ra0).abs() < 0.02 && (dec - dec0).abs() < 0.02;
        match self.still {
            Some((place, since)) if near(place) => asked.machine.since(since) >= STILL,
            _ => {
                self.still = Some(([ra, dec], asked.machine));
                false
            }
        }
    }

    /// Does it track, by its coordinates where they contradict its flag?
    fn tracks(&self, flag: Option<bool>, motion: Motion) -> bool {
        match (flag, motion) {
            (_, Motion::Stands) => false,
            (Some(true), _) => true,
            // Some drivers report the last place for ever while a mount stands; altitude and azimuth tell the two apart.
            (Some(false), Motion::Follows) => {
                self.place_deg.and_then(|[_, dec]| self.coordinates.turns_with_the_sky(dec)) == Some(true)
            }
            (Some(false), _) => false,
            // One that is away, or does not say, goes on as it did; unknown is no excuse.
            (None, _) => self.tracked.unwrap_or(self.place_deg.is_some()),
        }
    }

    /// Which limit it reaches.
    fn why(&mut self, now: MachineTime, since: MachineTime, sight: &MountSight, sky: &Observer) -> Option<String> {
        let is_frozen = self.place_deg.and_then(|[_, dec]| self.coordinates.turns_with_the_sky(dec)) == Some(false);
        let altitude_deg = asked_since(sight.altitude_deg, since).map(|(altitude, _)| altitude);
        let pointing = Pointing {
            // A mount whose place is missing for a while has tracked on from the last one.
            place: self.place_deg.map(|[ra, dec]| match sight.system {
                EquatorialSystem::Topocentric => OfDate::from_degrees(ra, dec),
                // As it is pointed and as its slit is turned.
                _ => sky.to_of_date(&Icrs::from_degrees(ra, dec)),
            }),
            altitude_deg: altitude_deg.filter(|_| !is_frozen),
            side: asked_since(sight.pier_side, since).map(|(side, _)| side),
        };
        if pointing.place.is_none() && pointing.altitude_deg.is_none() {
            let unknown = now.since(since);
            let seconds = unknown.as_secs();
            return (unknown >= UNKNOWN)
                .then(|| format!("it tracks, and where it points is not known for {seconds} s"));
        }
        reached(&self.limits, &mut self.approach, &pointing, sky)
    }

    /// A mount that has begun beyond its limits, and one that was sent somewhere, may yet be on its way. One that a slew has
    /// brought there is not.
    fn may_yet_go(&self, now: MachineTime, beyond: MachineTime, ordered: Option<(Ordered, MachineTime)>) -> bool {
        if now.since(beyond) >= LONGEST {
            return false;
        }
        match ordered {
            Some((Ordered::Go, at)) if self.went != Some(at) && now.since(at) < GOES => true,
            Some((Ordered::Begin, at)) => !self.was_within && now.since(at.max(beyond)) < BEGINS,
            _ => !self.was_within && !self.has_arrived && now.since(beyond) < BEGINS,
        }
    }

    /// Goes on with the stopping, if there is one.
    fn go_on(&mut self, now: MachineTime, says: Says, can_park: bool) -> Looked {
        let Some(stopping) = &mut self.stopping else { return Looked::nothing(Alarm::Leave) };
        let commands = stopping.look(now, says, can_park.then_some(self.park));
        let (beyond, cause) = (stopping.published(), stopping.cause());
        Looked { commands, beyond: Some(beyond), alarm: Alarm::Raise(cause) }
    }
}

#[cfg(test)]
#[path = "mount_limits_reached_tests.rs"]
mod reached_tests;

#[cfg(test)]
#[path = "mount_limits_scenario_tests.rs"]
mod scenario_tests;

#[cfg(test)]
#[path = "mount_limits_tests.rs"]
mod tests;
