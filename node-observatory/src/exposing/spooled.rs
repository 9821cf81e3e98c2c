//! A frame counts once its camera's node has it on disk: a node that dies between the end of the light and the disk
//! takes the frame with it, and then another one is taken in its place.

use std::time::Duration;

use contract::{BootId, CommandId};

use crate::action_error::ActionError;
use crate::row_context::RowContext;

/// The largest frames are on a slow disk within this time, three of them one after another, machine time.
const LONGEST: Duration = Duration::from_secs(60);
/// A new incarnation of the device node announces at its start what its spool holds. A frame that it has not announced
/// within this time is lost.
const NEW_INCARNATION: Duration = Duration::from_secs(3);

/// Frames whose light is in and which are not known to be on disk.
pub struct Unspooled {
    frames: Vec<CommandId>,
    boot_id: Option<BootId>,
}

impl Unspooled {
    /// No frames yet. Before the first of them, this records the incarnation of the camera's node that is received now.
    pub fn of(context: &RowContext) -> Result<Self, ActionError> {
        Ok(Self { frames: Vec::new(), boot_id: boot_id(context)? })
    }

    /// A frame's light is in.
    pub fn add(&mut self, frame: &CommandId) {
        self.frames.push(frame.clone());
    }

    /// Waits until each of them is on disk, or lost; returns how many are lost and forgets them all. A frame that is on
    /// disk is counted in the journal by then.
    pub async fn settle(&mut self, context: &RowContext) -> Result<u32, ActionError> {
        let (clock, mut ledger) = (context.clock(), context.tools.ledger.watch());
        let began = clock.machine();
        let mut changed = None;
        loop {
            {
                let known = ledger.borrow_and_update();
                self.frames.retain(|frame| !known.is_announced(frame));
            }
            if self.frames.is_empty() {
                self.boot_id = boot_id(context)?;
                return Ok(0);
            }
            let now = clock.machine();
            // A link that is down for a while is no new incarnation.
            let is_another = boot_id(context)?.zip(self.boot_id.clone()).is_some_and(|(now, then)| now != then);
            if changed.is_none() && is_another {
                changed = Some(now);
            }
            let is_silent = changed.is_some_and(|since| now.since(since) >= NEW_INCARNATION);
            if is_silent || now.since(began) >= LONGEST {
                let lost = std::mem::take(&mut self.frames);
                for frame in &lost {
                    tracing::warn!(%frame, camera = %context.row.camera, "a frame is lost: its camera's node had it not on disk");
                }
                self.boot_id = boot_id(context)?;
                return Ok(u32::try_from(lost.len()).unwrap_or(u32::MAX));
            }
            tokio::select! {
                _ = ledger.changed() => {}
                () = tokio::time::sleep(Duration::from_millis(100)) => {}
            }
        }
    }
}

fn boot_id(context: &RowContext) -> Result<Option<BootId>, ActionError> {
    let newest = context.chain()?.camera.instrument.newest();
    Ok(newest
        .filter(|received| received.sample.body.link == contract::Link::Connected)
        .map(|received| received.sample.boot_id))
}
