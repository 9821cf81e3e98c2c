//! One row from start to end: raced against the verdict, retried after a fault, settled when it is over.

use std::future::poll_fn;
use std::task::Poll;
use std::time::Duration;

use config::FaultPolicy;
use contract::Kind;
use contract::observatory::RowState;
use safety::objection::Objection;
use tokio::sync::watch;
use units::{Utc, seconds};

use crate::action::{self, Techniques};
use crate::action_error::ActionError;
use crate::expected::Lasts;
use crate::row_context::RowContext;

/// How a row ended.
#[derive(Debug, Clone, PartialEq)]
pub enum RowEnd {
    /// Done, with a summary.
    Finished(String),
    /// Not done, and not to be tried again; with the kind of device that is at fault, where one is.
    Failed(String, Option<Kind>),
    /// Not done because of a device: to be tried again later.
    Postponed {
        /// What went wrong.
        detail: String,
        /// The kind of device that is at fault, where one is.
        kind: Option<Kind>,
        /// The device (`site/telescope/kind/name`), if it says nothing: the row need not rest longer than that.
        silent: Option<String>,
    },
    /// Its target is hidden, and is clear from then on: other rows go on until then.
    Waits(String, Utc),
    /// Stopped; goes on when there is no objection to it any more.
    Interrupted(Objection),
    /// Ended between two frames, because the schedule has it no longer.
    Withdrawn,
}

/// Runs a row; never ends the night, whatever happens in it. One that is `withdrawn` ends with the frame under way.
pub async fn run_row(context: &RowContext, techniques: &Techniques, withdrawn: watch::Receiver<bool>) -> RowEnd {
    let taken = || context.tools.journal.progress(&context.row.id).taken;
    let faults = &context.tools.authority.node.config.faults;
    let pause = seconds(faults.pause_s);
    let (mut retried, mut had) = (0, taken());
    loop {
        let tried = tokio::select! {
            biased;
            objection = context.tools.authority.objected(&context.row) => Err(RowEnd::Interrupted(objection)),
            () = withdrawn_between_frames(context, withdrawn.clone()) => Err(RowEnd::Withdrawn),
            result = action::run(&context.row.action, context, techniques) => Ok(result),
        };
        let error = match tried {
            Ok(Ok(detail)) => {
                // Its frames are taken, so it is finished whatever the mount does, and whatever stands against it now.
                tokio::select! {
                    biased;
                    () = closes(context) => {}
                    () = context.rest_mount() => {}
                }
                return RowEnd::Finished(detail);
            }
            Ok(Err(error)) => error,
            Err(end) => {
                action::settle(context).await;
                if matches!(end, RowEnd::Withdrawn | RowEnd::Interrupted(Objection::Suspended(_))) {
                    rest(context).await;
                }
                return end;
            }
        };
        action::settle(context).await;
        // A fault an hour ago is no reason to give up now.
        if taken() > had {
            (retried, had) = (0, taken());
        }
        let in_time = context.tools.authority.surely(context.clock().utc()) < context.row.end;
        if let ActionError::Hidden { clear, .. } = &error {
            rest(context).await;
            return RowEnd::Waits(error.to_string(), *clear);
        }
        // Each try of a script may open and close the roof, another task looks names up, and a sensor that is not cold was
        // waited for long enough: such a row rests at once.
        let rests = matches!(error, ActionError::Script { .. } | ActionError::Unnamed(_) | ActionError::Cooling { .. });
        if rests || !error.may_pass() || retried >= faults.retries || !in_time {
            rest(context).await;
            let kind = error.kind();
            let policy = kind.map_or(FaultPolicy::Postpone, |kind| faults.policy(kind));
            return if error.may_pass() && in_time && policy != FaultPolicy::Skip {
                let at_fault =
                    error.device().filter(|device| error.is_silence() || !context.tools.devices.is_heard(device));
                RowEnd::Postponed { detail: error.to_string(), kind, silent: at_fault.map(str::to_owned) }
            } else {
                RowEnd::Failed(error.to_string(), kind)
            };
        }
        retried += 1;
        tracing::warn!(row = RowState::told(context.index), %error, retried, "trying again");
        context.small_step(format!("trying again after: {error}"), Lasts::Seconds(faults.pause_s));
        tokio::select! {
            objection = context.tools.authority.objected(&context.row) => return RowEnd::Interrupted(objection),
            () = withdrawn_between_frames(context, withdrawn.clone()) => return RowEnd::Withdrawn,
            () = tokio::time::sleep(pause) => {}
        }
    }
}

/// Waits until the schedule has the row no longer and no frame is under way. What else the row does is not worth
/// waiting for: nobody wants its outcome any more.
async fn withdrawn_between_frames(context: &RowContext, mut withdrawn: watch::Receiver<bool>) {
    loop {
        if withdrawn.wait_for(|withdrawn| *withdrawn).await.is_err() {
            // The runner is gone, and this row with it.
            return std::future::pending().await;
        }
        // The row runs in the same task, so whenever it wakes this is looked at, before the row goes on.
        let is_back = poll_fn(|_| match (*withdrawn.borrow(), context.is_exposing()) {
            (false, _) => Poll::Ready(true),
            (true, false) => Poll::Ready(false),
            (true, true) => Poll::Pending,
        });
        if !is_back.await {
            return;
        }
    }
}

/// Waits until something stands against the row for which the mount is parked anyway.
async fn closes(context: &RowContext) {
    while let Objection::Suspended(_) = context.tools.authority.objected(&context.row).await {
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
}

/// Where no frame is taken for a while, the mount does not go on following a target that nobody observes.
async fn rest(context: &RowContext) {
    if !context.row.action.needs().mount {
        return;
    }
    context.leave_mount();
    context.rest_mount().await;
}
