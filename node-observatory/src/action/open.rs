//! `open`: opens roof and covers, takes the mount out of its park position, and starts the cooler.

use schedule::action::Open;

use super::{Execute, Stage};
use crate::opening;
use crate::trouble::Trouble;

impl Execute for Open {
    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        let chain = stage.chain()?;
        if let Err(trouble) = chain.camera.start_cooling().await {
            // The rows that need a cold camera will report the failure.
            tracing::warn!(%trouble, "the cooler was not started");
        }
        stage.step("opening");
        opening::open(&stage.room, &chain).await?;
        Ok(String::new())
    }
}
