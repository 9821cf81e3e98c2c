//! A frame counts once its camera's node has it on disk: a node that dies between the end of the light and the disk
//! takes the frame with it, and then another one is taken in its place.

use std::time::Duration;

use contract::{BootId, CommandId};

use super::Stage;
use crate::trouble::Trouble;

/// The largest frames are on a slow disk within this time, three of them one after another, machine time.
const LONGEST: Duration = Duration::from_secs(60);
/// A new incarnation of the device node announces at its start what its spool holds. A frame that it has not announced
/// within this time is lost.
const NEW_LIFE: Duration = Duration::from_secs(3);

/// Frames whose light is in and which are not known to be on disk.
pub struct Unspooled {
    frames: Vec<CommandId>,
    life: Option<BootId>,
}

impl Unspooled {
    /// No frames yet. Before the first of them, this records the incarnation of the camera's node that is received now.
    pub fn of(stage: &Stage) -> Result<Self, Trouble> {
        Ok(Self { frames: Vec::new(), life: life(stage)? })
    }

    /// A frame's light is in.
    pub fn add(&mut self, frame: &CommandId) {
        self.frames.push(frame.clone());
    }

    /// Waits until each of them is on disk, or lost; returns how many are lost and forgets them all. A frame that is on
    /// disk is counted in the journal by then.
    pub async fn settle(&mut self, stage: &Stage) -> Result<u32, Trouble> {
        let (clock, mut ledger) = (stage.clock(), stage.room.ledger.watch());
        let began = clock.machine();
        let mut new_life = None;
        loop {
            {
                let known = ledger.borrow_and_update();
                self.frames.retain(|frame| !known.is_announced(frame));
            }
            if self.frames.is_empty() {
                self.life = life(stage)?;
                return Ok(0);
            }
            let now = clock.machine();
            // A link that is down for a while is no new incarnation.
            let is_another = life(stage)?.zip(self.life.clone()).is_some_and(|(now, then)| now != then);
            if new_life.is_none() && is_another {
                new_life = Some(now);
            }
            let is_silent = new_life.is_some_and(|since| now.since(since) >= NEW_LIFE);
            if is_silent || now.since(began) >= LONGEST {
                let lost = std::mem::take(&mut self.frames);
                for frame in &lost {
                    tracing::warn!(%frame, camera = %stage.row.camera, "a frame is lost: its camera's node had it not on disk");
                }
                self.life = life(stage)?;
                return Ok(u32::try_from(lost.len()).unwrap_or(u32::MAX));
            }
            tokio::select! {
                _ = ledger.changed() => {}
                () = tokio::time::sleep(Duration::from_millis(100)) => {}
            }
        }
    }
}

fn life(stage: &Stage) -> Result<Option<BootId>, Trouble> {
    let newest = stage.chain()?.camera.instrument.newest();
    Ok(newest.filter(|heard| heard.said.body.link == contract::Link::Connected).map(|heard| heard.said.boot_id))
}
