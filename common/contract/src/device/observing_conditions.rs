//! A weather station.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::record::StateRecord;
use crate::{Datum, DeviceKind, Kind, Payload};

/// The weather station, ASCOM ObservingConditions.
#[derive(Debug)]
pub struct ObservingConditions;

impl DeviceKind for ObservingConditions {
    const KIND: Kind = Kind::ObservingConditions;
    type Capabilities = Capabilities;
    type Fields = Fields;
    type Command = Command;
}

/// What a weather station measures.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "ObservingConditionsCapabilities")]
pub struct Capabilities {
    /// ASCOM names of the properties that it answered when it was connected.
    pub measures: Vec<String>,
}

impl Payload for Capabilities {
    const NAME: &'static str = "observingconditions.capabilities";
}

/// What nodes decide with.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "ObservingConditionsFields")]
pub struct Fields {
    /// Clouds, percent of the sky.
    pub cloud_percent: Datum<f64>,
    /// Dew point, degrees Celsius.
    pub dew_point_c: Datum<f64>,
    /// Relative humidity, percent.
    pub humidity_percent: Datum<f64>,
    /// Pressure at the site, hPa.
    pub pressure_hpa: Datum<f64>,
    /// Rain, mm/h.
    pub rain_mm_per_h: Datum<f64>,
    /// Sky brightness, lux.
    pub sky_lux: Datum<f64>,
    /// Sky quality, mag/arcsec2.
    pub sky_mag_per_arcsec2: Datum<f64>,
    /// Sky temperature, degrees Celsius.
    pub sky_c: Datum<f64>,
    /// Seeing, arcsec.
    pub star_fwhm_arcsec: Datum<f64>,
    /// Air temperature, degrees Celsius.
    pub air_c: Datum<f64>,
    /// Wind direction, degrees, from which it blows; 0 when calm.
    pub wind_from_deg: Datum<f64>,
    /// Gusts, m/s.
    pub gust_mps: Datum<f64>,
    /// Wind, m/s.
    pub wind_mps: Datum<f64>,
    /// Age of the station's own newest measurement, s of sky time.
    pub sensor_age_s: Datum<f64>,
    /// The same of single sensors when the station was asked, by ASCOM name; only of those whose age it shows.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub sensor_ages_s: BTreeMap<String, Datum<f64>>,
}

impl Payload for Fields {
    const NAME: &'static str = "observingconditions.state";
}

impl Payload for StateRecord<Fields> {
    const NAME: &'static str = "observingconditions.record";
}

/// The values that air, sky and the sensors that measure them can have. What is outside is the code of a broken or absent
/// sensor, or has another unit, and is no measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhysicalRange {
    /// Smallest value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
    /// Unit in words.
    pub unit: &'static str,
}

impl PhysicalRange {
    /// Is this value within? NaN is not.
    pub fn contains(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }
}

/// A property of ASCOM, its field and its range.
type Property = (&'static str, fn(&Fields) -> &Datum<f64>, PhysicalRange);

const fn range(low: f64, high: f64, unit: &'static str) -> PhysicalRange {
    PhysicalRange { low, high, unit }
}

/// All of them, in the order of their names. The ranges are the wider of what was ever measured near the ground of the
/// Earth and what the data sheets of usual sensors allow: MLX90614 for the sky (specified from -70; -273.15 and -178 to
/// -94 are its codes), BME280 and SHT3x for the air (Humidity is a little above 100 in fog), BMP280 for the pressure,
/// and ultrasonic anemometers for the wind. A covered sky quality meter shows more than 23.
const PROPERTIES: [Property; 13] = [
    ("CloudCover", |fields| &fields.cloud_percent, range(0.0, 100.0, "percent")),
    ("DewPoint", |fields| &fields.dew_point_c, range(-90.0, 50.0, "degrees Celsius")),
    ("Humidity", |fields| &fields.humidity_percent, range(0.0, 105.0, "percent")),
    ("Pressure", |fields| &fields.pressure_hpa, range(300.0, 1100.0, "hPa, not reduced to sea level")),
    ("RainRate", |fields| &fields.rain_mm_per_h, range(0.0, 1000.0, "mm/h")),
    ("SkyBrightness", |fields| &fields.sky_lux, range(0.0, 200_000.0, "lux")),
    ("SkyQuality", |fields| &fields.sky_mag_per_arcsec2, range(0.0, 23.0, "mag per square arcsec")),
    ("SkyTemperature", |fields| &fields.sky_c, range(-70.0, 50.0, "degrees Celsius")),
    ("StarFWHM", |fields| &fields.star_fwhm_arcsec, range(0.1, 100.0, "arcsec")),
    ("Temperature", |fields| &fields.air_c, range(-90.0, 60.0, "degrees Celsius")),
    ("WindDirection", |fields| &fields.wind_from_deg, range(0.0, 360.0, "degrees")),
    ("WindGust", |fields| &fields.gust_mps, range(0.0, 120.0, "m/s")),
    ("WindSpeed", |fields| &fields.wind_mps, range(0.0, 100.0, "m/s")),
];

/// ASCOM's names of the properties that a weather station may measure.
pub fn ascom_names() -> impl Iterator<Item = &'static str> {
    PROPERTIES.into_iter().map(|(name, ..)| name)
}

