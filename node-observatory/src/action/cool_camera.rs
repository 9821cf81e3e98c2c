//! `cool_camera`: runs the cooler and waits until the sensor is cold.

use schedule::action::cool_camera::{CoolCamera, NOTHING_TO_COOL};

use super::{Execute, Stage};
use crate::trouble::Trouble;

impl Execute for CoolCamera {
    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        if stage.chain()?.camera.config.temperature_c.is_none() {
            return Ok(NOTHING_TO_COOL.to_owned());
        }
        stage.step("cooling");
        stage.cool().await?;
        Ok(String::new())
    }
}
