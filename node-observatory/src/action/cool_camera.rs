//! `cool_camera`: runs the cooler and waits until the sensor is cold.

use schedule::action::cool_camera::{CoolCamera, NOTHING_TO_COOL};

use super::{Execute, Techniques};
use crate::action_error::ActionError;
use crate::expected::Lasts;
use crate::row_context::RowContext;
use schedule::plan::TimedPart;

impl Execute for CoolCamera {
    async fn run(&self, context: &RowContext, _: &Techniques) -> Result<String, ActionError> {
        if context.chain()?.camera.config.temperature_c.is_none() {
            return Ok(NOTHING_TO_COOL.to_owned());
        }
        context.step("cooling", Lasts::Part(TimedPart::Cool));
        context.cool().await?;
        Ok(String::new())
    }
}
