//! Schedules for tests: rows that start one after another from a given sky time on.

use std::fmt::Display;
use std::path::Path;

use contract::Address;
use serde_json::{Value, json};
use sky::{EarthOrientation, Horizontal, Observer, Place};
use units::{Angle, Utc};

use crate::site::{block, section};

/// Rows of one schedule.
pub type Rows = Vec<(&'static str, Value)>;

/// One row.
pub fn row(action: &'static str, value: Value) -> (&'static str, Value) {
    (action, value)
}

/// An `object` row for a field that stands high now: 20 deg from the zenith, towards the east.
pub fn object(options: &simulator::Options, name: &str, exposure_s: f64, frames: u32) -> (&'static str, Value) {
    let place = Place::new(options.latitude, options.longitude, options.elevation_m);
    let observer = place.and_then(|place| Observer::new(&place, &EarthOrientation::default(), options.start));
    let high = Horizontal { altitude: Angle::from_degrees(70.0), azimuth: Angle::from_degrees(90.0) };
    // The simulator's own options always name a place and a time that exist.
    let target = observer.map(|observer| observer.to_icrs(&high));
    let (ra_deg, dec_deg) = target.map_or((0.0, 0.0), |t| (t.ra.wrapped_positive().degrees(), t.dec.degrees()));
    let value = json!({
        "object": name, "ra": ra_deg, "dec": dec_deg, "exptime": exposure_s, "n": frames, "filter": "V",
    });
    row("object", value)
}

/// A night that holds the dome open until something closes it.
pub fn long_row(options: &simulator::Options) -> Rows {
    vec![row("open", json!({})), object(options, "Long field", 20.0, 1000)]
}

/// The text of a file of `examples/`.
///
/// # Panics
/// When there is no such file.
pub fn example(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(name);
    std::fs::read_to_string(path).expect("tests ask for examples that are there")
}

/// One line of a schedule.
pub fn schedule_line(camera: &str, action: &str, value: impl Display, [start, end]: [&dyn Display; 2]) -> String {
    format!(
        "{{\"device_name\": \"{camera}\", \"action_type\": \"{action}\", \"action_value\": {value}, \
         \"start_time\": \"{start}\", \"end_time\": \"{end}\"}}\n"
    )
}

/// The schedule's text.
pub(crate) fn jsonl(rows: &[(&'static str, Value)], start: Utc, length_s: f64) -> String {
    let end = start.plus_seconds(length_s);
    let line = |(index, (action, value)): (usize, &(&'static str, Value))| {
        schedule_line("camera", action, value, [&start.plus_seconds(index as f64), &end])
    };
    rows.iter().enumerate().map(line).collect()
}

/// The configuration of all ten simulated devices, with more of the mount, the focuser, the dome and the weather
/// station.
pub(crate) fn configuration(
    address: &Address,
    simulator: std::net::SocketAddr,
    options: &simulator::Options,
    [mount, focuser, dome, weather]: [&str; 4],
) -> String {
    let mut text = section(address, options)
        + &format!(
            "[bus]\nmulticast = false\n[clock]\nsimulator = \"http://{simulator}\"\n[schedule]\nrobotic = true\n\
             [web]\nlisten = \"127.0.0.1:0\"\n"
        );
    for (kind, name, more) in [
        ("telescope", "mount", mount),
        ("camera", "camera", "temperature_c = -10.0\ntemperature_tolerance_c = 2.0\n"),
        ("filterwheel", "wheel", ""),
        ("focuser", "focuser", focuser),
        ("dome", "dome", dome),
        ("safetymonitor", "monitor", "dwell_min = 0.5\n"),
        ("observingconditions", "weather", weather),
        ("covercalibrator", "cover", ""),
        ("switch", "power", ""),
        ("rotator", "rotator", ""),
    ] {
        text += &block(kind, name, simulator, more);
    }
    text
}
