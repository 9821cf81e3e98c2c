//! One row from start to end: raced against the verdict, retried after a fault, settled when it is over.

use std::future::poll_fn;
use std::task::Poll;

use config::FaultPolicy;
use contract::Kind;
use safety::objection::Objection;
use tokio::sync::watch;
use units::{Utc, seconds};

use crate::action::{self, Stage};
use crate::trouble::Trouble;

/// How a row ended.
#[derive(Debug, Clone, PartialEq)]
pub enum RowEnd {
    /// Done, with a summary.
    Finished(String),
    /// Not done, and not to be tried again.
    Failed(String),
    /// Not done because of a device: to be tried again later.
    Postponed(String, Option<Kind>),
    /// Its target is hidden, and is clear from then on: other rows go on until then.
    Waits(String, Utc),
    /// Stopped; goes on when there is no objection to it any more.
    Interrupted(Objection),
    /// Ended between two frames, because the schedule has it no longer.
    Withdrawn,
}

/// Runs a row; never ends the night, whatever happens in it. One that is `withdrawn` ends with the frame under way.
pub async fn run_row(stage: &Stage, withdrawn: watch::Receiver<bool>) -> RowEnd {
    let taken = || stage.room.journal.progress(&stage.row.id).taken;
    let faults = &stage.room.node.config.faults;
    let pause = seconds(faults.pause_s);
    let (mut retried, mut had) = (0, taken());
    loop {
        let tried = tokio::select! {
            biased;
            objection = stage.room.objected(&stage.row) => Err(RowEnd::Interrupted(objection)),
            () = withdrawn_between_frames(stage, withdrawn.clone()) => Err(RowEnd::Withdrawn),
            result = action::run(&stage.row.action, stage) => Ok(result),
        };
        let trouble = match tried {
            Ok(Ok(detail)) => return RowEnd::Finished(detail),
            Ok(Err(trouble)) => trouble,
            Err(end) => {
                stage.settle().await;
                if end == RowEnd::Withdrawn {
                    rest(stage).await;
                }
                return end;
            }
        };
        stage.settle().await;
        // A fault an hour ago is no reason to give up now.
        if taken() > had {
            (retried, had) = (0, taken());
        }
        let in_time = stage.clock().utc() < stage.row.end;
        if let Trouble::Hidden { clear, .. } = &trouble {
            rest(stage).await;
            return RowEnd::Waits(trouble.to_string(), *clear);
        }
        // Each try of a script may open and close the roof, and another task looks names up: such a row rests at once.
        let rests = matches!(trouble, Trouble::Script { .. } | Trouble::Unnamed(_));
        if rests || !trouble.may_pass() || retried >= faults.retries || !in_time {
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
            () = withdrawn_between_frames(stage, withdrawn.clone()) => return RowEnd::Withdrawn,
            () = tokio::time::sleep(pause) => {}
        }
    }
}

/// Waits until the schedule has the row no longer and no frame is under way. What else the row does is not worth
/// waiting for: nobody wants its outcome any more.
async fn withdrawn_between_frames(stage: &Stage, mut withdrawn: watch::Receiver<bool>) {
    loop {
        if withdrawn.wait_for(|withdrawn| *withdrawn).await.is_err() {
            // The runner is gone, and this row with it.
            return std::future::pending().await;
        }
        // The row runs in the same task, so whenever it wakes this is looked at, before the row goes on.
        let is_back = poll_fn(|_| match (*withdrawn.borrow(), stage.is_exposing()) {
            (false, _) => Poll::Ready(true),
            (true, false) => Poll::Ready(false),
            (true, true) => Poll::Pending,
        });
        if !is_back.await {
            return;
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
