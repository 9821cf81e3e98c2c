//! The archive's telemetry of earlier nights: forecasts and the expected times of steps are made from its overheads.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bus::AskError;
use contract::Key;
use contract::archive::{ArchiveAnswer, ArchiveQuestion, ArchiveRow, Ask};
use node::Node;
use schedule::plan::Evidence;
use schedule::plan::overheads::TOOK;
use tokio::sync::Mutex;

use crate::expected::StepTimes;

/// Frames and lines of the archive that overheads are measured from, the newest ones.
const MOST_FRAMES: u32 = 3000;
const MOST_LINES: u32 = 5000;
/// The archive answers within this, or overheads are assumed.
const ARCHIVE: Duration = Duration::from_secs(3);
/// Overheads change from night to night; the archive is not asked for each draft.
const AGAIN: Duration = Duration::from_secs(600);
/// ... and again after this where it did not answer.
const SILENT_AGAIN: Duration = Duration::from_secs(60);
/// How long steps take is learnt again after this.
const LEARN_AGAIN: Duration = Duration::from_secs(3600);

/// What the archive had.
#[derive(Debug, Default)]
pub struct EarlierNights {
    remembered: Mutex<Option<Remembered>>,
}

#[derive(Debug)]
struct Remembered {
    /// Until then the archive is not asked again.
    until: Instant,
    evidence: Arc<Evidence>,
}

impl EarlierNights {
    /// The telemetry of earlier nights; nothing where the archive does not answer.
    pub async fn evidence(&self, node: &Node) -> Arc<Evidence> {
        let mut remembered = self.remembered.lock().await;
        if let Some(known) = remembered.as_ref().filter(|known| Instant::now() < known.until) {
            return known.evidence.clone();
        }
        let (evidence, again) = match ask(node).await {
            Ok(evidence) => (Arc::new(evidence), AGAIN),
            Err(error) => {
                tracing::debug!(%error, "the archive does not answer: overheads are assumed");
                (Arc::default(), SILENT_AGAIN)
            }
        };
        *remembered = Some(Remembered { until: Instant::now() + again, evidence: evidence.clone() });
        evidence
    }

    /// Learns for ever how long steps take.
    pub async fn keep_learning(self: Arc<Self>, node: Node, step_times: Arc<StepTimes>) -> anyhow::Result<()> {
        loop {
            let evidence = self.evidence(&node).await;
            let is_empty = evidence.frames.is_empty() && evidence.lines.is_empty();
            if !is_empty {
                step_times.learn(evidence.overheads(&node.config));
            }
            tokio::time::sleep(if is_empty { SILENT_AGAIN } else { LEARN_AGAIN }).await;
        }
    }
}

async fn ask(node: &Node) -> Result<Evidence, AskError> {
    let key = Key::History(node.config.address());
    let ask = async |ask: Ask, limit: u32| {
        let question = ArchiveQuestion { ask, from_utc: None, to_utc: None, limit: Some(limit) };
        node.bus.ask::<_, ArchiveAnswer>(&key, &question, ARCHIVE).await.map(|answer| answer.rows)
    };
    let frames = ask(Ask::FindFrames(Box::default()), MOST_FRAMES).await?.into_iter().filter_map(|row| match row {
        ArchiveRow::FoundFrame(frame) => Some((*frame).into()),
        _ => None,
    });
    let lines = ask(Ask::Log, MOST_LINES).await?.into_iter().filter_map(|row| match row {
        ArchiveRow::Log { at_utc, message, .. } if message.starts_with(TOOK) => Some((at_utc, message)),
        _ => None,
    });
    Ok(Evidence { frames: frames.collect(), lines: lines.collect() })
}
