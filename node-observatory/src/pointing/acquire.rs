//! Brings a telescope onto its target, frame by frame, until a solved frame proves that it is there.

use contract::observatory::AlertKind;
use imaging::pointing::{CorrectionLoop, PointingStep};
use schedule::plan::overheads::TimedPart;
use schedule::shot::Shot;
use sky::Icrs;
use units::{Angle, seconds};

use super::failure::{Remedy, exposure_s, first_exposure_s};
use super::fix::{learn, look, seen};
use super::gate::round;
use super::{PointingData, icrs, pair};
use crate::action_error::ActionError;
use crate::devices::telescope::Mount;
use crate::expected::Lasts;
use crate::exposing::{Series, aside};
use crate::row_context::RowContext;

/// ASTRATYP of the frames that show where the telescope looks.
pub const ACTION: &str = "pointing";
/// Their type: they show the target's field, perhaps from beside it, and are no data of the target.
const ACQUISITION: &str = "Acquisition Frame";

/// A row's way to its target.
#[derive(Debug, Clone, Copy)]
pub struct Acquisition {
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

impl Acquisition {
    /// A way that has begun with a slew to `commanded`.
    pub fn begun(context: &RowContext, target: Icrs, commanded: Icrs, exptime_s: f64) -> Self {
        let frames_left = context.tools.authority.node.config.pointing.attempts;
        Self { target, commanded, exptime_s, frames_left, is_fresh: true }
    }

    /// Slews to where it was sent last: a person who moved the mount meanwhile moved it away from there, and a
    /// correction of that by the frames alone would overshoot.
    pub async fn again(&mut self, context: &RowContext, mount: &Mount) -> Result<(), ActionError> {
        mount.point(&self.commanded, &context.visible(&self.commanded)?).await?;
        self.is_fresh = true;
        Ok(())
    }

    /// A frame of the row has shown the telescope on its target: what comes now is another loss, with tries of its own.
    pub fn renew(&mut self, context: &RowContext) {
        self.frames_left = context.tools.authority.node.config.pointing.attempts;
    }
}

/// Takes frames and corrects until one shows the telescope on its target; returns how that went, in words.
///
/// # Errors
/// [`ActionError::Unproven`] when the frames do not show where they look, or the mount does not go where it is sent.
pub async fn acquire(
    context: &RowContext,
    pointing: &PointingData,
    mount: &Mount,
    series: &Series,
    way: &mut Acquisition,
) -> Result<String, ActionError> {
    pointing.state.send_modify(|state| state.active = true);
    let _visible = AcquisitionInState { pointing };
    let began = context.clock().utc();
    let result = frames(context, pointing, mount, series, way).await;
    let camera = context.row.camera.as_str();
    match &result {
        Ok(report) => {
            context.tools.authority.node.alerts.clear(AlertKind::PointingUnproven, camera);
            context.took(TimedPart::Acquire, began);
            tracing::info!(camera, report, "on target");
            pointing.state.send_modify(|state| state.detail = with_object(series, report));
        }
        Err(error @ ActionError::Unproven { why, .. }) => {
            context.tools.authority.node.alerts.raise(AlertKind::PointingUnproven, camera, &error.to_string());
            pointing.state.send_modify(|state| state.detail = with_object(series, why));
        }
        Err(error) => pointing.state.send_modify(|state| state.detail = with_object(series, &error.to_string())),
    }
    result
}

/// Shows that nothing is acquired any more, also when the action is dropped.
struct AcquisitionInState<'a> {
    pointing: &'a PointingData,
}

impl Drop for AcquisitionInState<'_> {
    fn drop(&mut self) {
        self.pointing.state.send_modify(|state| state.active = false);
    }
}

fn with_object(series: &Series, report: &str) -> String {
    series.object.as_ref().map_or_else(|| report.to_owned(), |object| format!("{object}: {report}"))
}

