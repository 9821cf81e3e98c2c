//! `open`: opens roof and covers, takes the mount out of its park position, and starts the cooler.

use schedule::action::Open;
use schedule::plan::TimedPart;

use super::{Execute, Techniques};
use crate::action_error::ActionError;
use crate::opening;
use crate::row_context::RowContext;

impl Execute for Open {
    async fn run(&self, context: &RowContext, techniques: &Techniques) -> Result<String, ActionError> {
        let chain = context.chain()?;
        if let Err(error) = chain.camera.start_cooling().await {
            // The rows that need a cold camera will report the failure.
            tracing::warn!(%error, "the cooler was not started");
        }
        context.step("opening", TimedPart::Open);
        opening::open(&techniques.opener, &chain).await?;
        Ok(String::new())
    }
}
