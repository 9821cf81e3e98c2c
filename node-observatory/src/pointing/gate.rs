//! The truth gate: watches the frames of a row whose pointing was proven, and reports when that is no longer valid.

use std::sync::Arc;
use std::time::Duration;

use contract::CommandId;
use contract::device::telescope::PierSide;
use imaging::tangent::separation;
use schedule::RowId;
use sky::Icrs;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::TryRecvError;
use units::Utc;

use super::fix::{learn, pier_side};
use super::{PointingData, pair};
use crate::action_error::ActionError;
use crate::devices::telescope::Mount;
use crate::frames::looked::Looked;
use crate::journal::Journal;
use crate::row_context::RowContext;

/// The last frame's place is waited for no longer than this, machine time.
const LAST_LOOK: Duration = Duration::from_secs(15);

/// What the frames of a row show of where they look.
pub struct Gate<'a> {
    context: &'a RowContext,
    pointing: &'a PointingData,
    mount: &'a Mount,
    target: Icrs,
    looks: Receiver<Arc<Looked>>,
    /// Earlier frames do not show what is now.
    since_utc: Utc,
    side: Option<PierSide>,
    /// Further off than this a frame does not count, arcmin; none where the row asks for no proof.
    tolerance_arcmin: Option<f64>,
    /// The place commanded last, while the node has yet to learn from the first frame after it.
    to_learn: Option<Icrs>,
    astray: Vec<(CommandId, f64)>,
    lost: Option<String>,
    is_proven: bool,
}

impl<'a> Gate<'a> {
    /// Watches the frames of a row that asks for proof, from now on: it was on target a moment ago.
    pub fn proven(context: &'a RowContext, pointing: &'a PointingData, mount: &'a Mount, target: Icrs) -> Self {
        let tolerance_arcmin = Some(context.tools.authority.node.config.pointing.tolerance_arcmin);
        Self { tolerance_arcmin, ..Self::learning(context, pointing, mount, target, None) }
    }

    /// Only learns, from the first frame that shows where a slew to `commanded` has led.
    pub fn learning(
        context: &'a RowContext,
        pointing: &'a PointingData,
        mount: &'a Mount,
        target: Icrs,
        commanded: Option<Icrs>,
    ) -> Self {
        Self {
            context,
            pointing,
            mount,
            target,
            looks: context.tools.frames.looks.follow(),
            since_utc: context.clock().utc(),
            side: pier_side(mount),
            tolerance_arcmin: None,
            to_learn: commanded,
            astray: Vec::new(),
            lost: None,
            is_proven: false,
        }
    }

    /// Why the telescope is not known to be on target any more, by all that frames and mount have shown until now.
    pub fn lost(&mut self) -> Option<&str> {
        loop {
            match self.looks.try_recv() {
                Ok(looked) => self.observe(&looked),
                Err(TryRecvError::Lagged(_)) => {}
                Err(TryRecvError::Empty | TryRecvError::Closed) => break,
            }
        }
        let now = pier_side(self.mount);
        if self.tolerance_arcmin.is_some() && now.is_some() && self.side.is_some() && now != self.side {
            self.lost.get_or_insert_with(|| "the mount changed the side of its pier".to_owned());
        }
        self.lost.as_deref()
    }

    /// Whether a frame has shown since that the telescope is on target.
    pub fn is_proven(&self) -> bool {
        self.is_proven
    }

    /// After a row's last frame: waits until it was looked at, and writes down which frames do not count.
    pub async fn settle(&mut self) -> Result<(), ActionError> {
        if self.tolerance_arcmin.is_some()
            && let Some(last) = self.context.last_frame()
        {
            // One that is late counts: the row was proven.
            let _ = tokio::time::timeout(LAST_LOOK, self.context.tools.frames.looks.of(&last)).await;
            self.lost();
        }
        let astray = std::mem::take(&mut self.astray);
        if astray.is_empty() {
            return Ok(());
        }
        let noted = move |journal: &Journal, row: &RowId, now| {
            astray.iter().try_for_each(|(frame, off_arcmin)| journal.astray(row, frame, *off_arcmin, now))
        };
        self.context.write(noted).await?;
        let taken = self.context.tools.journal.progress(&self.context.row.id).taken;
        self.context.tools.night.row(self.context.index, |row| row.frames = taken);
        Ok(())
    }

    fn observe(&mut self, looked: &Looked) {
        let (frame, row) = (&looked.frame, &self.context.row);
        let is_of_row = frame.purpose.row == Some(self.context.index)
            && frame.camera == row.camera.as_str()
            && frame.purpose.action == row.action.name()
            && frame.started_utc >= self.since_utc;
        let Some(Ok(solution)) = looked.solved.as_ref().filter(|_| is_of_row) else { return };
        if let Some(commanded) = self.to_learn.take() {
            learn(self.context, self.pointing, &commanded, frame, solution);
        }
        let Some(tolerance_arcmin) = self.tolerance_arcmin else { return };
        let off_arcmin = separation(pair(&self.target), (solution.ra, solution.dec)).degrees() * 60.0;
        self.pointing.state.send_modify(|state| state.off_target_arcmin = Some(round(off_arcmin)));
        if off_arcmin <= tolerance_arcmin {
            self.is_proven = true;
            return;
        }
        tracing::warn!(frame = %frame.id, off_arcmin, "a frame is off target and does not count");
        self.astray.push((frame.id.clone(), off_arcmin));
        self.lost = Some(format!("a frame looks {off_arcmin:.2} arcmin off the target"));
    }
}

/// As many digits as a measurement has.
pub fn round(arcmin: f64) -> f64 {
    (arcmin * 1e4).round() / 1e4
}
