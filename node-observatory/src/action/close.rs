//! `close`: parks the mount, closes roof and covers, and waits until that is verified.

use serde::Deserialize;

use super::{Action, Needs, Stage};
use crate::trouble::Trouble;

/// No parameters.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Close {}

impl Action for Close {
    const NAME: &'static str = "close";
    const EXAMPLE: &'static str = "{}";

    fn needs(&self) -> Needs {
        Needs { safe: false, mount: true, parallel: false, all_before: false }
    }

    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        stage.step("closing");
        let left_s = stage.row.end.seconds_since(stage.clock().utc());
        let most = crate::patience::patience(stage.clock(), crate::patience::seconds(left_s));
        // past its window the row has failed; the closing itself goes on
        tokio::time::timeout(most, stage.room.close("the schedule says so"))
            .await
            .map_err(|_| Trouble::Impossible("not verified closed before end_time; the closing goes on".to_owned()))?;
        Ok(String::new())
    }
}
