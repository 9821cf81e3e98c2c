//! `open`: opens roof and covers, takes the mount out of its park position, and starts the cooler.

use schemars::JsonSchema;
use serde::Deserialize;

use super::{Action, Needs, Stage};
use crate::opening;
use crate::plan::{Course, Halt};
use crate::trouble::Trouble;

/// Opens the roof and the covers, takes the mount out of its park position, and starts the cooler.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Open {}

impl Action for Open {
    const NAME: &'static str = "open";
    const EXAMPLE: &'static str = "{}";

    fn needs(&self) -> Needs {
        Needs { safe: true, mount: true, parallel: false, all_before: false }
    }

    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        course.start_cooling();
        course.open()
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
