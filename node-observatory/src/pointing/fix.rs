//! One frame that shows where the telescope looks, and what it teaches.

use std::sync::Arc;
use std::time::Duration;

use contract::device::camera::Frame;
use contract::device::telescope::PierSide;
use contract::observatory::{PointingPoint, UnsolvedClass};
use contract::{CommandId, Name};
use imaging::Solution;
use imaging::pointing::Miss;
use sky::Icrs;

use super::failure::{Remedy, remedy};
use super::{PointingData, icrs, pair};
use crate::devices::telescope::Mount;
use crate::frames::aim::{FrameAim, middle_of};
use crate::frames::looked::Looked;
use crate::row_context::RowContext;

/// A frame is fetched, measured and solved within this time, or nobody waits for it any more, machine time.
const LOOK: Duration = Duration::from_secs(60);
/// A camera that looks further off than this was not solved on its own sky; no mount errs so much.
const ASTRAY_DEG: f64 = 3.0;

/// Waits for what a frame shows.
pub async fn look(context: &RowContext, frame: &CommandId) -> Option<Arc<Looked>> {
    tokio::time::timeout(LOOK, context.tools.frames.looks.of(frame)).await.ok()
}

/// Where a frame looks, or in words why that is not known, and what may help.
pub fn seen(looked: Option<&Looked>) -> Result<&Solution, (String, Remedy)> {
    let Some(looked) = looked else {
        return Err((format!("the frame was not looked at within {} s", LOOK.as_secs()), Remedy::Again));
    };
    match &looked.solved {
        Some(Ok(solution)) => Ok(solution),
        Some(Err(why)) => Err((why.to_string(), remedy(why))),
        None => {
            let unsolved = looked.facts.unsolved.as_ref().map(|unsolved| unsolved.detail.clone());
            let reason = looked.facts.reason.clone().or(unsolved);
            let lacking = looked.facts.unsolved.as_ref().is_some_and(|unsolved| lacks(unsolved.class));
            let remedy = if lacking { Remedy::Nothing } else { Remedy::Again };
            Err((reason.unwrap_or_else(|| "the frame was not solved".to_owned()), remedy))
        }
    }
}

/// Without these no frame is solved, whatever the sky does.
fn lacks(class: UnsolvedClass) -> bool {
    matches!(class, UnsolvedClass::NoCatalogue | UnsolvedClass::NoScale | UnsolvedClass::NoPlace)
}

/// Pier side that the mount reports.
pub fn pier_side(mount: &Mount) -> Option<PierSide> {
    let side = mount.instrument.fresh()?.fields.pier_side.known().copied();
    side.filter(|side| *side != PierSide::Unknown)
}

/// Where the middle of the sensor looks, whatever part of it a row reads: a mount is synchronised on it, and its error
/// is measured there.
pub fn sensor_looks_at(context: &RowContext, frame: &Frame, solution: &Solution) -> Icrs {
    let (x_px, y_px) = aim(context, frame).middle_px(frame);
    icrs(solution.wcs.pixel_to_sky(x_px, y_px))
}

fn aim(context: &RowContext, frame: &Frame) -> FrameAim {
    let tools = &context.tools;
    FrameAim::of(&tools.authority, &tools.devices, &tools.frames.mounts, frame)
}

/// Learns from the first solved frame after a slew to `commanded`.
pub fn learn(context: &RowContext, pointing: &PointingData, commanded: &Icrs, frame: &Frame, solution: &Solution) {
    if !context.tools.authority.node.config.pointing.model {
        return;
    }
    let at_utc = middle_of(frame);
    let Ok(observer) = context.observer(at_utc) else { return };
    let seen = sensor_looks_at(context, frame, solution);
    let Some(miss) = Miss::of(pair(commanded), pair(&seen)) else { return };
    if miss.size().degrees() > ASTRAY_DEG {
        return;
    }
    let point = PointingPoint {
        at_utc,
        hour_angle_deg: observer.hour_angle(commanded).wrapped_signed().degrees(),
        dec_deg: commanded.dec.degrees(),
        east_arcmin: miss.east.degrees() * 60.0,
        north_arcmin: miss.north.degrees() * 60.0,
    };
    let side = aim(context, frame).pier_side;
    pointing.models.change(|models| {
        models.learn(&frame.camera, side, point);
        true
    });
}

/// Forgets what the cameras of a mount missed by: the mount was synchronised.
pub fn forget(context: &RowContext, pointing: &PointingData, mount: &Mount) {
    let mount_of = |camera: &str| context.tools.devices.chain(&camera.parse::<Name>().ok()?).ok()?.mount;
    let is_of = |camera: &str| mount_of(camera).is_some_and(|of| of.instrument.device == mount.instrument.device);
    pointing.models.change(|models| models.forget(is_of));
}

#[cfg(test)]
mod tests {
    use imaging::NoSolution;

    use super::*;
    use crate::frames::tests::frame;

    #[test]
    fn a_frame_that_was_not_solved_gives_the_reason() {
        assert!(seen(None).unwrap_err().0.contains("not looked at within 60 s"));
        let facts = contract::observatory::FrameFacts {
            reason: Some("not fetched: the spool answers HTTP 404".to_owned()),
            ..Default::default()
        };
        let mut looked = Looked { frame: frame("f"), facts, measured: None, solved: None };
        assert!(seen(Some(&looked)).unwrap_err().0.contains("404"));
        looked.solved = Some(Err(NoSolution::TooFewStars { stars: 1, needed: 4 }));
        assert_eq!(seen(Some(&looked)).unwrap_err().1, Remedy::Longer);
    }
}
