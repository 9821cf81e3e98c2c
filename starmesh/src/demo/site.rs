//! The demo's observatory: its configuration, its night and its schedule.

use anyhow::Context as _;
use serde_json::json;
use sky::{EarthOrientation, Icrs, Night, Place};
use units::{Angle, Utc};

use crate::fields::{FIELDS, NamedField};

/// The place and the time of the demo.
pub struct DemoNight {
    /// Start of the simulation: a quarter of an hour before sunset.
    pub start: Utc,
    /// Nautical dusk, when the dome may open.
    pub dusk: Utc,
    /// Nautical dawn, when it must close.
    pub dawn: Utc,
    place: Place,
}

/// Camera side, pixels; with the simulator's optics a field of about 1.5 deg.
pub const CAMERA_PX: u32 = 2048;

const SLOTS: u32 = 5;
/// Seconds are enough for people.
const TIME: &str = "%Y-%m-%dT%H:%M:%SZ";
const FILTERS: [&str; 5] = ["V", "R", "B", "I", "Clear"];

impl DemoNight {
    /// The next night of a place after `now`.
    pub fn next(latitude: Angle, longitude: Angle, elevation_m: f64, now: Utc) -> anyhow::Result<Self> {
        let place = Place::new(latitude, longitude, elevation_m)?;
        let orientation = EarthOrientation::default();
        // The night that `now` belongs to may be half over: take the one that begins at the next noon.
        let tomorrow = sky::night(&place, &orientation, now)?.ends;
        let night: Night = sky::night(&place, &orientation, tomorrow.plus_seconds(60.0))?;
        let known = |time: Option<Utc>| time.context("the Sun does not set and rise there");
        Ok(Self {
            start: known(night.sunset)?.plus_seconds(-900.0),
            dusk: known(night.nautical_dusk)?,
            dawn: known(night.nautical_dawn)?,
            place,
        })
    }

    /// The middle of the night, when the demo's shower begins.
    pub fn shower(&self) -> Utc {
        self.dusk.plus_seconds(0.55 * self.dawn.seconds_since(self.dusk))
    }

    /// The schedule, JSONL: cool, open, five objects pointed and guided, close, flats, darks, headers.
    pub fn schedule(&self) -> anyhow::Result<String> {
        let mut rows = vec!["// the demo's night; the format is described in docs/operator/schedule.md".to_owned()];
        let mut row = |action: &str, value: serde_json::Value, start: Utc, end: Utc| {
            let line = json!({
                "device_name": "camera", "action_type": action, "action_value": value,
                "start_time": start.strftime(TIME), "end_time": end.strftime(TIME), "programme": "DEMO.2026",
            });
            rows.push(line.to_string());
        };
        row("cool_camera", json!({}), self.start.plus_seconds(60.0), self.dusk);
        row("open", json!({}), self.dusk, self.dawn);
        for (index, (name, ra_deg, dec_deg, start, end)) in self.slots()?.into_iter().enumerate() {
            let value = json!({
                "object": name, "ra": ra_deg, "dec": dec_deg, "exptime": 120.0, "n": 20, "filter": FILTERS[index % 5],
                "pointing": true, "guiding": true,
            });
            row("object", value, start, end);
        }
        row("close", json!({}), self.dawn, self.dawn.plus_seconds(3600.0));
        // Behind the closed cover, which has a lamp.
        let flats = json!({ "filter": FILTERS, "n": FILTERS.map(|_| 3), "source": "panel" });
        row("flats", flats, self.dawn.plus_seconds(1.0), self.dawn.plus_seconds(2.0 * 3600.0));
        let calibration = json!({ "exptime": [0.0, 30.0, 120.0], "n": [5, 3, 3] });
        row("calibration", calibration, self.dawn.plus_seconds(2.0), self.dawn.plus_seconds(2.0 * 3600.0));
        row("complete_headers", json!({}), self.dawn.plus_seconds(3.0), self.dawn.plus_seconds(12.0 * 3600.0));
        Ok(rows.join("\n") + "\n")
    }

