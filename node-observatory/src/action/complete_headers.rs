//! `complete_headers`: waits until the archive has stored every frame of this night with a complete header.

use std::time::Duration;

use contract::archive::{Answer, Ask, Question, Row};
use contract::{CommandId, Key};
use schedule::action::CompleteHeaders;
use units::Angle;

use super::{Execute, Stage};
use crate::trouble::Trouble;

/// How often the archive is asked about files whose announcement was missed.
const ASK: Duration = Duration::from_secs(15);

impl Execute for CompleteHeaders {
    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        let night = stage.night().to_string();
        let mut frames = stage.room.ledger.watch();
        let mut asked = None;
        loop {
            let (complete, all) = frames.borrow_and_update().complete(&night);
            stage.small_step(format!("{complete} of {all} headers complete"));
            if complete == all {
                return Ok(format!("{all} headers complete"));
            }
            if stage.clock().utc() >= stage.row.end {
                return Ok(format!("{complete} of {all} headers complete at end_time"));
            }
            let now = stage.clock().machine();
            if asked.is_none_or(|at| now.since(at) >= ASK) {
                asked = Some(now);
                ask_archive(stage).await;
                continue;
            }
            let left = stage.clock().machine_duration(units::seconds(stage.row.end.seconds_since(stage.clock().utc())));
            tokio::select! {
                _ = frames.changed() => {}
                () = tokio::time::sleep(left.clamp(Duration::from_millis(20), ASK)) => {}
            }
        }
    }
}

/// Learns from the archive's record what was stored while this node did not listen.
async fn ask_archive(stage: &Stage) {
    let config = &stage.room.node.config;
    let noon = stage.night().noon(Angle::from_degrees(config.place.longitude_deg));
    let question = Question { ask: Ask::Frames, from_utc: Some(noon), to_utc: None, limit: Some(10_000) };
    let key = Key::History(config.address());
    match stage.room.node.bus.ask::<_, Answer>(&key, &question, Duration::from_secs(3)).await {
        Ok(answer) => {
            for row in answer.rows {
                if let Row::Frame { id, header_complete: true, .. } = row {
                    let id: CommandId = id;
                    stage.room.ledger.complete(&id);
                }
            }
        }
        Err(error) => tracing::debug!(%error, "the archive was not asked"),
    }
}
