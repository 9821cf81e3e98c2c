//! The sky of a few nights, computed once for all rows of a schedule.
//!
//! Every half hour an [`Observer`] is built; in between its axes turn with the Earth. Altitudes are good to half an
//! arcminute (aberration is that of the axes, the Sun and the Moon stand still for half an hour: 0.14 deg of the Moon),
//! which is far better than the altitudes of walls and trees are known.

use std::collections::HashMap;

use sky::{Body, EarthOrientation, Horizontal, Icrs, Observer, Place, SkyError};
use units::Utc;

use crate::action::Place as Aim;

/// Rows are looked at this often.
const STEP_US: i64 = 30_000_000;
/// For this long one observer is turned with the Earth.
const SLOT_US: i64 = 1_800_000_000;
/// Nights of one schedule: 80 days of half hours; a bound on the work, not on what is sensible.
const MOST_SLOTS: usize = 4000;
/// The sky of a window is looked at for so long at most, s.
const LONGEST_S: f64 = 2.0 * 86_400.0;
/// Turn of the Earth against the stars, rad/s (IERS Conventions 2010, table 1.2).
const EARTH_TURN_RAD_S: f64 = 7.292_115e-5;

/// A direction, ICRS axes, of length 1.
pub(super) type Vector = [f64; 3];

/// The axes of the site at an instant.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moment {
    pub at: Utc,
    pub east: Vector,
    pub north: Vector,
    pub zenith: Vector,
}

/// Half an hour.
#[derive(Debug)]
pub(super) struct Slot {
    middle: Moment,
    pole: Vector,
    moments: Vec<Moment>,
    pub sun: Vector,
    pub moon: Vector,
    /// Lit part of the Moon, 0 to 1.
    pub moon_lit: f64,
}

/// The observer: the site, and the orientation of the Earth.
#[derive(Debug, Clone)]
pub(super) struct Eye {
    place: Place,
    orientation: EarthOrientation,
}

impl Eye {
    /// The direction of a moving body at an instant; none where its path is not known then.
    pub fn sees(&self, body: &Body, at: Utc) -> Option<Vector> {
        let observer = Observer::new(&self.place, &self.orientation, at).ok()?;
        body.seen(&observer).ok().map(|seen| vector(&seen.icrs))
    }
}

/// The sky over the site.
pub(super) struct SkyTable {
    eye: Eye,
    slots: HashMap<i64, Option<Slot>>,
    left_out: usize,
}

impl SkyTable {
    /// Of a site.
    pub fn new(place: &config::Place) -> Result<Self, SkyError> {
        let (place, orientation) = place.on_earth()?;
        let eye = Eye { place, orientation };
        Ok(Self { eye, slots: HashMap::new(), left_out: 0 })
    }

    /// The observer.
    pub fn eye(&self) -> Eye {
        self.eye.clone()
    }

    /// The part that could not be checked, in words.
    pub fn unchecked(&self) -> Option<String> {
        let rows = match self.left_out {
            0 => return None,
            1 => "one row".to_owned(),
            many => format!("{many} rows"),
        };
        Some(format!("the sky of {rows}: too many different nights, or outside 1972 to 2099"))
    }

    /// Goes through a window in steps of 30 s, both ends included, two days at most; false where no sky is known of it.
    pub fn walk(&mut self, start: Utc, end: Utc, mut look: impl FnMut(&Moment, &Slot)) -> bool {
        let end = end.min(start.plus_seconds(LONGEST_S));
        let slots = slot_of(start)..=slot_of(end);
        for index in slots {
            let Some(slot) = self.slot(index) else {
                self.left_out += 1;
                return false;
            };
            if index == slot_of(start) {
                look(&slot.turned_to(start), slot);
            }
            slot.moments.iter().filter(|moment| start < moment.at && moment.at < end).for_each(|now| look(now, slot));
            if index == slot_of(end) {
                look(&slot.turned_to(end), slot);
            }
        }
        true
    }

