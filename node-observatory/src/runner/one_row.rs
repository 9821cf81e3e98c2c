//! One row from start to end: raced against the verdict, retried after a fault, settled when it is over.

use config::FaultPolicy;
use contract::Kind;

use crate::action::Stage;
use crate::control_room::Objection;
use crate::patience::seconds;
use crate::trouble::Trouble;

/// How a row ended.
#[derive(Debug, Clone, PartialEq)]
pub enum RowEnd {
    /// Done, with what is worth telling.
    Finished(String),
    /// Not done, and not to be tried again.
    Failed(String),
    /// Not done because of a device: to be tried again later.
    Postponed(String, Option<Kind>),
    /// Stopped; goes on when nothing stands against it any more.
    Interrupted(Objection),
}

/// Runs a row; never ends the night, whatever happens in it.
pub async fn run_row(stage: &Stage) -> RowEnd {
    let taken = || stage.room.journal.progress(&stage.row.id).taken;
    let faults = &stage.room.node.config.faults;
    let pause = seconds(faults.pause_s);
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
        if !trouble.may_pass() || retried >= faults.retries || !in_time {
            rest(stage).await;
            let kind = trouble.kind();
            let policy = kind.map_or(FaultPolicy::Postpone, |kind| faults.policy(kind));
            return if trouble.may_pass() && in_time && policy != FaultPolicy::Skip {
                RowEnd::Postponed(trouble.to_string(), kind)
            } else {
                RowEnd::Failed(trouble.to_string())
            };
        }
        retried += 1;
        tracing::warn!(row = stage.index, %trouble, retried, "trying again");
        stage.small_step(format!("trying again after: {trouble}"));
        tokio::select! {
            objection = stage.room.objected(&stage.row) => return RowEnd::Interrupted(objection),
            () = tokio::time::sleep(pause) => {}
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
