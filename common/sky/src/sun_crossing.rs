//! The times at which the Sun passes an altitude, and the twilights of a night.

use units::{Angle, Utc};

use crate::{EarthOrientation, NightDate, Observer, Place, SkyError, night_date};

/// Spacing at which a crossing is looked for. One that undoes itself within it, by a Sun that grazes the altitude at
/// high latitude by less than an arcminute, goes unseen.
const STEP_S: f64 = 600.0;
/// The Sun is computed so often on the way, its hour angle and declination on a straight line between: the curvature
/// there, from its parallax and the seasons, is less than an arcsecond.
const KNOT_S: f64 = 7200.0;
/// A sample that is off by that may lie on the wrong side of a crossing, which is then within this.
const WIDER_S: f64 = 60.0;
/// How far ahead [`next_sun_crossing`] looks.
const HORIZON_S: f64 = 48.0 * 3600.0;
const DAY_S: f64 = 86_400.0;
/// A crossing is narrowed down to this; 100 Hz is far beyond what refraction lets anyone see.
const PRECISION_S: f64 = 0.01;
/// Less than half of that: two looks on either side of the crossing end the search.
const BEYOND_S: f64 = 0.004;

/// The night that [`night`] found, from local mean noon to local mean noon.
///
/// A time is none where the Sun does not pass that altitude, as in polar summers and winters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Night {
    /// The date it is filed under.
    pub date: NightDate,
    /// Local mean noon before.
    pub begins: Utc,
    /// Local mean noon after.
    pub ends: Utc,
    /// The upper limb disappears.
    pub sunset: Option<Utc>,
    /// Down through -6 deg.
    pub civil_dusk: Option<Utc>,
    /// Down through -12 deg.
    pub nautical_dusk: Option<Utc>,
    /// Down through -18 deg: the sky is dark.
    pub astronomical_dusk: Option<Utc>,
    /// Up through -18 deg: the sky is no longer dark.
    pub astronomical_dawn: Option<Utc>,
    /// Up through -12 deg.
    pub nautical_dawn: Option<Utc>,
    /// Up through -6 deg.
    pub civil_dawn: Option<Utc>,
    /// The upper limb appears.
    pub sunrise: Option<Utc>,
}

impl Night {
    /// Of the Sun's centre when its upper limb is on the horizon: half a degree of disk and 34 arcmin of refraction.
    pub const SUNSET: Angle = Angle::from_degrees(-0.833);
    /// End of civil twilight.
    pub const CIVIL: Angle = Angle::from_degrees(-6.0);
    /// End of nautical twilight.
    pub const NAUTICAL: Angle = Angle::from_degrees(-12.0);
    /// End of astronomical twilight.
    pub const ASTRONOMICAL: Angle = Angle::from_degrees(-18.0);
}

/// The night to which `at` belongs by its [`night_date()`].
pub fn night(place: &Place, orientation: &EarthOrientation, at: Utc) -> Result<Night, SkyError> {
    let date = night_date(place.longitude_east(), at);
    let begins = date.noon(place.longitude_east());
    let path = SunPath::sampled(place, orientation, begins, DAY_S)?;
    let dusk = |altitude| path.crossings(altitude, false).next().transpose();
    let dawn = |altitude| path.crossings(altitude, true).last().transpose();
    Ok(Night {
        date,
        begins,
        ends: date.next().noon(place.longitude_east()),
        sunset: dusk(Night::SUNSET)?,
        civil_dusk: dusk(Night::CIVIL)?,
        nautical_dusk: dusk(Night::NAUTICAL)?,
        astronomical_dusk: dusk(Night::ASTRONOMICAL)?,
        astronomical_dawn: dawn(Night::ASTRONOMICAL)?,
        nautical_dawn: dawn(Night::NAUTICAL)?,
        civil_dawn: dawn(Night::CIVIL)?,
        sunrise: dawn(Night::SUNSET)?,
    })
}

/// The first time within 48 h after `from` at which the Sun's centre (not refracted) goes up or down through
/// `altitude`.
///
/// To 0.01 s of the model; refraction near the horizon varies by many seconds. None when the Sun does not cross.
pub fn next_sun_crossing(
    place: &Place,
    orientation: &EarthOrientation,
    from: Utc,
    altitude: Angle,
    rising: bool,
) -> Result<Option<Utc>, SkyError> {
    // By days, because the first crossing nearly always comes within one.
    for start_s in [0.0, HORIZON_S / 2.0] {
        let path = SunPath::sampled(place, orientation, from.plus_seconds(start_s), HORIZON_S / 2.0)?;
        if let Some(crossing) = path.crossings(altitude, rising).next() {
            return crossing.map(Some);
        }
    }
    Ok(None)
}