    /// The direction of a row at an instant: an altitude and azimuth mean the place that was there at `begin`.
    pub fn direction(&mut self, aim: &Aim, begin: Utc) -> Option<Vector> {
        match aim {
            Aim::Moving(body) => self.eye.sees(body, begin),
            Aim::Icrs(place) => place.checked().ok().map(|place| vector(&place)),
            Aim::Horizontal(place) => {
                let now = self.slot(slot_of(begin))?.turned_to(begin);
                let (altitude, azimuth) = (place.altitude, place.azimuth);
                let along = [azimuth.sin() * altitude.cos(), azimuth.cos() * altitude.cos(), altitude.sin()];
                let axes = [now.east, now.north, now.zenith];
                Some(std::array::from_fn(|i| along.iter().zip(&axes).map(|(part, axis)| part * axis[i]).sum()))
            }
        }
    }

    fn slot(&mut self, index: i64) -> Option<&Slot> {
        if self.slots.len() >= MOST_SLOTS && !self.slots.contains_key(&index) {
            return None;
        }
        let Eye { place, orientation } = &self.eye;
        self.slots.entry(index).or_insert_with(|| Slot::new(place, orientation, index).ok()).as_ref()
    }
}

/// The half hour of an instant.
pub(super) fn slot_of(at: Utc) -> i64 {
    at.micros().div_euclid(SLOT_US)
}

impl Slot {
    fn new(place: &Place, orientation: &EarthOrientation, index: i64) -> Result<Self, SkyError> {
        let begin = index.saturating_mul(SLOT_US);
        let at = Utc::from_micros(begin.saturating_add(SLOT_US / 2));
        let observer = Observer::new(place, orientation, at)?;
        let axis =
            |altitude_deg, azimuth_deg| vector(&observer.to_icrs(&Horizontal::from_degrees(altitude_deg, azimuth_deg)));
        let middle = Moment { at, east: axis(0.0, 90.0), north: axis(0.0, 0.0), zenith: axis(90.0, 0.0) };
        let (sin, cos) = (place.latitude().sin(), place.latitude().cos());
        let pole = std::array::from_fn(|i| cos * middle.north[i] + sin * middle.zenith[i]);
        let (sun, moon) = (vector(&observer.sun_icrs()), vector(&observer.moon_icrs()));
        let mut slot = Self { middle, pole, moments: Vec::new(), sun, moon, moon_lit: observer.moon_illumination() };
        let steps = 0..SLOT_US / STEP_US;
        slot.moments = steps.map(|step| slot.turned_to(Utc::from_micros(begin + step * STEP_US))).collect();
        Ok(slot)
    }

    fn turned_to(&self, at: Utc) -> Moment {
        let angle = EARTH_TURN_RAD_S * at.seconds_since(self.middle.at);
        let turned = |axis: &Vector| rotated(axis, &self.pole, angle);
        let Moment { east, north, zenith, .. } = &self.middle;
        Moment { at, east: turned(east), north: turned(north), zenith: turned(zenith) }
    }

    /// Hour angle of a direction, h, negative in the east.
    pub fn hour_angle_h(&self, now: &Moment, place: &Vector) -> f64 {
        // The meridian's point of the equator is the zenith without its part along the pole.
        let along = dot(&now.zenith, &self.pole);
        let south: Vector = std::array::from_fn(|i| now.zenith[i] - along * self.pole[i]);
        let to_meridian = dot(place, &south) / dot(&south, &south).sqrt().max(1e-9);
        (-dot(place, &now.east)).atan2(to_meridian).to_degrees() / 15.0
    }
}

/// Turned about an axis by an angle, rad, right-handed (Rodrigues' formula).
fn rotated(v: &Vector, axis: &Vector, angle: f64) -> Vector {
    let (sin, cos) = angle.sin_cos();
    let cross = [axis[1] * v[2] - axis[2] * v[1], axis[2] * v[0] - axis[0] * v[2], axis[0] * v[1] - axis[1] * v[0]];
    let along = dot(axis, v) * (1.0 - cos);
    std::array::from_fn(|i| v[i] * cos + cross[i] * sin + axis[i] * along)
}

