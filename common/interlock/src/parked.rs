//! Whether a mount is parked, by its flags and by its coordinates; pure.
//!
//! Some drivers report `AtPark` as soon as they accept `Park`, and deny meanwhile that they slew. A mount that says that
//! it is parked is believed once its coordinates have rested since; one that has none is believed by its flags.
//!
//! Left as it is: a mount that parks at the pole and turns about its polar axis alone looks at one place.

use std::time::Duration;

use contract::device::telescope::Fields;
use contract::{Datum, NoData};
use units::MachineTime;

/// Coordinates rest that were read twice at one place, so long apart at least: a mount may start seconds after it said
/// that it is parked, and some drivers read its coordinates only each 5 s.
const REST: Duration = Duration::from_secs(10);
/// Readings so far apart show nothing of what was between them.
const APART: Duration = Duration::from_secs(60);
/// A mount that says that it is parked and tells no coordinates for so long is believed by its flags: some tell none in
/// their park, and no slew takes longer.
const UNTOLD: Duration = Duration::from_secs(60);
/// One place, degrees: far less than a mount slews in [`REST`].
const SAME_DEG: f64 = 0.1;
/// The sky turns by less in a second, degrees: the right ascension of a mount that stands runs so fast.
const SKY_DEG_PER_S: f64 = 0.005;

/// Which coordinates a place has: those of different pairs are not compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Pair {
    AzimuthAltitude,
    RightAscensionDeclination,
}

/// Where a mount says that it points, thousandths of a degree: whole numbers, so that states can be compared and
/// hashed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Place {
    pair: Pair,
    around: i32,
    up: i32,
    /// When the older one of the two was asked for.
    from: MachineTime,
    /// When the newer one was.
    to: MachineTime,
}

