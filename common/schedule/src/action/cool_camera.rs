//! `cool_camera`: runs the cooler and waits until the sensor is cold.

use schemars::JsonSchema;
use serde::Deserialize;

use super::{ActionType, Needs, Parameters};

/// Runs the cooler to the camera's `temperature_c` and waits until the sensor is there; every action that exposes does so
/// by itself.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct CoolCamera {}

/// The note of a row whose camera is not to be cooled.
pub const NOTHING_TO_COOL: &str = "the camera has no temperature_c: nothing to cool";

impl ActionType for CoolCamera {
    const NAME: &'static str = "cool_camera";
    const EXAMPLE: &'static str = "{}";
}

impl Parameters for CoolCamera {
    fn needs(&self) -> Needs {
        Needs { safe: false, mount: false, parallel: false, all_before: false }
    }
}
