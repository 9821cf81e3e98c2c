//! `close`: parks the mount, closes roof and covers, and waits until that is verified.

use schedule::action::close::{Close, TOO_LATE};

use super::{Execute, Stage};
use crate::trouble::Trouble;

impl Execute for Close {
    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        stage.step("closing");
        let left_s = stage.row.end.seconds_since(stage.clock().utc());
        let most = crate::patience::patience(stage.clock(), units::seconds(left_s));
        // Past its window the row has failed; the closing itself goes on.
        tokio::time::timeout(most, stage.room.close("the schedule says so"))
            .await
            .map_err(|_| Trouble::Impossible(TOO_LATE.to_owned()))?;
        Ok(String::new())
    }
}