impl Place {
    /// By azimuth and altitude where both are known, in which a parked mount rests; else by right ascension and
    /// declination.
    fn of(fields: &Fields, asked: impl Fn(&str) -> MachineTime) -> Option<Self> {
        let place = |pair: Pair, around: &Datum<f64>, up: &Datum<f64>, names: [&str; 2]| -> Option<Self> {
            let thousandths = |deg: f64| (deg * 1e3).round() as i32;
            let (around, up) = (thousandths(*around.known()?), thousandths(*up.known()?));
            let [one, other] = names.map(&asked);
            Some(Self { pair, around, up, from: one.min(other), to: one.max(other) })
        };
        place(Pair::AzimuthAltitude, &fields.azimuth_deg, &fields.altitude_deg, ["Azimuth", "Altitude"]).or_else(|| {
            let names = ["RightAscension", "Declination"];
            place(Pair::RightAscensionDeclination, &fields.ra_deg, &fields.dec_deg, names)
        })
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
    /// Whether its flags say that it is parked: [`Fields::parked`].
    pub says_parked: Option<bool>,
    /// Where it points; `None` where it is not known.
    pub place: Option<Place>,
    /// It has no coordinates: its driver implements none.
    pub has_none: bool,
}

impl ParkReading {
    /// From a mount's properties; `asked`: when the property of this name was asked for.
    pub fn of(fields: &Fields, asked: impl Fn(&str) -> MachineTime) -> Self {
        let is_missing = |one: &Datum<f64>, other: &Datum<f64>| {
            [one, other].iter().any(|datum| datum.as_result().err() == Some(&NoData::not_implemented()))
        };
        let has_none =
            is_missing(&fields.azimuth_deg, &fields.altitude_deg) && is_missing(&fields.ra_deg, &fields.dec_deg);
        Self { says_parked: fields.parked(), place: Place::of(fields, asked), has_none }
    }
}

/// What is known of one mount.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Parked {
    /// When it was asked last.
    asked: Option<MachineTime>,
    /// Its flags said then that it is parked.
    says_so: bool,
    /// Since when it has not denied it.
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
        self.says_so && self.is_believed
    }

    /// The same with another reading, whose flags were asked for at `asked`.
    pub fn after(self, reading: ParkReading, asked: MachineTime) -> Self {
        let is_long_ago = self.asked.is_some_and(|last| asked.since(last) > APART);
        let told = reading.place.map(|place| place.to).or(self.told);
        let before = match reading.says_parked {
            Some(false) => return Self { asked: Some(asked), told, ..Self::default() },
            _ if is_long_ago => Self::default(),
            _ => self,
        };
        let says_so = reading.says_parked == Some(true);
        let since = before.since.or(says_so.then_some(asked));
        let known = Self { asked: Some(asked), says_so, since, told, ..before };
        // An answer that is missing says nothing for the mount, and costs nothing of what is known.
        let Some(since) = since else { return known };
        let Some(place) = reading.place else {
            let last = told.map_or(since, |told| told.max(since));
            return Self { is_believed: known.is_believed || reading.has_none || asked.since(last) >= UNTOLD, ..known };
        };
        if place.from < since {
            // From before it said so: it may not have begun to move.
            return known;
        }
        let begun = Self { place: Some(place), is_believed: false, ..known };
        let Some(was) = known.place else { return begun };
        let longest = place.to.since(was.from);
        if longest > APART {
            return begun;
        }
        if place.pair != was.pair {
            // One of the better pair was not read this time.
            return known;
        }
        if place.apart_deg(was) > SAME_DEG + SKY_DEG_PER_S * longest.as_secs_f64() {
            return begun;
        }
        // Each of its coordinates is so much newer.
        if place.from.since(was.to) < REST {
            return known;
        }
        Self { place: Some(place), is_believed: true, ..known }
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
        ParkReading { says_parked: Some(says_parked), ..ParkReading::of(&fields, |_| at(second)) }
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
        assert_eq!(first_parked(&mut parked, 60, 90, |second| read(true, 36.0, second)), Some(69.0));
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
    fn a_mount_that_is_parked_from_the_start_and_rests_is_parked_after_ten_seconds() {
        let mut parked = Parked::default();
        assert_eq!(first_parked(&mut parked, 0, 20, |second| read(true, 10.0, second)), Some(10.0));
        assert!(parked.after(read(true, 10.05, 10.5), at(10.5)).is_parked(), "it trembles");
        assert!(!parked.after(read(true, 12.0, 11.0), at(11.0)).is_parked(), "it is moved");
        assert!(!parked.after(read(false, 10.0, 11.0), at(11.0)).is_parked(), "it does not say so any more");
        assert!(!parked.after(read(true, 10.0, 90.0), at(90.0)).is_parked(), "nobody saw it for long");
    }

    #[test]
    fn a_mount_without_coordinates_is_believed_by_its_flags_and_one_that_tells_none_for_60_s() {
        let none = |says_parked, has_none| ParkReading { says_parked: Some(says_parked), place: None, has_none };
        assert!(Parked::default().after(none(true, true), at(0.0)).is_parked());
        assert!(!Parked::default().after(none(false, true), at(0.0)).is_parked());
        assert_eq!(first_parked(&mut Parked::default(), 0, 90, |_| none(true, false)), Some(60.0), "from the start");
        let mut parked = Parked::default().after(read(false, 60.0, 5.0), at(5.0));
        assert_eq!(first_parked(&mut parked, 6, 90, |_| none(true, false)), Some(66.0), "from when it says so");
        let rests = rested();
        assert!(rests.after(none(true, false), at(11.0)).is_parked(), "one answer that is missing moves nothing");
        assert!(!rests.after(none(true, false), at(90.0)).is_parked(), "nobody saw it for long");
        let not_implemented = || Datum::missing(NoData::not_implemented());
        let half = Fields { azimuth_deg: not_implemented(), ..Fields::default() };
        let whole = Fields { dec_deg: not_implemented(), ..half.clone() };
        let has_none = [half, whole].map(|fields| ParkReading::of(&fields, |_| at(0.0)).has_none);
        assert_eq!(has_none, [false, true]);
    }

    /// A mount that is parked since second 0 and known to be since second 10.
    fn rested() -> Parked {
        let mut rests = Parked::default();
        assert_eq!(first_parked(&mut rests, 0, 11, |second| read(true, 10.0, second)), Some(10.0));
        rests
    }

    #[test]
    fn an_answer_that_is_missing_costs_nothing_of_what_is_known() {
        let unknown = ParkReading { says_parked: None, ..read(true, 10.0, 11.0) };
        let parked = rested().after(unknown, at(11.0));
        assert!(!parked.is_parked(), "a mount of which it is not known is not");
        assert!(parked.after(read(true, 10.0, 12.0), at(12.0)).is_parked());
        assert!(!parked.after(read(true, 11.0, 12.0), at(12.0)).is_parked(), "it moved meanwhile");
        // Each third time one of altitude and azimuth is not read, and the other pair serves.
        let other = |second: f64| {
            let (ra_deg, dec_deg) = (Datum::Known(250.0), Datum::Known(-20.0));
            let fields = Fields { ra_deg, dec_deg, ..Fields::default() };
            ParkReading { says_parked: Some(true), ..ParkReading::of(&fields, |_| at(second)) }
        };
        let flaky = |second: f64| if second % 3.0 == 1.0 { other(second) } else { read(true, 10.0, second) };
        assert_eq!(first_parked(&mut Parked::default(), 0, 30, flaky), Some(11.0));
        assert!(rested().after(other(11.0), at(11.0)).is_parked());
        let mut parked = rested();
        (11..90).for_each(|second| parked = parked.after(other(f64::from(second)), at(f64::from(second))));
        assert!(parked.is_parked(), "by the pair that it tells now");
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
                ParkReading { says_parked: Some(true), ..ParkReading::of(&fields, |_| at(second)) }
            })
        };
        assert_eq!((parks(rests), parks(at_the_pole), parks(moves)), (Some(10.0), Some(10.0), None));
    }

    #[test]
    fn of_two_coordinates_each_must_have_been_read_again() {
        let reading = |altitude_deg: f64, azimuth_s: f64, altitude_s: f64| {
            let (altitude_deg, azimuth_deg) = (Datum::Known(altitude_deg), Datum::Known(180.0));
            let fields = Fields { altitude_deg, azimuth_deg, ..Fields::default() };
            let asked = |name: &str| at(if name == "Azimuth" { azimuth_s } else { altitude_s });
            ParkReading { says_parked: Some(true), ..ParkReading::of(&fields, asked) }
        };
        let first = Parked::default().after(reading(60.0, 0.0, 5.0), at(0.0));
        let same_altitude = first.after(reading(60.0, 9.0, 5.0), at(9.0));
        assert!(!same_altitude.is_parked());
        assert!(same_altitude.after(reading(60.0, 16.0, 15.0), at(15.0)).is_parked());
        assert!(!same_altitude.after(reading(57.0, 9.0, 11.0), at(11.0)).is_parked());
        let place = reading(60.0, 0.0, 0.0).place.map(|place| place.answered(at(4.0)));
        let first = Parked::default().after(ParkReading { place, ..reading(60.0, 0.0, 0.0) }, at(0.0));
        assert!(!first.after(reading(60.0, 13.0, 13.0), at(13.0)).is_parked(), "it may have been read at 4 s");
        assert!(first.after(reading(60.0, 14.0, 14.0), at(14.0)).is_parked());
    }
}
