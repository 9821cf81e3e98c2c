//! `close`: parks the mount, closes roof and covers, and waits until that is verified.

use schemars::JsonSchema;
use serde::Deserialize;

use super::{Action, Needs, Stage};
use crate::plan::{Course, Halt};
use crate::trouble::Trouble;

/// Parks the mount, closes the roof and the covers, and waits until that is verified.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Close {}

/// What is said of a row that ends before everything is closed.
const TOO_LATE: &str = "not verified closed before end_time; the closing goes on";

impl Action for Close {
    const NAME: &'static str = "close";
    const EXAMPLE: &'static str = "{}";

    fn needs(&self) -> Needs {
        Needs { safe: false, mount: true, parallel: false, all_before: false }
    }

    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        course.ends_at(course.row.end, Halt::Failed(TOO_LATE.to_owned()));
        course.close()
    }

    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        stage.step("closing");
        let left_s = stage.row.end.seconds_since(stage.clock().utc());
        let most = crate::patience::patience(stage.clock(), units::seconds(left_s));
        // past its window the row has failed; the closing itself goes on
        tokio::time::timeout(most, stage.room.close("the schedule says so"))
            .await
            .map_err(|_| Trouble::Impossible(TOO_LATE.to_owned()))?;
        Ok(String::new())
    }
}
