//! Whether a mount is parked, by its flags and by its coordinates; pure.
//!
//! Some drivers report `AtPark` as soon as they accept `Park`, and deny meanwhile that they slew. A mount that says that
//! it is parked is believed once its coordinates have rested since; one that tells none is believed by its flags.

use std::time::Duration;

use contract::Datum;
use contract::device::telescope::Fields;
use units::MachineTime;

/// Coordinates rest that were read twice at one place, so long apart at least.
const REST: Duration = Duration::from_secs(2);
/// Readings so far apart show nothing of what was between them.
const APART: Duration = Duration::from_secs(60);
/// A mount that has told no coordinates for so long is believed by its flags: some tell none in their park.
const UNTOLD: Duration = Duration::from_secs(20);
/// One place, degrees: far less than a mount slews in [`REST`].
const SAME_DEG: f64 = 0.1;
/// The sky turns by less in a second, degrees: the right ascension of a mount that stands runs so fast.
const SKY_DEG_PER_S: f64 = 0.005;

/// Where a mount says that it points, thousandths of a degree: whole numbers, so that states can be compared and
/// hashed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Place {
    around: i32,
    up: i32,
    /// When the older one of the two was asked for.
    from: MachineTime,
    /// When the newer one was.
    to: MachineTime,
}

impl Place {
    /// By azimuth and altitude where both are known, in which a parked mount rests; else by right ascension and
    /// declination. `asked`: when the property of this name was asked for.
    pub fn of(fields: &Fields, asked: impl Fn(&str) -> MachineTime) -> Option<Self> {
        let pair = |around: &Datum<f64>, up: &Datum<f64>, names: [&str; 2]| -> Option<Self> {
            let thousandths = |deg: f64| (deg * 1e3).round() as i32;
            let (around, up) = (thousandths(*around.known()?), thousandths(*up.known()?));
            let [one, other] = names.map(&asked);
            Some(Self { around, up, from: one.min(other), to: one.max(other) })
        };
        pair(&fields.azimuth_deg, &fields.altitude_deg, ["Azimuth", "Altitude"])
            .or_else(|| pair(&fields.ra_deg, &fields.dec_deg, ["RightAscension", "Declination"]))
    }

    /// The same where all that is known of the answers is that they have come by then.
    pub fn answered(self, by: MachineTime) -> Self {
        Self { to: by.max(self.to), ..self }
    }

    /// The angle between two places, degrees.
    fn apart_deg(self, other: Self) -> f64 {
        let radians = |thousandths: i32| (f64::from(thousandths) / 1e3).to_radians();
        let (up, other_up) = (radians(self.up), radians(other.up));
        let half = |a: f64, b: f64| ((a - b) / 2.0).sin().powi(2);
        let around = half(radians(self.around), radians(other.around));
        let square = half(up, other_up) + up.cos() * other_up.cos() * around;
        2.0 * square.sqrt().min(1.0).asin().to_degrees()
    }
}

/// What was read of a mount.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ParkReading {
    /// Its flags say that it is parked: `Fields::parked`.
    pub says_parked: bool,
    /// Where it points; `None` where it is not known.
    pub place: Option<Place>,
}

/// What is known of one mount.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Parked {
    /// Since when it says that it is parked.
    since: Option<MachineTime>,
    /// Where it was then, or after it moved last.
    place: Option<Place>,
    /// When it told its coordinates last.
    told: Option<MachineTime>,
    is_believed: bool,
}

impl Parked {
    /// It is parked.
    pub fn is_parked(self) -> bool {
        self.is_believed
    }

