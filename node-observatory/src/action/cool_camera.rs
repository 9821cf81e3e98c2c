//! `cool_camera`: runs the cooler and waits until the sensor is cold.

use schedule::action::cool_camera::{CoolCamera, NOTHING_TO_COOL};
use schedule::plan::TimedPart;

use super::{Execute, Techniques};
use crate::action_error::ActionError;
use crate::row_context::RowContext;

impl Execute for CoolCamera {
    async fn run(&self, context: &RowContext, _: &Techniques) -> Result<String, ActionError> {
        if context.chain()?.camera.config.temperature_c.is_none() {
            return Ok(NOTHING_TO_COOL.to_owned());
        }
        context.step("cooling", TimedPart::Cool);
        context.cool().await?;
        Ok(String::new())
    }
}
