//! The place of a telescope and the sky above it: the twilights of a night, the Sun, the Moon, sidereal time, and what walls
//! leave of the sky.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::response::{IntoResponse as _, Response};
use contract::Address;
use schedule::horizon_limits::HorizonLimits;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sky::{EarthOrientation, Horizontal, Icrs, Night, Observer, Place, SkyError, night};
use units::Utc;

use crate::json_body::AskedFor;
use crate::place::PlaceOnEarth;
use crate::problem::{Code, Problem};
use crate::routes::network::{NEVER_CACHED, known};
use crate::server::Server;

/// The Moon is looked for at this spacing; between two looks it moves on a straight line.
const STEP_S: f64 = 600.0;
/// The horizon is given in this many directions.
const DIRECTIONS: u16 = 180;

/// Which moment.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkyQuery {
    /// Sky time; now where absent.
    at_utc: Option<Utc>,
}

/// A place and the sky above it at a moment.
#[derive(Debug, JsonSchema, Serialize)]
pub struct SkyAt {
    /// Sky time.
    at_utc: Utc,
    /// Where it is.
    place: PlaceOnEarth,
    /// Apparent sidereal time of the place, degrees.
    sidereal_time_deg: f64,
    /// The Sun's centre.
    sun: BodyAt,
    /// The Moon's centre.
    moon: BodyAt,
    /// Lit part of the Moon's disk, 0 to 1.
    moon_lit: f64,
    /// The night that the moment belongs to.
    night: NightTimes,
    /// When the Moon is above the horizon in that night, from and to, good to some seconds.
    moon_up_utc: Vec<[Utc; 2]>,
    /// The lowest altitude that the site leaves in each direction, as pairs of azimuth (from north through east) and
    /// altitude, degrees; absent where this server's file is not that of the telescope.
    #[serde(skip_serializing_if = "Option::is_none")]
    horizon: Option<Vec<[f64; 2]>>,
}

/// Where a body stands, without refraction.
#[derive(Debug, JsonSchema, Serialize)]
struct BodyAt {
    /// Astrometric right ascension (ICRS), degrees.
    ra_deg: f64,
    /// Astrometric declination (ICRS), degrees.
    dec_deg: f64,
    /// Altitude, degrees.
    altitude_deg: f64,
    /// Azimuth from north through east, degrees.
    azimuth_deg: f64,
}

impl BodyAt {
    fn of(place: &Icrs, seen: &Horizontal) -> Self {
        Self {
            ra_deg: place.ra.degrees(),
            dec_deg: place.dec.degrees(),
            altitude_deg: seen.altitude.degrees(),
            azimuth_deg: seen.azimuth.degrees(),
        }
    }
}

/// The times of a night; one is absent where the Sun does not pass that altitude.
#[derive(Debug, JsonSchema, Serialize)]
struct NightTimes {
    /// The date it is filed under, such as 20261121.
    date: String,
    /// Local mean noon before.
    begins_utc: Utc,
    /// Local mean noon after.
    ends_utc: Utc,
    /// The upper limb of the Sun disappears.
    #[serde(skip_serializing_if = "Option::is_none")]
    sunset_utc: Option<Utc>,
    /// The Sun goes down through -6 deg.
    #[serde(skip_serializing_if = "Option::is_none")]
    civil_dusk_utc: Option<Utc>,
    /// Down through -12 deg.
    #[serde(skip_serializing_if = "Option::is_none")]
    nautical_dusk_utc: Option<Utc>,
    /// Down through -18 deg.
    #[serde(skip_serializing_if = "Option::is_none")]
    astronomical_dusk_utc: Option<Utc>,
    /// Up through -18 deg.
    #[serde(skip_serializing_if = "Option::is_none")]
    astronomical_dawn_utc: Option<Utc>,
    /// Up through -12 deg.
    #[serde(skip_serializing_if = "Option::is_none")]
    nautical_dawn_utc: Option<Utc>,
    /// Up through -6 deg.
    #[serde(skip_serializing_if = "Option::is_none")]
    civil_dawn_utc: Option<Utc>,
    /// The upper limb appears.
    #[serde(skip_serializing_if = "Option::is_none")]
    sunrise_utc: Option<Utc>,
}