/// The Sun's altitude along some hours.
struct SunPath<'a> {
    place: &'a Place,
    orientation: &'a EarthOrientation,
    /// Exact to an arcsecond: they show between which two of them a crossing lies.
    samples: Vec<(Utc, Angle)>,
}

/// The Sun as the site's own axes have it: hour angle and declination of date.
type HourAngle = (Angle, Angle);

impl<'a> SunPath<'a> {
    fn sampled(place: &'a Place, orientation: &'a EarthOrientation, from: Utc, span_s: f64) -> Result<Self, SkyError> {
        let seen = |from_s: f64| -> Result<HourAngle, SkyError> {
            let observer = Observer::new(place, orientation, from.plus_seconds(from_s))?;
            let sun = observer.sun_icrs();
            Ok((observer.hour_angle(&sun), observer.to_of_date(&sun).dec))
        };
        let steps = (span_s / STEP_S).round() as u32;
        let mut before = (0.0, seen(0.0)?);
        let mut after = (KNOT_S, seen(KNOT_S)?);
        let samples = (0..=steps).map(|step| -> Result<(Utc, Angle), SkyError> {
            let from_s = f64::from(step) * STEP_S;
            if from_s > after.0 {
                let next_s = after.0 + KNOT_S;
                before = std::mem::replace(&mut after, (next_s, seen(next_s)?));
            }
            let at = from.plus_seconds(from_s);
            // The ends are exact: a crossing that one path misses there is found by the next one.
            if step == 0 || step == steps {
                return Ok((at, Observer::new(place, orientation, at)?.sun().altitude));
            }
            let hour_angle = between(before.1, after.1, (from_s - before.0) / KNOT_S);
            Ok((at, altitude(place.latitude(), hour_angle)))
        });
        let samples = samples.collect::<Result<_, SkyError>>()?;
        Ok(Self { place, orientation, samples })
    }

    fn crossings(&self, altitude: Angle, rising: bool) -> impl Iterator<Item = Result<Utc, SkyError>> {
        let past = move |sun: Angle| is_past(past_deg(sun, altitude, rising));
        self.samples.windows(2).filter_map(move |pair| match pair {
            [(before, low), (after, high)] if past(*high) && !past(*low) => {
                self.narrowed(*before, *after, altitude, rising).transpose()
            }
            _ => None,
        })
    }

    /// By straight lines, a little beyond where they lead, so that the crossing is soon closed in from both sides. None
    /// where the Sun itself only comes near the altitude.
    fn narrowed(&self, before: Utc, after: Utc, altitude: Angle, rising: bool) -> Result<Option<Utc>, SkyError> {
        let look = |at: Utc| -> Result<f64, SkyError> {
            Ok(past_deg(Observer::new(self.place, self.orientation, at)?.sun().altitude, altitude, rising))
        };
        let (mut before, mut low_deg) = (before, look(before)?);
        if is_past(low_deg) && self.samples.first().is_some_and(|(first, _)| before > *first) {
            before = before.plus_seconds(-WIDER_S);
            low_deg = look(before)?;
        }
        let (mut after, mut high_deg) = (after, look(after)?);
        if !is_past(high_deg) {
            after = after.plus_seconds(WIDER_S);
            high_deg = look(after)?;
        }
        if is_past(low_deg) || !is_past(high_deg) {
            return Ok(None);
        }
        let mut round = 0;
        while after.seconds_since(before) > PRECISION_S {
            round += 1;
            let span_s = after.seconds_since(before);
            let line_s = span_s * low_deg / (low_deg - high_deg);
            // A Sun that grazes bends too much for lines: every third round halves.
            let from_s = match round % 3 {
                0 => span_s / 2.0,
                1 => line_s - BEYOND_S,
                _ => line_s + BEYOND_S,
            };
            let middle = before.plus_seconds(from_s.clamp(span_s * 1e-6, span_s * (1.0 - 1e-6)));
            let middle_deg = look(middle)?;
            if is_past(middle_deg) {
                (after, high_deg) = (middle, middle_deg);
            } else {
                (before, low_deg) = (middle, middle_deg);
            }
        }
        Ok(Some(after))
    }
}

/// So far beyond the altitude, in the direction asked for, degrees.
fn past_deg(sun: Angle, altitude: Angle, rising: bool) -> f64 {
    let above = (sun - altitude).degrees();
    if rising { above } else { -above }
}

fn is_past(past_deg: f64) -> bool {
    past_deg >= 0.0
}

