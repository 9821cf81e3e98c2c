//! `cool_camera`: runs the cooler and waits until the sensor is cold.

use serde::Deserialize;

use super::{Action, Needs, Stage};
use crate::trouble::Trouble;

/// No parameters; the set point is the camera's `temperature_c`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoolCamera {}

impl Action for CoolCamera {
    const NAME: &'static str = "cool_camera";
    const EXAMPLE: &'static str = "{}";

    fn needs(&self) -> Needs {
        Needs { safe: false, mount: false, parallel: false, all_before: false }
    }

    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        if stage.chain()?.camera.config.temperature_c.is_none() {
            return Ok("the camera has no temperature_c: nothing to cool".to_owned());
        }
        stage.step("cooling");
        stage.cool().await?;
        Ok(String::new())
    }
}