async fn frames(
    context: &RowContext,
    pointing: &PointingData,
    mount: &Mount,
    series: &Series,
    way: &mut Acquisition,
) -> Result<String, ActionError> {
    let config = &context.tools.authority.node.config.pointing;
    let threshold = Angle::from_degrees(config.threshold_arcmin / 60.0);
    let mut approach = CorrectionLoop::new(pair(&way.target), pair(&way.commanded), threshold);
    let mut shot_s = first_exposure_s(config.exposure_s, way.exptime_s);
    let (mut changes, mut slews) = (0, 0);
    let mut last = "no frame may be taken any more".to_owned();
    while way.frames_left > 0 {
        way.frames_left -= 1;
        let words = format!("finding out where it looks, {shot_s} s");
        let shot = Shot { exposure_s: shot_s, image_type: ACQUISITION, words };
        let frame = aside(context, series, &shot, ACTION).await?;
        let looked = look(context, &frame).await;
        let (why, remedy) = match seen(looked.as_deref()) {
            Ok(solution) => {
                if let Some(looked) = looked.as_ref().filter(|_| std::mem::take(&mut way.is_fresh)) {
                    learn(context, pointing, &way.commanded, &looked.frame, solution);
                }
                let step = approach.look((solution.ra, solution.dec));
                let off_arcmin = approach.distances().last().map_or(0.0, |off| off.degrees() * 60.0);
                pointing.state.send_modify(|state| state.off_target_arcmin = Some(round(off_arcmin)));
                match step {
                    PointingStep::OnTarget => {
                        let plural = if slews == 1 { "" } else { "s" };
                        return Ok(format!("on target within {off_arcmin:.2} arcmin after {slews} correction{plural}"));
                    }
                    PointingStep::Hopeless => {
                        let why = format!(
                            "it looks {off_arcmin:.2} arcmin off the target, and two corrections did not help: the \
                             mount does not go where it is sent"
                        );
                        return Err(unproven(context, why, true));
                    }
                    PointingStep::Slew(to) => {
                        last = format!("it looks {off_arcmin:.2} arcmin off the target");
                        if way.frames_left > 0 {
                            context.step(format!("correcting by {off_arcmin:.2} arcmin"), TimedPart::Slew);
                            let to = icrs(to);
                            mount.point(&to, &context.visible(&to)?).await?;
                            calm(context, mount, way.exptime_s).await;
                            (way.commanded, way.is_fresh, slews) = (to, true, slews + 1);
                        }
                        continue;
                    }
                }
            }
            Err(failed) => failed,
        };
        tracing::warn!(%frame, why, "a frame does not show where it looks");
        if let Some(next_s) = exposure_s(remedy, shot_s, changes) {
            // Another exposure time is no try at the target.
            (shot_s, changes, way.frames_left) = (next_s, changes + 1, way.frames_left + 1);
        }
        match remedy {
            Remedy::Nothing => return Err(unproven(context, why, false)),
            Remedy::Wait if way.frames_left > 0 => {
                context.step(format!("waiting for the clouds to pass: {why}"), Lasts::Seconds(config.clouds_wait_s));
                context.clock().sleep_sky(seconds(config.clouds_wait_s)).await;
            }
            Remedy::Longer | Remedy::Shorter | Remedy::Wait | Remedy::Again => {}
        }
        last = why;
    }
    Err(unproven(context, last, true))
}

/// Waits after a correction by the exposure time, where the mount's block asks for that.
pub async fn calm(context: &RowContext, mount: &Mount, exposure_s: f64) {
    let wait_s = mount.config.settle_factor * exposure_s;
    if wait_s > 0.0 {
        context.step(format!("waiting {wait_s:.1} s for the mount to come to rest"), Lasts::Seconds(wait_s));
        context.clock().sleep_sky(seconds(wait_s)).await;
    }
}

fn unproven(context: &RowContext, why: String, may_pass: bool) -> ActionError {
    let config = &context.tools.authority.node.config.pointing;
    let again = may_pass && config.on_failure == config::OnFailure::Postpone;
    ActionError::Unproven { why: format!("where {} looks is not proven: {why}", context.row.camera), again }
}