/// Cosine of the angle between two directions.
pub(super) fn dot(a: &Vector, b: &Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Distance between the ends of two directions, which grows with the angle between them and is quicker to have.
pub(super) fn chord(a: &Vector, b: &Vector) -> f64 {
    let apart: Vector = std::array::from_fn(|i| a[i] - b[i]);
    dot(&apart, &apart).sqrt()
}

/// The angle of a chord, degrees.
pub(super) fn angle_deg(chord: f64) -> f64 {
    (2.0 * (0.5 * chord).min(1.0).asin()).to_degrees()
}

/// As a vector.
pub(super) fn vector(place: &Icrs) -> Vector {
    let (ra, dec) = (place.ra, place.dec);
    [dec.cos() * ra.cos(), dec.cos() * ra.sin(), dec.sin()]
}

#[cfg(test)]
mod tests {
    use units::Angle;

    use super::*;

    fn table() -> (SkyTable, Place) {
        let place = Place::new(Angle::from_degrees(-24.6157), Angle::from_degrees(-70.3976), 2518.0).unwrap();
        let eye = Eye { place, orientation: EarthOrientation::default() };
        (SkyTable { eye, slots: HashMap::new(), left_out: 0 }, place)
    }

    #[test]
    fn it_answers_as_an_observer_does_at_every_moment_of_a_night() {
        let (mut sky, place) = table();
        let (start, end) = ("2026-11-21T00:07:11Z".parse().unwrap(), "2026-11-21T09:13:00Z".parse().unwrap());
        for (ra_deg, dec_deg) in [(10.0, -60.0), (83.6, 22.0), (200.0, -24.0), (300.0, 0.0)] {
            let star = Icrs::from_degrees(ra_deg, dec_deg);
            let aim = sky.direction(&Aim::Icrs(star), start).unwrap();
            let (mut worst_deg, mut count) = (0.0_f64, 0);
            assert!(sky.walk(start, end, |now, slot| {
                count += 1;
                if count % 37 != 1 {
                    return;
                }
                let observer = Observer::new(&place, &EarthOrientation::default(), now.at).unwrap();
                let exact = observer.to_horizontal(&star);
                let altitude_deg = dot(&now.zenith, &aim).asin().to_degrees();
                worst_deg = worst_deg.max((altitude_deg - exact.altitude.degrees()).abs());
                let azimuth = Angle::from_radians(dot(&now.east, &aim).atan2(dot(&now.north, &aim)));
                let off = (azimuth - exact.azimuth).wrapped_signed().degrees() * exact.altitude.cos();
                worst_deg = worst_deg.max(off.abs());
                let hour_angle_deg = slot.hour_angle_h(now, &aim) * 15.0;
                let off = Angle::from_degrees(hour_angle_deg) - observer.hour_angle(&star);
                worst_deg = worst_deg.max(off.wrapped_signed().degrees().abs() * dec_deg.to_radians().cos());
            }));
            assert_eq!(count, 1093, "every 30 s and both ends");
            assert!(worst_deg < 0.02, "{ra_deg} {dec_deg}: {worst_deg} deg");
        }
    }

    #[test]
    fn what_stands_at_an_altitude_and_azimuth_is_found_there() {
        let (mut sky, place) = table();
        let at = "2026-11-21T03:20:00Z".parse().unwrap();
        let aim = sky.direction(&Aim::Horizontal(Horizontal::from_degrees(35.0, 250.0)), at).unwrap();
        let observer = Observer::new(&place, &EarthOrientation::default(), at).unwrap();
        let exact = vector(&observer.to_icrs(&Horizontal::from_degrees(35.0, 250.0)));
        assert!(angle_deg(chord(&aim, &exact)) < 0.02);
    }

    #[test]
    fn a_time_of_which_no_sky_is_known_is_left_out_and_reported() {
        let (mut sky, _) = table();
        assert!(!sky.walk(Utc::EPOCH, Utc::EPOCH.plus_seconds(60.0), |_, _| ()));
        assert!(sky.unchecked().unwrap().contains("one row"));
    }
}
