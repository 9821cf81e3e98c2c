//! What is known of a camera's sensor, and what is not.

use std::collections::BTreeSet;

/// What the configuration says of a sensor, before what its driver reports.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sensor {
    /// Electrons of one ADU.
    pub electrons_per_adu: Option<f64>,
    /// Read noise, electrons.
    pub read_noise_e: Option<f64>,
    /// A pixel of this value or above is saturated, ADU.
    pub saturation_adu: Option<f64>,
}

impl Sensor {
    /// What a configuration says of the camera of this name.
    pub fn of(config: &config::Observatory, camera: &str) -> Self {
        let block = config.camera.iter().find(|block| block.common.name.as_str() == camera);
        block.map_or_else(Self::default, |block| Self {
            electrons_per_adu: block.electrons_per_adu,
            read_noise_e: block.read_noise_e,
            saturation_adu: block.saturation_adu,
        })
    }
}

/// What photometry needs of the sensor, and what gives it where the driver does not: the history names what is missing.
const OF_SENSOR: [(&str, &str); 3] =
    [("GAIN", "electrons_per_adu"), ("RDNOISE", "read_noise_e"), ("SATURATE", "saturation_adu")];

/// Says which values of the sensor a header does not have, and what gives them.
pub fn unknown_of_sensor(present: &BTreeSet<String>) -> Vec<String> {
    let is_missing = |(keyword, _): &&(&str, &str)| !present.contains(*keyword);
    let line = |(keyword, key): &(&str, &str)| format!("{keyword} not known: give {key} of the camera's block");
    OF_SENSOR.iter().filter(is_missing).map(line).collect()
}
