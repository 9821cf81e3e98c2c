//! `cool_camera`: runs the cooler and waits until the sensor is cold.

use schemars::JsonSchema;
use serde::Deserialize;

use super::{Action, Needs, Stage};
use crate::plan::{Course, Halt};
use crate::trouble::Trouble;

/// Runs the cooler to the camera's `temperature_c` and waits until the sensor is there; every action that exposes does so
/// by itself.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct CoolCamera {}

/// What is said of a camera that is not to be cooled.
const NOTHING: &str = "the camera has no temperature_c: nothing to cool";

impl Action for CoolCamera {
    const NAME: &'static str = "cool_camera";
    const EXAMPLE: &'static str = "{}";

    fn needs(&self) -> Needs {
        Needs { safe: false, mount: false, parallel: false, all_before: false }
    }

    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        if course.camera().is_some_and(|camera| camera.temperature_c.is_none()) {
            course.tell(NOTHING);
        }
        course.cool()
    }

    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        if stage.chain()?.camera.config.temperature_c.is_none() {
            return Ok(NOTHING.to_owned());
        }
        stage.step("cooling");
        stage.cool().await?;
        Ok(String::new())
    }
}
