//! Computes weather that is fair for a site's limits, where the simulator's own is not.

use std::collections::BTreeMap;

use contract::device::observing_conditions::physical_range;
use serde_json::{Map, Value};

/// The simulator's own weather in fair nights, in ASCOM's units: least and greatest value.
const BY_ITSELF: [(&str, f64, f64); 12] = [
    ("CloudCover", 0.0, 9.0),
    ("DewPoint", -20.0, 8.0),
    ("Humidity", 15.0, 60.0),
    ("RainRate", 0.0, 0.0),
    ("SkyTemperature", -34.0, -12.0),
    ("StarFWHM", 0.6, 2.0),
    ("Temperature", 4.0, 18.0),
    ("WindDirection", 0.0, 360.0),
    ("WindGust", 0.0, 9.0),
    ("WindSpeed", 0.0, 6.0),
    ("SkyQuality", 0.0, 22.5),
    ("SkyBrightness", 0.0, 100_000.0),
];
/// Sky minus air: a limit on it is one on both.
const RELATIVE: &str = "RelativeSkyTemp";

/// Least and greatest value that all limits of each parameter allow.
type Room = BTreeMap<String, (f64, f64)>;

/// Values to be ordered of the simulator so that all of these limits hold, as [`super::devices`] has written them.
pub fn fair(limits: &[&str]) -> Map<String, Value> {
    let mut room = Room::new();
    for limit in limits {
        let Some((parameter, upper, lower)) = read(limit) else { continue };
        // Nothing outside of this range would be believed.
        let possible = physical_range(&parameter).map(|range| (range.low, range.high));
        let (least, most) = room.entry(parameter).or_insert(possible.unwrap_or((f64::NEG_INFINITY, f64::INFINITY)));
        *least = least.max(lower.unwrap_or(f64::NEG_INFINITY));
        *most = most.min(upper.unwrap_or(f64::INFINITY));
    }
    let mut ordered = Map::new();
    if let Some((least, most)) = room.remove(RELATIVE) {
        // With the air at rest, the sky alone is limited.
        let (coldest, warmest) = room.get("Temperature").copied().unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
        let air = within(10.0, coldest, warmest);
        ordered.insert("Temperature".to_owned(), air.into());
        let of_sky = room.entry("SkyTemperature".to_owned()).or_insert((f64::NEG_INFINITY, f64::INFINITY));
        *of_sky = (of_sky.0.max(air + least), of_sky.1.min(air + most));
    }
    for (parameter, (least, most)) in room {
        let Some((name, low, high)) = BY_ITSELF.iter().find(|(name, ..)| *name == parameter).copied() else { continue };
        if (low < least || high > most) && !ordered.contains_key(name) {
            ordered.insert(name.to_owned(), within(0.5 * (low + high), least, most).into());
        }
    }
    // A gust that is less than the wind would contradict it.
    if let Some(gust) = ordered.get("WindGust").and_then(Value::as_f64)
        && !ordered.contains_key("WindSpeed")
    {
        ordered.insert("WindSpeed".to_owned(), ((700.0 * gust).round() / 1000.0).into());
    }
    ordered
}

/// The value within the bounds that is nearest to `wanted`, with some distance from them.
fn within(wanted: f64, least: f64, most: f64) -> f64 {
    let away = if (most - least).is_finite() { 0.2 * (most - least).max(0.0) } else { 5.0 };
    let (low, high) = (least + away, most - away);
    let value = if wanted < low { low } else { wanted.min(high) };
    (1000.0 * value).round() / 1000.0
}

/// Parameter, upper and lower of a limit.
fn read(limit: &str) -> Option<(String, Option<f64>, Option<f64>)> {
    let (parameter, rest) = limit.strip_prefix("{ parameter = \"")?.split_once('"')?;
    let number = |key: &str| -> Option<f64> {
        let (_, rest) = rest.split_once(&format!(" {key} = "))?;
        rest.split([',', ' ', '}']).next()?.parse().ok()
    };
    Some((parameter.to_owned(), number("upper"), number("lower")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weather_is_fair_for_the_predecessors_template_and_let_alone_where_it_is_fair_anyway() {
        let template = [
            "{ parameter = \"Humidity\", upper = 70, dwell_min = 30 }",
            "{ parameter = \"Temperature\", lower = 0, dwell_min = 30 }",
            "{ parameter = \"WindSpeed\", upper = 10, dwell_min = 30 }",
            "{ parameter = \"SkyTemperature\", upper = -30, dwell_min = 30 }",
            "{ parameter = \"RelativeSkyTemp\", upper = -40, dwell_min = 30 }",
        ];
        let values = fair(&template);
        let value = |name: &str| values[name].as_f64().unwrap();
        assert!(
            value("SkyTemperature") < -30.0 && value("SkyTemperature") - value("Temperature") < -40.0,
            "{values:?}"
        );
        assert_eq!(values.len(), 2, "{values:?}");
        let damp = fair(&[
            "{ parameter = \"Humidity\", upper = 40, lower = 20, dwell_min = 5 }",
            "{ parameter = \"RainRate\", upper = 0 }",
        ]);
        assert!((20.0..40.0).contains(&damp["Humidity"].as_f64().unwrap()) && damp.len() == 1, "{damp:?}");
        assert!(fair(&[]).is_empty());
        let calm = fair(&["{ parameter = \"WindGust\", upper = 3 }"]);
        let (gust, wind) = (calm["WindGust"].as_f64().unwrap(), calm["WindSpeed"].as_f64().unwrap());
        assert!(wind > 0.0 && wind < gust && gust < 3.0, "no station reports less than nothing: {calm:?}");
    }
}
