//! The truth gate: watches the frames of a row whose pointing was proven, and reports when that is no longer valid.

use std::sync::Arc;
use std::time::Duration;

use contract::CommandId;
use contract::device::telescope::PierSide;
use contract::observatory::AlertKind;
use imaging::NoSolution;
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
    /// Guide pulses move the mount, too.
    is_guided: bool,
    /// The mount has left the place that it was sent to, by its own coordinates or by trailed frames.
    has_left: bool,
    /// The newest frame that began before the last look at the mount's coordinates.
    judged: Option<CommandId>,
    /// A trailed frame without a solution that the frames end with.
    trailed: Option<CommandId>,
    /// Frames that do not count, of which nobody knows how far off they are.
    spoilt: Vec<CommandId>,
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
            is_guided: false,
            has_left: false,
            judged: context.last_frame(),
            trailed: None,
            spoilt: Vec::new(),
        }
    }

    /// The row is guided, or not.
    pub fn guided(self, is_guided: bool) -> Self {
        Self { is_guided, ..self }
    }

    /// Whether the mount itself has left the place that it was sent to.
    pub fn has_left(&self) -> bool {
        self.has_left
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
        self.look_at_the_mount();
        let now = pier_side(self.mount);
        if self.tolerance_arcmin.is_some() && now.is_some() && self.side.is_some() && now != self.side {
            self.lost.get_or_insert_with(|| "the mount changed the side of its pier".to_owned());
        }
        self.lost.as_deref()
    }

    /// A mount is believed by its coordinates: one that has left its place has spoilt the frame before.
    fn look_at_the_mount(&mut self) {
        let (alerts, name) = (&self.context.tools.authority.node.alerts, &self.mount.instrument.device.name);
        let last = self.context.last_frame().filter(|last| self.judged.as_ref() != Some(last));
        let Some(off_arcmin) = self.mount.left_by_arcmin(self.is_guided) else {
            if last.is_some() && !self.has_left {
                alerts.clear(AlertKind::MountLeftItsPlace, name);
                self.judged = last;
            }
            return;
        };
        if let Some(last) = last {
            tracing::warn!(frame = %last, off_arcmin, "the mount left its place; the frame does not count");
            self.judged = Some(last.clone());
            self.astray.push((last, off_arcmin));
        }
        let why = format!("{name} has left its place by {off_arcmin:.1} arcmin, by its own coordinates");
        if !std::mem::replace(&mut self.has_left, true) {
            alerts.raise(AlertKind::MountLeftItsPlace, name, &why);
        }
        self.lost.get_or_insert(why);
    }

    /// Two trailed frames without a solution, one after the other, prove nothing: the mount may stand, and report what it
    /// likes.
    fn note_trailed(&mut self, frame: &CommandId) {
        let Some(before) = self.trailed.replace(frame.clone()) else { return };
        tracing::warn!(%frame, "trailed frames that cannot be solved do not count");
        self.spoilt.extend([before, frame.clone()]);
        self.has_left = true;
        let why = "two frames are trailed and cannot be solved".to_owned();
        let (alerts, name) = (&self.context.tools.authority.node.alerts, &self.mount.instrument.device.name);
        alerts.raise(AlertKind::MountLeftItsPlace, name, &format!("{name}: {why}"));
        self.lost.get_or_insert(why);
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
        let (astray, spoilt) = (std::mem::take(&mut self.astray), std::mem::take(&mut self.spoilt));
        if astray.is_empty() && spoilt.is_empty() {
            return Ok(());
        }
        let noted = move |journal: &Journal, row: &RowId, now| {
            astray.iter().try_for_each(|(frame, off_arcmin)| journal.astray(row, frame, *off_arcmin, now))?;
            spoilt.iter().try_for_each(|frame| journal.hidden(row, frame, 0.0, false, now))
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
        if !is_of_row {
            return;
        }
        let Some(Ok(solution)) = looked.solved.as_ref() else {
            let is_trailed =
                looked.facts.trailed == Some(true) || matches!(looked.solved, Some(Err(NoSolution::Trailed { .. })));
            if is_trailed && self.tolerance_arcmin.is_some() {
                self.note_trailed(&frame.id);
            } else {
                self.trailed = None;
            }
            return;
        };
        self.trailed = None;
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
