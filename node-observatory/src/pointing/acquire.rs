//! Brings a telescope onto its target, frame by frame, until a solved frame proves that it is there.

use contract::observatory::AlertKind;
use imaging::pointing::{Approach, Step};
use sky::Icrs;
use units::{Angle, seconds};

use super::failure::{Deed, exposure_s, first_exposure_s};
use super::fix::{learn, look, seen};
use super::gate::round;
use super::{icrs, pair};
use crate::action::Stage;
use crate::action::expose::{Series, aside};
use crate::rig::telescope::Mount;
use crate::trouble::Trouble;
use schedule::plan::overheads::Span;
use schedule::shot::Shot;

/// ASTRATYP of the frames that show where the telescope looks.
pub const ACTION: &str = "pointing";

/// A row's way to its target.
#[derive(Debug, Clone, Copy)]
pub struct Way {
    /// Where the telescope should look.
    pub target: Icrs,
    /// Where it was sent last.
    pub commanded: Icrs,
    /// Exposure time of the row, s.
    pub exptime_s: f64,
    /// Frames that may yet be taken on the way.
    pub frames_left: u32,
    /// No frame has shown yet where the last slew led: after hours of tracking a frame shows drift, not pointing.
    pub is_fresh: bool,
}

impl Way {
    /// A way that has begun with a slew to `commanded`.
    pub fn begun(stage: &Stage, target: Icrs, commanded: Icrs, exptime_s: f64) -> Self {
        let frames_left = stage.room.node.config.pointing.attempts;
        Self { target, commanded, exptime_s, frames_left, is_fresh: true }
    }

    /// Slews to where it was sent last: a person who moved the mount meanwhile moved it away from there, and a
    /// correction of that by the frames alone would overshoot.
    pub async fn again(&mut self, stage: &Stage, mount: &Mount) -> Result<(), Trouble> {
        mount.point(&self.commanded, &stage.visible(&self.commanded)?).await?;
        self.is_fresh = true;
        Ok(())
    }

    /// A frame of the row has shown the telescope on its target: what comes now is another loss, with tries of its own.
    pub fn renew(&mut self, stage: &Stage) {
        self.frames_left = stage.room.node.config.pointing.attempts;
    }
}

/// Takes frames and corrects until one shows the telescope on its target; returns how that went, in words.
///
/// # Errors
/// [`Trouble::Unproven`] when the frames do not show where they look, or the mount does not go where it is sent.
pub async fn acquire(stage: &Stage, mount: &Mount, series: &Series, way: &mut Way) -> Result<String, Trouble> {
    let room = &stage.room;
    room.pointing.send_modify(|state| state.active = true);
    let _shown = Shown { stage };
    let began = stage.clock().utc();
    let result = frames(stage, mount, series, way).await;
    let camera = stage.row.camera.as_str();
    match &result {
        Ok(told) => {
            room.node.alerts.clear(AlertKind::PointingUnproven, camera);
            stage.took(Span::Acquire, began);
            tracing::info!(camera, told, "on target");
            room.pointing.send_modify(|state| state.detail = told_of(series, told));
        }
        Err(trouble @ Trouble::Unproven { why, .. }) => {
            room.node.alerts.raise(AlertKind::PointingUnproven, camera, &trouble.to_string());
            room.pointing.send_modify(|state| state.detail = told_of(series, why));
        }
        Err(trouble) => room.pointing.send_modify(|state| state.detail = told_of(series, &trouble.to_string())),
    }
    result
}

/// Shows that nothing is acquired any more, also when the action is dropped.
struct Shown<'a> {
    stage: &'a Stage,
}

impl Drop for Shown<'_> {
    fn drop(&mut self) {
        self.stage.room.pointing.send_modify(|state| state.active = false);
    }
}

fn told_of(series: &Series, told: &str) -> String {
    series.object.as_ref().map_or_else(|| told.to_owned(), |object| format!("{object}: {told}"))
}