    /// Cuts the night into slots and gives each the field that stays highest in it.
    fn slots(&self) -> anyhow::Result<Vec<Slot>> {
        let length_s = (self.dawn.seconds_since(self.dusk) - 600.0) / f64::from(SLOTS);
        let mut left: Vec<NamedField> = FIELDS.to_vec();
        let mut slots = Vec::new();
        for slot in 0..SLOTS {
            let start = self.dusk.plus_seconds(300.0 + f64::from(slot) * length_s);
            let end = start.plus_seconds(length_s);
            let mut best: Option<(usize, f64)> = None;
            for (index, field) in left.iter().enumerate() {
                let field = Icrs::from_degrees(field.ra_deg, field.dec_deg);
                let lowest = sky::lowest_altitude(&self.place, &EarthOrientation::default(), &field, start, end)?;
                let altitude_deg = lowest.altitude.degrees();
                if best.is_none_or(|(_, highest)| altitude_deg > highest) {
                    best = Some((index, altitude_deg));
                }
            }
            let (index, _) = best.context("no field is left for the demo")?;
            let NamedField { name, ra_deg, dec_deg, .. } = left.swap_remove(index);
            slots.push((name, ra_deg, dec_deg, start, end));
        }
        Ok(slots)
    }
}

/// A field and when it is observed: name, right ascension and declination (ICRS degrees), start, end.
type Slot = (&'static str, f64, f64, Utc, Utc);

/// The configuration of the demo's nodes.
pub fn configuration(simulator: std::net::SocketAddr, web_port: u16, options: &simulator::Options) -> String {
    let mut text = format!(
        r#"# written by `starmesh demo`
[observatory]
site = "demo"
telescope = "alpha"
latitude_deg = {}
longitude_deg = {}
elevation_m = {}

[bus]
multicast = false

[clock]
simulator = "http://{simulator}"

[schedule]
robotic = true

[pointing]
# on a busy machine hours of this fast sky pass between two looks, and the mount drifts meanwhile
threshold_arcmin = 0.3

[web]
listen = "127.0.0.1:{web_port}"
"#,
        options.latitude.degrees(),
        options.longitude.degrees(),
        options.elevation_m,
    );
    let blocks = [
        ("telescope", "mount", ""),
        ("camera", "camera", "temperature_c = -20.0\nread_noise_e = 8.0\n"),
        ("filterwheel", "wheel", ""),
        ("focuser", "focuser", ""),
        ("dome", "dome", "watchdog_s = 120.0\nwatchdog_action = \"feedwatchdog\"\n"),
        ("safetymonitor", "monitor", "dwell_min = 15.0\n"),
        (
            "observingconditions",
            "weather",
            "limit = [\n    { parameter = \"Humidity\", upper = 90.0, dwell_min = 15.0 },\n    \
             { parameter = \"WindSpeed\", upper = 15.0, dwell_min = 15.0 },\n    \
             { parameter = \"RainRate\", upper = 0.0, dwell_min = 20.0 },\n]\n",
        ),
        ("covercalibrator", "cover", ""),
        ("switch", "power", ""),
        ("rotator", "rotator", ""),
    ];
    for (kind, name, extra) in blocks {
        text.push_str(&format!("\n[[{kind}]]\nname = \"{name}\"\nserver = \"{simulator}\"\nnumber = 0\n{extra}"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_demo_configuration_and_schedule_are_valid() {
        let options = simulator::Options::default();
        let address = "127.0.0.1:11111".parse().unwrap();
        let config = config::parse(&configuration(address, 8080, &options), std::path::Path::new(".")).unwrap();
        assert_eq!(config.devices().len(), 10);
        let now = "2026-11-21T03:00:00Z".parse().unwrap();
        let night = DemoNight::next(options.latitude, options.longitude, options.elevation_m, now).unwrap();
        assert!(night.start < night.dusk && night.dusk < night.dawn);
        let cameras = [config.camera[0].common.name.clone()];
        let rows = schedule::parse(&night.schedule().unwrap(), &cameras).unwrap();
        assert_eq!(rows.len(), 11);
    }

    #[test]
    fn every_slot_has_a_field_of_its_own_well_above_the_horizon() {
        let options = simulator::Options::default();
        for month in 1..=12 {
            let now = format!("2026-{month:02}-15T12:00:00Z").parse().unwrap();
            let night = DemoNight::next(options.latitude, options.longitude, options.elevation_m, now).unwrap();
            let slots = night.slots().unwrap();
            let names: std::collections::HashSet<_> = slots.iter().map(|slot| slot.0).collect();
            assert_eq!(names.len(), SLOTS as usize);
            for (name, ra_deg, dec_deg, start, end) in slots {
                let field = Icrs::from_degrees(ra_deg, dec_deg);
                let lowest =
                    sky::lowest_altitude(&night.place, &EarthOrientation::default(), &field, start, end).unwrap();
                assert!(lowest.altitude.degrees() > 25.0, "{name} in month {month}: {lowest:?}");
            }
        }
    }
}