impl From<&Night> for NightTimes {
    fn from(night: &Night) -> Self {
        Self {
            date: night.date.to_string(),
            begins_utc: night.begins,
            ends_utc: night.ends,
            sunset_utc: night.sunset,
            civil_dusk_utc: night.civil_dusk,
            nautical_dusk_utc: night.nautical_dusk,
            astronomical_dusk_utc: night.astronomical_dusk,
            astronomical_dawn_utc: night.astronomical_dawn,
            nautical_dawn_utc: night.nautical_dawn,
            civil_dawn_utc: night.civil_dawn,
            sunrise_utc: night.sunrise,
        }
    }
}

/// The place of a telescope, and the sky above it.
pub async fn sky(
    State(server): State<Arc<Server>>,
    Path((site, telescope)): Path<(String, String)>,
    AskedFor(query): AskedFor<SkyQuery>,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    let (place, orientation) = known_place(&server, &address)?;
    let at = query.at_utc.unwrap_or_else(|| server.network.clock().utc());
    let worked_out =
        tokio::task::spawn_blocking(move || sky_at(&place, &orientation, at, horizon(&server.config, &address)));
    let sky = worked_out.await.map_err(|lost| Problem::internal(&lost))?;
    let sky = sky
        .map_err(|error| Problem::new(Code::Validation, "The sky cannot be worked out", format!("at_utc: {error}.")))?;
    Ok((NEVER_CACHED, Json(sky)).into_response())
}

/// Where a telescope stands, or that this is not known.
pub fn known_place(server: &Server, address: &Address) -> Result<(Place, EarthOrientation), Problem> {
    server.network.read().place(address).ok_or_else(|| {
        Problem::not_found(format!(
            "It is not known where {address} stands: this server's file is of another site, and no mount there publishes a place."
        ))
    })
}

fn sky_at(
    place: &Place,
    orientation: &EarthOrientation,
    at: Utc,
    horizon: Option<Vec<[f64; 2]>>,
) -> Result<SkyAt, SkyError> {
    let observer = Observer::new(place, orientation, at)?;
    let night = night(place, orientation, at)?;
    Ok(SkyAt {
        at_utc: at,
        place: place.into(),
        sidereal_time_deg: observer.sidereal_time().degrees(),
        sun: BodyAt::of(&observer.sun_icrs(), &observer.sun()),
        moon: BodyAt::of(&observer.moon_icrs(), &observer.moon()),
        moon_lit: observer.moon_illumination(),
        moon_up_utc: moon_up(place, orientation, &night)?,
        night: NightTimes::from(&night),
        horizon,
    })
}

/// When the Moon's upper limb is above the horizon, between two noons.
fn moon_up(place: &Place, orientation: &EarthOrientation, night: &Night) -> Result<Vec<[Utc; 2]>, SkyError> {
    let height = |at: Utc| {
        let observer = Observer::new(place, orientation, at)?;
        Ok::<f64, SkyError>((observer.moon().altitude - Night::SUNSET).degrees())
    };
    let mut up: Vec<[Utc; 2]> = Vec::new();
    let (mut before, mut was) = (night.begins, height(night.begins)?);
    while before < night.ends {
        let next = before.plus_seconds(STEP_S.min(night.ends.seconds_since(before)).max(1.0));
        let is = height(next)?;
        let crossing = before.plus_seconds(next.seconds_since(before) * (was / (was - is)).clamp(0.0, 1.0));
        let span = match (was > 0.0, is > 0.0) {
            (true, true) => Some([before, next]),
            (true, false) => Some([before, crossing]),
            (false, true) => Some([crossing, next]),
            (false, false) => None,
        };
        match (span, up.last_mut()) {
            (Some([from, to]), Some(last)) if last[1] == from => last[1] = to,
            (Some(span), _) => up.push(span),
            (None, _) => {}
        }
        (before, was) = (next, is);
    }
    Ok(up)
}