/// On the straight line between two directions that are [`KNOT_S`] apart.
fn between(before: HourAngle, after: HourAngle, share: f64) -> HourAngle {
    let hour_angle = before.0 + (after.0 - before.0).wrapped_signed() * share;
    (hour_angle, before.1 + (after.1 - before.1) * share)
}

fn altitude(latitude: Angle, (hour_angle, dec): HourAngle) -> Angle {
    let sine = latitude.sin() * dec.sin() + latitude.cos() * dec.cos() * hour_angle.cos();
    Angle::from_radians(sine.clamp(-1.0, 1.0).asin())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(latitude: f64, longitude: f64) -> Place {
        Place::new(Angle::from_degrees(latitude), Angle::from_degrees(longitude), 100.0).unwrap()
    }

    fn utc(text: &str) -> Utc {
        text.parse().unwrap()
    }

    #[test]
    fn the_twilights_come_in_order_and_at_their_altitudes() {
        let (paranal, earth) = (place(-24.6157, -70.3976), EarthOrientation::default());
        let night = night(&paranal, &earth, utc("2026-11-22T03:00:00Z")).unwrap();
        assert_eq!(night.date.to_string(), "20261121");
        let times = [
            night.sunset,
            night.civil_dusk,
            night.nautical_dusk,
            night.astronomical_dusk,
            night.astronomical_dawn,
            night.nautical_dawn,
            night.civil_dawn,
            night.sunrise,
        ]
        .map(Option::unwrap);
        assert!(night.begins < times[0] && times[7] < night.ends);
        assert!(times.is_sorted(), "{times:?}");
        for (at, altitude) in times.iter().zip([-0.833, -6.0, -12.0, -18.0, -18.0, -12.0, -6.0, -0.833]) {
            let sun = Observer::new(&paranal, &earth, *at).unwrap().sun().altitude;
            assert!((sun.degrees() - altitude).abs() < 1e-4, "{at}: {sun:?}");
        }
    }

    #[test]
    fn a_midsummer_night_in_the_north_has_no_darkness_and_beyond_the_circle_no_sunset() {
        let (at, earth) = (utc("2026-06-21T22:00:00Z"), EarthOrientation::default());
        let berlin = night(&place(52.5, 13.4), &earth, at).unwrap();
        assert!(berlin.sunset.is_some() && berlin.nautical_dusk.is_some() && berlin.astronomical_dusk.is_none());
        let tromso = night(&place(69.65, 18.96), &earth, at).unwrap();
        assert_eq!((tromso.sunset, tromso.sunrise, tromso.civil_dusk), (None, None, None));
        let next = next_sun_crossing(&place(69.65, 18.96), &earth, at, Night::SUNSET, false);
        assert_eq!(next, Ok(None));
    }

    #[test]
    fn the_next_crossing_is_after_the_start_and_in_the_direction_asked_for() {
        let (paranal, earth) = (place(-24.6157, -70.3976), EarthOrientation::default());
        let first = next_sun_crossing(&paranal, &earth, utc("2026-11-22T03:00:00Z"), Night::SUNSET, true);
        let first = first.unwrap().unwrap();
        let second = next_sun_crossing(&paranal, &earth, first.plus_seconds(1.0), Night::SUNSET, true);
        let second = second.unwrap().unwrap();
        let day_s = second.seconds_since(first);
        assert!((day_s - 86_400.0).abs() < 120.0, "{day_s}");
    }

    #[test]
    fn samples_between_the_computed_places_are_good_to_an_arcsecond_and_a_half() {
        let earth = EarthOrientation { dut1_s: 0.3, polar_x_arcsec: 0.2, polar_y_arcsec: 0.4 };
        for (latitude, longitude, at) in [
            (-24.6, -70.4, "2026-11-22T03:00:00Z"),
            (78.0, 15.0, "2026-03-20T00:00:00Z"),
            (0.0, 179.9, "2031-07-01T09:00:00Z"),
        ] {
            let place = place(latitude, longitude);
            let path = SunPath::sampled(&place, &earth, utc(at), DAY_S).unwrap();
            assert_eq!(path.samples.len(), 145);
            for (at, altitude) in path.samples {
                let exact = Observer::new(&place, &earth, at).unwrap().sun().altitude;
                let off = (altitude - exact).arcseconds();
                assert!(off.abs() < 1.5, "{at}: {off} arcsec");
            }
        }
    }

    #[test]
    fn an_unset_clock_has_no_night() {
        let at = Utc::EPOCH;
        assert!(night(&place(0.0, 0.0), &EarthOrientation::default(), at).is_err());
    }
}
