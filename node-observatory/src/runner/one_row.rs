//! One row from start to end: raced against the verdict, retried after a fault, settled when it is over.

use std::time::Duration;

use crate::action::Stage;
use crate::control_room::Objection;
use crate::trouble::Trouble;

/// How a row ended.
#[derive(Debug, Clone, PartialEq)]
pub enum RowEnd {
    /// Done, with what is worth telling.
    Finished(String),
    /// Not done, and not to be tried again.
    Failed(String),
    /// Stopped; goes on when nothing stands against it any more.
    Interrupted(Objection),
}

/// A device fault is tried again so often without a frame in between ...
const RETRIES: u32 = 2;
/// ... after so long of machine time.
const PAUSE: Duration = Duration::from_secs(5);

/// Runs a row; never ends the night, whatever happens in it.
pub async fn run_row(stage: &Stage) -> RowEnd {
    let taken = || stage.room.journal.progress(&stage.row.id).taken;
    let (mut retried, mut had) = (0, taken());
    loop {
        let tried = tokio::select! {
            biased;
            objection = stage.room.objected(&stage.row) => Err(objection),
            result = stage.row.action.run(stage) => Ok(result),
        };
        let trouble = match tried {
            Ok(Ok(detail)) => return RowEnd::Finished(detail),
            Ok(Err(trouble)) => trouble,
            Err(objection) => {
                stage.settle().await;
                return RowEnd::Interrupted(objection);
            }
        };
        stage.settle().await;
        // a fault an hour ago is no reason to give up now
        if taken() > had {
            (retried, had) = (0, taken());
        }
        let in_time = stage.clock().utc() < stage.row.end;
        if !trouble.may_pass() || retried >= RETRIES || !in_time {
            rest(stage).await;
            return RowEnd::Failed(trouble.to_string());
        }
        retried += 1;
        tracing::warn!(row = stage.index, %trouble, retried, "trying again");
        stage.small_step(format!("trying again after: {trouble}"));
        tokio::select! {
            objection = stage.room.objected(&stage.row) => return RowEnd::Interrupted(objection),
            () = tokio::time::sleep(PAUSE) => {}
        }
    }
}

/// After a failure the mount does not go on following a target that nobody observes.
async fn rest(stage: &Stage) {
    if !stage.row.action.needs().mount {
        return;
    }
    let stopped: Result<(), Trouble> = async {
        match stage.chain()?.mount {
            Some(mount) => mount.track(false).await,
            None => Ok(()),
        }
    }
    .await;
    if let Err(trouble) = stopped {
        tracing::warn!(%trouble, "the mount may still track");
    }
}
