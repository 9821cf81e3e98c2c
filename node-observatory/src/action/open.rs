//! `open`: opens roof and covers, takes the mount out of its park position, and starts the cooler.

use serde::Deserialize;

use super::{Action, Needs, Stage};
use crate::opening;
use crate::trouble::Trouble;

/// No parameters.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Open {}

impl Action for Open {
    const NAME: &'static str = "open";
    const EXAMPLE: &'static str = "{}";

    fn needs(&self) -> Needs {
        Needs { safe: true, mount: true, parallel: false, all_before: false }
    }

    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        let chain = stage.chain()?;
        if let Err(trouble) = chain.camera.start_cooling().await {
            // the rows that need a cold camera will say so
            tracing::warn!(%trouble, "the cooler was not started");
        }
        stage.step("opening");
        opening::open(&stage.room, &chain).await?;
        Ok(String::new())
    }
}
