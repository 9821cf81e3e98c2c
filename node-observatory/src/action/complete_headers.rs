//! `complete_headers`: waits until the archive has stored every frame of this night with a complete header.

use std::time::Duration;

use contract::archive::{ArchiveAnswer, ArchiveQuestion, ArchiveRow, Ask};
use contract::{CommandId, Key};
use schedule::action::CompleteHeaders;
use units::Angle;

use super::{Execute, Techniques};
use crate::action_error::ActionError;
use crate::expected::Lasts;
use crate::row_context::RowContext;

/// How often the archive is asked about files whose announcement was missed.
const ASK: Duration = Duration::from_secs(15);

impl Execute for CompleteHeaders {
    async fn run(&self, context: &RowContext, _: &Techniques) -> Result<String, ActionError> {
        let night = context.night().to_string();
        let mut frames = context.tools.ledger.watch();
        let mut asked = None;
        loop {
            let (complete, all) = frames.borrow_and_update().complete(&night);
            context.small_step(format!("{complete} of {all} headers complete"), Lasts::Unbounded);
            if complete == all {
                return Ok(format!("{all} headers complete"));
            }
            if context.clock().utc() >= context.row.end {
                return Ok(format!("{complete} of {all} headers complete at end_time"));
            }
            let now = context.clock().machine();
            if asked.is_none_or(|at| now.since(at) >= ASK) {
                asked = Some(now);
                ask_archive(context).await;
                continue;
            }
            let left =
                context.clock().machine_duration(units::seconds(context.row.end.seconds_since(context.clock().utc())));
            tokio::select! {
                _ = frames.changed() => {}
                () = tokio::time::sleep(left.clamp(Duration::from_millis(20), ASK)) => {}
            }
        }
    }
}

/// Learns from the archive's record what was stored while this node did not listen.
async fn ask_archive(context: &RowContext) {
    let config = &context.tools.authority.node.config;
    let noon = context.night().noon(Angle::from_degrees(config.place.longitude_deg));
    let question = ArchiveQuestion { ask: Ask::Frames, from_utc: Some(noon), to_utc: None, limit: Some(10_000) };
    let key = Key::History(config.address());
    match context.tools.authority.node.bus.ask::<_, ArchiveAnswer>(&key, &question, Duration::from_secs(3)).await {
        Ok(answer) => {
            for row in answer.rows {
                if let ArchiveRow::Frame { id, header_complete: true, .. } = row {
                    let id: CommandId = id;
                    context.tools.ledger.complete(&id);
                }
            }
        }
        Err(error) => tracing::debug!(%error, "the archive was not asked"),
    }
}