async fn frames(stage: &Stage, mount: &Mount, series: &Series, way: &mut Way) -> Result<String, Trouble> {
    let config = &stage.room.node.config.pointing;
    let threshold = Angle::from_degrees(config.threshold_arcmin / 60.0);
    let mut approach = Approach::new(pair(&way.target), pair(&way.commanded), threshold);
    let mut shot_s = first_exposure_s(config.exposure_s, way.exptime_s);
    let (mut changes, mut slews) = (0, 0);
    let mut last = "no frame may be taken any more".to_owned();
    while way.frames_left > 0 {
        way.frames_left -= 1;
        let words = format!("finding out where it looks, {shot_s} s");
        let shot = Shot { exposure_s: shot_s, image_type: "Light Frame", words };
        let frame = aside(stage, series, &shot, ACTION).await?;
        let looked = look(stage, &frame).await;
        let (why, deed) = match seen(looked.as_deref()) {
            Ok(solution) => {
                if let Some(looked) = looked.as_ref().filter(|_| std::mem::take(&mut way.is_fresh)) {
                    learn(stage, &way.commanded, &looked.frame, solution);
                }
                let step = approach.look((solution.ra, solution.dec));
                let off_arcmin = approach.distances().last().map_or(0.0, |off| off.degrees() * 60.0);
                stage.room.pointing.send_modify(|state| state.off_target_arcmin = Some(round(off_arcmin)));
                match step {
                    Step::OnTarget => {
                        let plural = if slews == 1 { "" } else { "s" };
                        return Ok(format!("on target within {off_arcmin:.2} arcmin after {slews} correction{plural}"));
                    }
                    Step::Hopeless => {
                        let why = format!(
                            "it looks {off_arcmin:.2} arcmin beside the target, and two corrections did not help: the \
                             mount does not go where it is sent"
                        );
                        return Err(unproven(stage, why, true));
                    }
                    Step::Slew(to) => {
                        last = format!("it looks {off_arcmin:.2} arcmin beside the target");
                        if way.frames_left > 0 {
                            stage.step(format!("correcting by {off_arcmin:.2} arcmin"));
                            let to = icrs(to);
                            mount.point(&to, &stage.visible(&to)?).await?;
                            calm(stage, mount, way.exptime_s).await;
                            (way.commanded, way.is_fresh, slews) = (to, true, slews + 1);
                        }
                        continue;
                    }
                }
            }
            Err(failed) => failed,
        };
        tracing::warn!(%frame, why, "a frame does not show where it looks");
        if let Some(next_s) = exposure_s(deed, shot_s, changes) {
            // Another exposure time is no try at the target.
            (shot_s, changes, way.frames_left) = (next_s, changes + 1, way.frames_left + 1);
        }
        match deed {
            Deed::Nothing => return Err(unproven(stage, why, false)),
            Deed::Wait if way.frames_left > 0 => {
                stage.step(format!("waiting for the clouds to pass: {why}"));
                stage.clock().sleep_sky(seconds(config.clouds_wait_s)).await;
            }
            Deed::Longer | Deed::Shorter | Deed::Wait | Deed::Again => {}
        }
        last = why;
    }
    Err(unproven(stage, last, true))
}

/// Waits after a correction by the exposure time, where the mount's block asks for that.
pub async fn calm(stage: &Stage, mount: &Mount, exposure_s: f64) {
    let wait_s = mount.config.settle_factor * exposure_s;
    if wait_s > 0.0 {
        stage.step(format!("waiting {wait_s:.1} s for the mount to come to rest"));
        stage.clock().sleep_sky(seconds(wait_s)).await;
    }
}

fn unproven(stage: &Stage, why: String, may_pass: bool) -> Trouble {
    let config = &stage.room.node.config.pointing;
    let again = may_pass && config.on_failure == config::OnFailure::Postpone;
    Trouble::Unproven { why: format!("where {} looks is not proven: {why}", stage.row.camera), again }
}
