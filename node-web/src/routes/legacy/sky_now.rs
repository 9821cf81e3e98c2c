//! Where the Sun, the Moon and the planets stand above a site.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Extension, State};
use axum::response::{IntoResponse as _, Response};
use schemars::JsonSchema;
use serde::Serialize;
use sky::{Body, EarthOrientation, Observer, Place, SkyError};
use units::Utc;
use users::Principal;

use super::{LegacyQuery, instead, the_telescope};
use crate::json_body::AskedFor;
use crate::problem::{Code, Problem};
use crate::routes::sky::known_place;
use crate::server::Server;

/// Bodies with their kinds, and the magnitudes that Astra gave them.
const BODIES: [(&str, &str, f64); 7] = [
    ("Sun", "sun", -26.74),
    ("Moon", "moon", -12.0),
    ("Mercury", "planet", -1.9),
    ("Venus", "planet", -4.4),
    ("Mars", "planet", -2.9),
    ("Jupiter", "planet", -2.9),
    ("Saturn", "planet", 0.0),
];

/// The sky above a site.
#[derive(Debug, JsonSchema, Serialize)]
pub struct LegacySky {
    status: &'static str,
    message: &'static str,
    data: SkyNow,
}

/// The site and the bodies.
#[derive(Debug, JsonSchema, Serialize)]
struct SkyNow {
    observatory: Site,
    /// Sky time, without a zone.
    utc_time: String,
    celestial_bodies: Vec<BodyNow>,
}

/// A place on Earth.
#[derive(Debug, JsonSchema, Serialize)]
struct Site {
    /// Latitude, degrees.
    lat: f64,
    /// Longitude, degrees, east positive.
    lon: f64,
    /// Metres.
    elevation: f64,
}

/// A body, seen from there.
#[derive(Debug, JsonSchema, Serialize)]
struct BodyNow {
    name: &'static str,
    /// Altitude, degrees, not refracted.
    alt: f64,
    /// Azimuth from north through east, degrees.
    az: f64,
    r#type: &'static str,
    magnitude: f64,
    /// The lit part of the Moon.
    #[serde(skip_serializing_if = "Option::is_none")]
    phase: Option<f64>,
}

/// The sky above a telescope.
pub async fn sky_data(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    AskedFor(query): AskedFor<LegacyQuery>,
) -> Result<Response, Problem> {
    let address = the_telescope(&server, &caller, query.telescope.as_deref())?;
    let (place, orientation) = known_place(&server, &address)?;
    let data = sky_now(&place, &orientation, server.network.clock().utc())
        .map_err(|error| Problem::new(Code::Internal, "The sky cannot be worked out", error.to_string()))?;
    let sky = LegacySky { status: "success", message: "", data };
    Ok(instead("night", &address, Json(sky).into_response()))
}

fn sky_now(place: &Place, orientation: &EarthOrientation, at: Utc) -> Result<SkyNow, SkyError> {
    let observer = Observer::new(place, orientation, at)?;
    let mut celestial_bodies = Vec::with_capacity(BODIES.len());
    for (name, kind, magnitude) in BODIES {
        let seen = match Body::named(name) {
            _ if kind == "sun" => observer.sun(),
            Ok(Some(body)) => observer.to_horizontal(&body.seen(&observer)?.icrs),
            _ => continue,
        };
        celestial_bodies.push(BodyNow {
            name,
            alt: seen.altitude.degrees(),
            az: seen.azimuth.degrees(),
            r#type: kind,
            magnitude,
            phase: (kind == "moon").then(|| observer.moon_illumination()),
        });
    }
    Ok(SkyNow {
        observatory: Site {
            lat: place.latitude().degrees(),
            lon: place.longitude_east().degrees(),
            elevation: place.elevation_m(),
        },
        utc_time: at.fits(),
        celestial_bodies,
    })
}
