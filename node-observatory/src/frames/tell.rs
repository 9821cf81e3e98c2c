//! Publishes the facts of frames: each frame has a key of its own, and one publisher.

use std::collections::VecDeque;

use bus::{Publisher, Quality};
use contract::observatory::FrameFacts;
use contract::{CommandId, Key, Name};
use tokio::sync::Mutex;

use crate::control_room::ControlRoom;

/// Frames whose facts are kept for those who were away: three hours of 30 s frames.
const KEPT: usize = 360;

/// The published facts of the last frames.
#[derive(Default)]
pub struct Telling {
    said: Mutex<VecDeque<Said>>,
}

struct Said {
    frame: Name,
    line: Publisher<FrameFacts>,
    facts: FrameFacts,
}

impl Telling {
    /// Publishes what was measured on a frame. If the frame's facts are published again, the same publisher is used,
    /// with the next number and with what the dome hid of the frame.
    pub async fn tell(&self, room: &ControlRoom, facts: FrameFacts) -> anyhow::Result<()> {
        self.join(room, &facts.frame.clone(), |said| FrameFacts {
            dome_hid_percent: facts.dome_hid_percent.or(said.dome_hid_percent),
            refused: facts.refused.or(said.refused),
            ..facts
        })
        .await
    }

    /// Publishes what the dome hid of a frame's light, percent, together with the earlier measurements.
    pub async fn tell_hidden(&self, room: &ControlRoom, frame: &CommandId, percent: f64) -> anyhow::Result<()> {
        self.join(room, frame, |said| FrameFacts { dome_hid_percent: Some(percent), ..said }).await
    }

    /// Publishes why a frame does not count, together with the earlier measurements.
    pub async fn tell_refused(&self, room: &ControlRoom, frame: &CommandId, why: String) -> anyhow::Result<()> {
        self.join(room, frame, |said| FrameFacts { refused: Some(why), ..said }).await
    }

    async fn join(
        &self,
        room: &ControlRoom,
        frame: &CommandId,
        join: impl FnOnce(FrameFacts) -> FrameFacts,
    ) -> anyhow::Result<()> {
        let Ok(name) = frame.0.parse::<Name>() else {
            tracing::warn!(%frame, "a frame whose id is no name has no key for its facts");
            return Ok(());
        };
        let mut said = self.said.lock().await;
        if let Some(known) = said.iter_mut().find(|known| known.frame == name) {
            known.facts = join(known.facts.clone());
            return Ok(known.line.put(known.facts.clone()).await?);
        }
        let key = Key::Facts(room.node.config.address(), name.clone());
        let line = room.node.bus.publisher(&key, Quality::Event { cache: 2 }).await?;
        let facts = join(FrameFacts { frame: frame.clone(), ..FrameFacts::default() });
        line.put(facts.clone()).await?;
        said.push_back(Said { frame: name, line, facts });
        if said.len() > KEPT {
            said.pop_front();
        }
        Ok(())
    }
}
