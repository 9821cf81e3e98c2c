//! `close`: parks the mount, closes roof and covers, and waits until that is verified.

use schedule::action::close::{Close, TOO_LATE};
use schedule::plan::TimedPart;

use super::{Execute, Techniques};
use crate::action_error::ActionError;
use crate::row_context::RowContext;

impl Execute for Close {
    async fn run(&self, context: &RowContext, _: &Techniques) -> Result<String, ActionError> {
        context.step("closing", TimedPart::Close);
        let left_s = context.row.end.seconds_since(context.clock().utc());
        let most = crate::command_timeout::command_timeout(context.clock(), units::seconds(left_s));
        // Past its window the row has failed; the closing itself goes on.
        tokio::time::timeout(most, context.tools.authority.close("the schedule says so"))
            .await
            .map_err(|_| ActionError::Impossible(TOO_LATE.to_owned()))?;
        Ok(String::new())
    }
}
