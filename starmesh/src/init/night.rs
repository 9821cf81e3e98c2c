//! An example schedule for this night of a place, or the coming one.

use contract::Kind;
use serde_json::{Value, json};
use sky::{EarthOrientation, Icrs, Place};
use units::{Angle, Utc};

use super::place::Surroundings;
use crate::fields::{FIELDS, M_78, NamedField};

/// The field is the highest one for so long from the beginning of the night on.
const LENGTH_S: f64 = 2.5 * 3600.0;
/// Its rows may run beyond that while it is higher than this, looked at so often: whoever reads meanwhile, or waits for
/// the weather, loses nothing.
const LOW_DEG: f64 = 30.0;
const STEP_S: f64 = 600.0;
/// Left for starting the nodes, s of sky time.
const START_S: f64 = 600.0;
const EXAMPLE_CAMERA: &str = "my_camera";
/// Seconds are enough for whoever reads and changes it.
const TIME: &str = "%Y-%m-%dT%H:%M:%SZ";

/// The text of the schedule, for the first camera of a configuration.
pub fn schedule(config: &config::Observatory, around: &Surroundings) -> anyhow::Result<String> {
    let camera = config.camera.first().map_or(EXAMPLE_CAMERA, |camera| camera.common.name.as_str());
    let now = around.simulated.unwrap_or_else(|| bus::Clock::machine_clock().utc());
    let night =
        around.place.and_then(|place| Dark::next(place.latitude_deg, place.longitude_deg, place.elevation_m, now));
    let mut text = String::from(
        "// The night that `starmesh init` wrote as an example. All actions and their parameters: docs/operator/schedule.md, or\n\
         // `starmesh actions`. Times are UTC. A row runs when its start has come and the rows before it have ended.\n\
         // `starmesh check schedule.jsonl` says what is wrong with it, `starmesh plan schedule.jsonl` when each row will run.\n",
    );
    let Some(Dark { place, dusk, dawn }) = night else {
        text +=
            "// Where the telescope stands is not known yet, or the Sun does not set there: these rows are comments.\n";
        let start = now.plus_seconds(3600.0);
        let end = start.plus_seconds(LENGTH_S);
        for line in rows(config, camera, &M_78, (start, end, end)) {
            text += &format!("// {line}\n");
        }
        return Ok(text);
    };
    let lowest_deg = |field: &NamedField, start: Utc, end: Utc| {
        let [ra_deg, dec_deg] = field.place(start);
        let field = Icrs::from_degrees(ra_deg, dec_deg);
        let lowest = sky::lowest_altitude(&place, &EarthOrientation::default(), &field, start, end);
        lowest.map_or(-90.0, |lowest| lowest.altitude.degrees())
    };
    let mut observed = dusk.plus_seconds(LENGTH_S).min(dawn);
    let lowest = |field: &NamedField| lowest_deg(field, dusk, observed);
    let sparse = FIELDS.iter().filter(|field| !field.is_crowded);
    let field = sparse.max_by(|a, b| lowest(a).total_cmp(&lowest(b))).unwrap_or(&M_78);
    while observed < dawn && lowest_deg(field, observed, observed.plus_seconds(STEP_S)) >= LOW_DEG {
        observed = observed.plus_seconds(STEP_S).min(dawn);
    }
    for line in rows(config, camera, field, (dusk, observed, dawn)) {
        text += &line;
        text.push('\n');
    }
    Ok(text)
}

/// The rows of a night from dusk to dawn, each with its purpose; the field is observed until `observed`.
fn rows(
    config: &config::Observatory,
    camera: &str,
    field: &NamedField,
    (dusk, observed, dawn): (Utc, Utc, Utc),
) -> Vec<String> {
    let mut lines = Vec::new();
    let mut row = |about: &str, action: &str, value: Value, start: Utc, end: Utc| {
        let row = json!({
            "device_name": camera, "action_type": action, "action_value": value,
            "start_time": start.strftime(TIME), "end_time": end.strftime(TIME),
        });
        lines.push(format!("// {about}"));
        lines.push(row.to_string());
    };
    let has = |kind: Kind| config.devices().iter().any(|(known, _)| *known == kind);
    let NamedField { name, exptime_s, .. } = *field;
    let [ra_deg, dec_deg] = field.place(dusk);
    let later = |seconds: f64| dusk.plus_seconds(seconds);
    if config.camera.first().is_some_and(|camera| camera.temperature_c.is_some()) {
        row("The camera is cooled to camera.temperature_c.", "cool_camera", json!({}), later(-1800.0), dawn);
    }
    if has(Kind::Dome) {
        row("The dome opens once it is dark (nautical dusk), if the sky allows it.", "open", json!({}), dusk, dawn);
    }
    let mut value = json!({ "object": name, "exptime": exptime_s, "n": 20 });
    if has(Kind::Telescope)
        && let Value::Object(value) = &mut value
    {
        value.insert("ra".to_owned(), json!(ra_deg));
        value.insert("dec".to_owned(), json!(dec_deg));
    }
    row(
        "Twenty frames of a field high in the sky. ra and dec are ICRS, in degrees; exptime in seconds.",
        "object",
        value.clone(),
        later(1.0),
        observed,
    );
    if has(Kind::Telescope)
        && let Value::Object(value) = &mut value
    {
        value.insert("pointing".to_owned(), json!(true));
        value.insert("guiding".to_owned(), json!(true));
        let about = "The same, once a solved frame has shown that the telescope looks there, and held by guide pulses.";
        row(about, "object", json!(value), later(2.0), observed);
    }
    row("Everything is closed and parked.", "close", json!({}), later(3.0), dawn.plus_seconds(3600.0));
    let dark = json!({ "exptime": [0.0, exptime_s], "n": [5, 3] });
    let about = format!("Five bias frames, and three darks of {exptime_s} s.");
    row(&about, "calibration", dark, later(4.0), dawn.plus_seconds(7200.0));
    row(
        "Headers are completed with what was measured meanwhile.",
        "complete_headers",
        json!({}),
        later(5.0),
        dawn.plus_seconds(43_200.0),
    );
    lines
}

/// The dark part of a night, as far as it is yet to come.
struct Dark {
    place: Place,
    dusk: Utc,
    dawn: Utc,
}

impl Dark {
    /// This night, from now on where it has begun, if what is left of it is long enough; else the next.
    fn next(latitude_deg: f64, longitude_deg: f64, elevation_m: f64, now: Utc) -> Option<Self> {
        let (latitude, longitude) = (Angle::from_degrees(latitude_deg), Angle::from_degrees(longitude_deg));
        let place = Place::new(latitude, longitude, elevation_m).ok()?;
        let orientation = EarthOrientation::default();
        let tonight = sky::night(&place, &orientation, now).ok()?;
        let soon = now.plus_seconds(START_S);
        if let (Some(dusk), Some(dawn)) = (tonight.nautical_dusk, tonight.nautical_dawn)
            && dusk.max(soon).plus_seconds(LENGTH_S) <= dawn
        {
            return Some(Self { place, dusk: dusk.max(soon), dawn });
        }
        let next = sky::night(&place, &orientation, tonight.ends.plus_seconds(60.0)).ok()?;
        Some(Self { place, dusk: next.nautical_dusk?, dawn: next.nautical_dawn? })
    }
}