/// A further value that limits can be put on, the two properties whose difference it is, and its range.
type Difference = (&'static str, [&'static str; 2], PhysicalRange);

/// All of them. The clearest and driest sky is some 65 K colder than the air; the dew point is never above the
/// temperature, but for the errors of both sensors.
const DIFFERENCES: [Difference; 2] = [
    ("RelativeSkyTemp", ["SkyTemperature", "Temperature"], range(-80.0, 40.0, "kelvin of difference")),
    ("DewPointMargin", ["Temperature", "DewPoint"], range(-2.0, 80.0, "kelvin of difference")),
];

/// Everything that a limit can be put on.
pub fn parameters() -> impl Iterator<Item = &'static str> {
    ascom_names().chain(differences())
}

/// The parameters that are the difference of two properties.
pub fn differences() -> impl Iterator<Item = &'static str> {
    DIFFERENCES.into_iter().map(|(name, ..)| name)
}

/// The range of a parameter; `None` for a name that is no parameter.
pub fn physical_range(parameter: &str) -> Option<PhysicalRange> {
    let properties = PROPERTIES.into_iter().map(|(name, _, range)| (name, range));
    let differences = DIFFERENCES.into_iter().map(|(name, _, range)| (name, range));
    properties.chain(differences).find(|(name, _)| *name == parameter).map(|(_, range)| range)
}

/// The properties that such a parameter is made of; none for a name that is no parameter.
pub fn made_of(parameter: &str) -> Vec<&'static str> {
    let difference = DIFFERENCES.into_iter().find(|(name, ..)| *name == parameter);
    difference.map_or_else(|| ascom_names().filter(|name| *name == parameter).collect(), |(_, of, _)| of.to_vec())
}

impl Fields {
    /// A measured value by its ASCOM name; `None` for a name that ASCOM does not know.
    pub fn by_ascom_name(&self, name: &str) -> Option<&Datum<f64>> {
        PROPERTIES.into_iter().find(|(known, ..)| *known == name).map(|(_, field, _)| field(self))
    }

    /// The value of a parameter, or why there is none: it is missing, or outside of its range.
    ///
    /// # Errors
    /// The reason, with the value and the range; of a difference it names the part that is missing.
    pub fn measured(&self, parameter: &str) -> Result<f64, String> {
        let value = match made_of(parameter).as_slice() {
            [from, what] => {
                let part = |name: &str| self.measured(name).map_err(|why| format!("{name}: {why}"));
                part(from)? - part(what)?
            }
            _ => {
                let datum = self.by_ascom_name(parameter).ok_or_else(|| format!("{parameter} is no parameter"))?;
                *datum.as_result().map_err(ToString::to_string)?
            }
        };
        match physical_range(parameter) {
            Some(range) if range.contains(value) => Ok(value),
            Some(PhysicalRange { low, high, unit }) => {
                let rounded = (value * 1000.0).round() / 1000.0;
                // What is just outside of a range must not read as if it were inside.
                let shown = if rounded < low || rounded > high { rounded.to_string() } else { format!("{value:e}") };
                Err(format!("{shown} is not possible; expected {low} to {high} {unit}"))
            }
            None => Err(format!("{parameter} has no range, so that no value of it is believed")),
        }
    }
}

/// What a weather station may be asked.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "ObservingConditionsCommand")]
#[serde(rename_all = "snake_case")]
pub enum Command {
    /// Measure now.
    Refresh,
}

impl Payload for Command {
    const NAME: &'static str = "observingconditions.command";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_parameter_has_a_range_and_nothing_outside_of_it_is_measured() {
        for name in parameters() {
            let range = physical_range(name).unwrap();
            assert!(range.low < range.high && !range.unit.is_empty(), "{name}");
            assert!(!range.contains(f64::NAN) && !range.contains(f64::INFINITY), "{name}");
            // Codes of sensors, and what an overflow leaves.
            for code in [-999.0, -998.0, -9999.0, -127.0, -273.15, 9999.0, 65535.0, 1e9, -1e9] {
                assert!(!range.contains(code) || (name == "SkyBrightness" && code > 0.0), "{name}: {code}");
            }
        }
        assert_eq!(physical_range("Luck"), None);
    }

    #[test]
    fn a_difference_is_held_against_its_own_range() {
        let fields =
            |sky_c, air_c| Fields { sky_c: Datum::Known(sky_c), air_c: Datum::Known(air_c), ..Fields::default() };
        assert_eq!(fields(-20.0, 5.0).measured("RelativeSkyTemp"), Ok(-25.0));
        let far = fields(-69.0, 30.0).measured("RelativeSkyTemp").unwrap_err();
        assert_eq!(far, "-99 is not possible; expected -80 to 40 kelvin of difference");
        let negative = Fields { rain_mm_per_h: Datum::Known(-1e-9), ..Fields::default() };
        assert!(negative.measured("RainRate").unwrap_err().starts_with("-1e-9 is not possible; expected 0 to "));
        assert!(fields(-178.0, 5.0).measured("RelativeSkyTemp").unwrap_err().starts_with("SkyTemperature: -178"));
    }
}
