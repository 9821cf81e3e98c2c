//! Publishes the facts of frames: each frame has a key of its own, and one publisher.

use std::collections::VecDeque;

use bus::Publisher;
use contract::observatory::FrameFacts;
use contract::{CommandId, Key, Name};
use node::Node;
use tokio::sync::Mutex;

/// Frames whose facts are kept for those who were away: three hours of 30 s frames.
const MOST_STORED: usize = 360;

/// The published facts of the last frames.
#[derive(Default)]
pub struct FactsPublisher {
    published: Mutex<VecDeque<PublishedFacts>>,
}

struct PublishedFacts {
    frame: Name,
    line: Publisher<FrameFacts>,
    facts: FrameFacts,
}

impl FactsPublisher {
    /// Publishes what was measured on a frame. If the frame's facts are published again, the same publisher is used,
    /// with the next number and with what the dome hid of the frame.
    pub async fn publish(&self, node: &Node, facts: FrameFacts) -> anyhow::Result<()> {
        self.join(node, &facts.frame.clone(), |published| FrameFacts {
            dome_hid_percent: facts.dome_hid_percent.or(published.dome_hid_percent),
            refused: facts.refused.or(published.refused),
            ..facts
        })
        .await
    }

    /// Publishes what the dome hid of a frame's light, percent, together with the earlier measurements.
    pub async fn publish_hidden(&self, node: &Node, frame: &CommandId, percent: f64) -> anyhow::Result<()> {
        self.join(node, frame, |published| FrameFacts { dome_hid_percent: Some(percent), ..published }).await
    }

    /// Publishes why a frame does not count, together with the earlier measurements.
    pub async fn publish_refused(&self, node: &Node, frame: &CommandId, why: String) -> anyhow::Result<()> {
        self.join(node, frame, |published| FrameFacts { refused: Some(why), ..published }).await
    }

    async fn join(
        &self,
        node: &Node,
        frame: &CommandId,
        join: impl FnOnce(FrameFacts) -> FrameFacts,
    ) -> anyhow::Result<()> {
        let Ok(name) = frame.0.parse::<Name>() else {
            tracing::warn!(%frame, "a frame whose id is no name has no key for its facts");
            return Ok(());
        };
        let mut published = self.published.lock().await;
        if let Some(known) = published.iter_mut().find(|known| known.frame == name) {
            known.facts = join(known.facts.clone());
            return Ok(known.line.put(known.facts.clone()).await?);
        }
        let key = Key::Facts(node.config.address(), name.clone());
        let line = node.bus.publisher(&key).await?;
        let facts = join(FrameFacts { frame: frame.clone(), ..FrameFacts::default() });
        line.put(facts.clone()).await?;
        published.push_back(PublishedFacts { frame: name, line, facts });
        if published.len() > MOST_STORED {
            published.pop_front();
        }
        Ok(())
    }
}