/// What the file of this server says of the telescope's horizon; that of its first mount.
fn horizon(config: &config::Observatory, address: &Address) -> Option<Vec<[f64; 2]>> {
    let mount = config.telescope.first().filter(|_| config.address() == *address)?;
    // A horizon that cannot be read hides nothing, as in the observatory node, which raises the alert.
    let limits = HorizonLimits::of(config, mount).unwrap_or_else(|(without, _)| without);
    let step_deg = 360.0 / f64::from(DIRECTIONS);
    let directions = (0..DIRECTIONS).map(|direction| f64::from(direction) * step_deg);
    Some(directions.map(|azimuth_deg| [azimuth_deg, limits.lowest_deg(azimuth_deg)]).collect())
}

#[cfg(test)]
mod tests {
    use units::Angle;

    use super::*;

    fn paranal() -> (Place, EarthOrientation) {
        let place = Place::new(Angle::from_degrees(-24.6272), Angle::from_degrees(-70.4042), 2635.0).unwrap();
        (place, EarthOrientation::default())
    }

    #[test]
    fn the_moon_rises_and_sets_where_its_altitude_says_so() {
        let (place, orientation) = paranal();
        for day in 1..=28 {
            let at: Utc = format!("2026-11-{day:02}T03:00:00Z").parse().unwrap();
            let sky = sky_at(&place, &orientation, at, None).unwrap();
            let night = night(&place, &orientation, at).unwrap();
            assert!(sky.moon_up_utc.len() <= 2, "{:?}", sky.moon_up_utc);
            let altitude_deg = |at: Utc| Observer::new(&place, &orientation, at).unwrap().moon().altitude.degrees();
            for time in sky.moon_up_utc.iter().flatten().filter(|time| **time != night.begins && **time != night.ends) {
                let altitude_deg = altitude_deg(*time);
                assert!((altitude_deg + 0.833).abs() < 0.02, "{time}: {altitude_deg}");
            }
            let is_up = sky.moon_up_utc.iter().any(|[from, to]| *from <= at && at < *to);
            assert_eq!(is_up, sky.moon.altitude_deg > -0.833, "{at}");
        }
    }

    #[test]
    fn the_sky_is_that_of_its_moment_and_of_its_night() {
        let (place, orientation) = paranal();
        let at: Utc = "2026-11-21T03:00:00Z".parse().unwrap();
        let sky = sky_at(&place, &orientation, at, None).unwrap();
        assert_eq!((sky.night.date.as_str(), sky.place.latitude_deg), ("20261120", -24.6272));
        assert!(sky.sun.altitude_deg < -18.0 && (0.0..=1.0).contains(&sky.moon_lit));
        // Right ascension and hour angle of the Sun give the sidereal time, to the size of nutation and aberration.
        let observer = Observer::new(&place, &orientation, at).unwrap();
        let hour_angle_deg = observer.hour_angle(&observer.sun_icrs()).degrees();
        let off_deg = (sky.sidereal_time_deg - sky.sun.ra_deg - hour_angle_deg + 540.0).rem_euclid(360.0) - 180.0;
        assert!(off_deg.abs() < 0.5, "{off_deg}");
        let times =
            [sky.night.sunset_utc, sky.night.nautical_dusk_utc, sky.night.nautical_dawn_utc, sky.night.sunrise_utc];
        assert!(times.windows(2).all(|pair| pair[0].unwrap() < pair[1].unwrap()));
        // In the polar summer there is no sunset.
        let pole = Place::new(Angle::from_degrees(80.0), Angle::from_degrees(0.0), 0.0).unwrap();
        let sky = sky_at(&pole, &orientation, "2026-06-21T00:00:00Z".parse().unwrap(), None).unwrap();
        assert!(sky.night.sunset_utc.is_none() && sky.night.nautical_dawn_utc.is_none());
    }
}