    /// The same with another reading, whose flags were asked for at `asked`.
    pub fn after(self, reading: ParkReading, asked: MachineTime) -> Self {
        let told = reading.place.map(|place| place.to).or(self.told);
        if !reading.says_parked {
            return Self { told, ..Self::default() };
        }
        let since = self.since.unwrap_or(asked);
        let known = Self { since: Some(since), told, ..self };
        let Some(place) = reading.place else {
            let tells_none = told.is_none_or(|told| asked.since(told) >= UNTOLD);
            return Self { is_believed: self.is_believed || tells_none, ..known };
        };
        if place.from < since {
            // From before it said so: it may not have begun to move.
            return known;
        }
        let Some(before) = self.place else {
            return Self { place: reading.place, is_believed: false, ..known };
        };
        let longest = place.to.since(before.from);
        let stays = place.apart_deg(before) <= SAME_DEG + SKY_DEG_PER_S * longest.as_secs_f64();
        if !stays || longest > APART {
            return Self { place: reading.place, is_believed: false, ..known };
        }
        // Each of its coordinates is so much newer.
        if place.from.since(before.to) < REST {
            return known;
        }
        Self { place: reading.place, is_believed: true, ..known }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs_f64(1000.0 + seconds))
    }

    /// A mount at this altitude, degrees, as it is read at this second.
    fn read(says_parked: bool, altitude_deg: f64, second: f64) -> ParkReading {
        let (altitude_deg, azimuth_deg) = (Datum::Known(altitude_deg), Datum::Known(180.0));
        let fields = Fields { altitude_deg, azimuth_deg, ..Fields::default() };
        ParkReading { says_parked, place: Place::of(&fields, |_| at(second)) }
    }

    /// Readings in each second, from `from` to before `to`, and the first second at which it is parked.
    fn first_parked(parked: &mut Parked, from: u32, to: u32, reading: impl Fn(f64) -> ParkReading) -> Option<f64> {
        (from..to).map(f64::from).find(|second| {
            *parked = parked.after(reading(*second), at(*second));
            parked.is_parked()
        })
    }

    #[test]
    fn a_mount_that_says_so_on_its_way_is_parked_once_it_rests() {
        let mut parked = Parked::default();
        assert_eq!(first_parked(&mut parked, 0, 10, |second| read(false, 60.0, second)), None);
        // It has not begun to move yet, moves by half a degree per second, and stands.
        assert_eq!(first_parked(&mut parked, 10, 12, |second| read(true, 60.0, second)), None);
        assert_eq!(first_parked(&mut parked, 12, 60, |second| read(true, 65.5 - second / 2.0, second)), None);
        assert_eq!(first_parked(&mut parked, 60, 90, |second| read(true, 36.0, second)), Some(61.0));
    }

    #[test]
    fn a_reading_from_before_it_said_so_shows_no_rest() {
        let mut parked = Parked::default().after(read(false, 60.0, 0.0), at(0.0));
        // The coordinates are read more rarely than the flags.
        assert_eq!(first_parked(&mut parked, 6, 10, |_| read(true, 60.0, 5.0)), None);
        assert_eq!(first_parked(&mut parked, 10, 20, |_| read(true, 60.0, 9.5)), None, "one reading is no rest");
        assert!(parked.after(read(true, 60.0, 20.0), at(20.0)).is_parked());
    }

    #[test]
    fn a_mount_that_is_parked_from_the_start_and_rests_is_parked_after_two_seconds() {
        let mut parked = Parked::default();
        assert_eq!(first_parked(&mut parked, 0, 10, |second| read(true, 10.0, second)), Some(2.0));
        assert!(parked.after(read(true, 10.05, 2.5), at(2.5)).is_parked(), "it trembles");
        assert!(!parked.after(read(true, 12.0, 3.0), at(3.0)).is_parked(), "it is moved");
        assert!(!parked.after(read(false, 10.0, 3.0), at(3.0)).is_parked(), "it does not say so any more");
        assert!(!parked.after(read(true, 10.0, 90.0), at(90.0)).is_parked(), "nobody saw it for long");
    }

    #[test]
    fn a_mount_without_coordinates_is_believed_by_its_flags_at_once_or_20_s_after_it_told_them_last() {
        let none = |says_parked| ParkReading { says_parked, place: None };
        assert!(Parked::default().after(none(true), at(0.0)).is_parked());
        assert!(!Parked::default().after(none(false), at(0.0)).is_parked());
        let mut parked = Parked::default().after(read(false, 60.0, 5.0), at(5.0));
        assert_eq!(first_parked(&mut parked, 6, 60, |_| none(true)), Some(25.0));
        let mut rests = Parked::default();
        first_parked(&mut rests, 0, 10, |second| read(true, 10.0, second));
        assert!(rests.after(none(true), at(3.0)).is_parked(), "one answer that is missing moves nothing");
    }

    #[test]
    fn right_ascension_and_declination_serve_where_altitude_and_azimuth_are_not_known() {
        // The sky runs past a mount that stands, and its right ascension begins anew; near the pole it means little.
        let rests = |second: f64| ((359.99 + second * 15.04 / 3600.0).rem_euclid(360.0), 20.0);
        let at_the_pole = |second: f64| (second * 90.0, 89.99);
        let moves = |second: f64| (100.0 + second, 20.0);
        let parks = |coordinates: fn(f64) -> (f64, f64)| {
            first_parked(&mut Parked::default(), 0, 30, |second| {
                let (ra_deg, dec_deg) = coordinates(second);
                let (ra_deg, dec_deg) = (Datum::Known(ra_deg), Datum::Known(dec_deg));
                let fields = Fields { ra_deg, dec_deg, ..Fields::default() };
                ParkReading { says_parked: true, place: Place::of(&fields, |_| at(second)) }
            })
        };
        assert_eq!((parks(rests), parks(at_the_pole), parks(moves)), (Some(2.0), Some(2.0), None));
    }

    #[test]
    fn of_two_coordinates_each_must_have_been_read_again() {
        let reading = |altitude_deg: f64, azimuth_s: f64, altitude_s: f64| {
            let (altitude_deg, azimuth_deg) = (Datum::Known(altitude_deg), Datum::Known(180.0));
            let fields = Fields { altitude_deg, azimuth_deg, ..Fields::default() };
            let place = Place::of(&fields, |name| at(if name == "Azimuth" { azimuth_s } else { altitude_s }));
            ParkReading { says_parked: true, place }
        };
        let first = Parked::default().after(reading(60.0, 0.0, 5.0), at(0.0));
        let same_altitude = first.after(reading(60.0, 9.0, 5.0), at(9.0));
        assert!(!same_altitude.is_parked());
        assert!(same_altitude.after(reading(60.0, 9.0, 7.0), at(9.0)).is_parked());
        assert!(!same_altitude.after(reading(57.0, 9.0, 11.0), at(11.0)).is_parked());
        let place = reading(60.0, 0.0, 0.0).place.map(|place| place.answered(at(4.0)));
        let first = Parked::default().after(ParkReading { says_parked: true, place }, at(0.0));
        assert!(!first.after(reading(60.0, 5.0, 5.0), at(5.0)).is_parked(), "it may have been read at 4 s");
        assert!(first.after(reading(60.0, 6.0, 6.0), at(6.0)).is_parked());
    }
}
