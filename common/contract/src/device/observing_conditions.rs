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

/// A property of ASCOM, and its field.
type Property = (&'static str, fn(&Fields) -> &Datum<f64>);

/// All of them, in the order of their names.
const PROPERTIES: [Property; 13] = [
    ("CloudCover", |fields| &fields.cloud_percent),
    ("DewPoint", |fields| &fields.dew_point_c),
    ("Humidity", |fields| &fields.humidity_percent),
    ("Pressure", |fields| &fields.pressure_hpa),
    ("RainRate", |fields| &fields.rain_mm_per_h),
    ("SkyBrightness", |fields| &fields.sky_lux),
    ("SkyQuality", |fields| &fields.sky_mag_per_arcsec2),
    ("SkyTemperature", |fields| &fields.sky_c),
    ("StarFWHM", |fields| &fields.star_fwhm_arcsec),
    ("Temperature", |fields| &fields.air_c),
    ("WindDirection", |fields| &fields.wind_from_deg),
    ("WindGust", |fields| &fields.gust_mps),
    ("WindSpeed", |fields| &fields.wind_mps),
];

/// ASCOM's names of the properties that a weather station may measure.
pub fn ascom_names() -> impl Iterator<Item = &'static str> {
    PROPERTIES.into_iter().map(|(name, _)| name)
}

/// Further values that limits can be put on, each with the two properties whose difference it is.
const DIFFERENCES: [(&str, [&str; 2]); 2] =
    [("RelativeSkyTemp", ["SkyTemperature", "Temperature"]), ("DewPointMargin", ["Temperature", "DewPoint"])];

/// Everything that a limit can be put on.
pub fn parameters() -> impl Iterator<Item = &'static str> {
    ascom_names().chain(DIFFERENCES.into_iter().map(|(name, _)| name))
}

/// The properties that such a parameter is made of; none for a name that is no parameter.
pub fn made_of(parameter: &str) -> Vec<&'static str> {
    let difference = DIFFERENCES.into_iter().find(|(name, _)| *name == parameter);
    difference.map_or_else(|| ascom_names().filter(|name| *name == parameter).collect(), |(_, of)| of.to_vec())
}

impl Fields {
    /// A measured value by its ASCOM name; `None` for a name that ASCOM does not know.
    pub fn by_ascom_name(&self, name: &str) -> Option<&Datum<f64>> {
        PROPERTIES.into_iter().find(|(known, _)| *known == name).map(|(_, field)| field(self))
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
