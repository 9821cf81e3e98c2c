//! `pointing_model`: learns over the whole sky how the telescope misses where it is sent.

use schedule::action::PointingModel;
use schedule::plan::TimedPart;
use schedule::pointing_grid;
use schedule::shot::{Shot, fits};
use sky::Icrs;

use super::{Execute, Techniques, dark, read_out};
use crate::action_error::ActionError;
use crate::devices::telescope::Mount;
use crate::exposing::{Series, expose};
use crate::opening;
use crate::pointing::{PointingData, calm, forget, learn, look, seen, send, sensor_looks_at};
use crate::row_context::RowContext;
use crate::slit::Aimed;

impl Execute for PointingModel {
    async fn run(&self, context: &RowContext, techniques: &Techniques) -> Result<String, ActionError> {
        let chain = context.chain()?;
        let mount =
            chain.mount.ok_or_else(|| ActionError::Impossible(format!("{} has no mount", context.row.camera)))?;
        chain.camera.start_cooling().await?;
        context.step("opening", TimedPart::Open);
        let open = opening::open(&techniques.opener, &chain);
        tokio::try_join!(open, context.filter_and_focus(self.filter.as_deref(), self.defocus.wanted()))?;
        context.step("cooling", TimedPart::Cool);
        context.cool().await?;
        let series = series(self, context).await?;
        let dark = match self.dark_subtraction {
            true => Some(dark::take(context, &series, self.exptime).await?),
            false => None,
        };
        let no_dark = dark.as_ref().and_then(|dark| dark.as_ref().err());
        if let Some(why) = no_dark {
            tracing::warn!(why, "there is no dark: frames are measured as they are");
        }
        let (mut solved, mut looked_at) = (0, 0);
        loop {
            let place = context.tools.journal.progress(&context.row.id).taken;
            let now = context.clock().utc();
            if place >= self.n || !fits(now, self.exptime, context.row.end) {
                break;
            }
            let Some(target) = pointing_grid::target(place, self.n, &mount.horizon_limits, &context.observer(now)?)
            else {
                break;
            };
            // The slit goes there while the mount slews.
            let _aimed = Aimed::at(&context.tools.slits, mount, target);
            solved += u32::from(look_at(self, context, &techniques.pointing, mount, &series, target).await?);
            looked_at += 1;
        }
        context.leave_mount();
        if looked_at > 0 && solved == 0 {
            let why = format!("none of {looked_at} frames shows where {} looks", context.row.camera);
            return Err(ActionError::Unproven { why, again: false });
        }
        let no_dark = no_dark.map(|why| format!("; without a dark: {why}")).unwrap_or_default();
        Ok(summary(self, context, &techniques.pointing, solved, looked_at) + no_dark.as_str())
    }
}

async fn series(model: &PointingModel, context: &RowContext) -> Result<Series, ActionError> {
    Ok(Series {
        action: None,
        focus: None,
        object: Some(model.object.clone()),
        filter: model.filter.clone(),
        bin: model.readout.bin,
        subframe: read_out(&model.readout, context.chain()?.camera).await?,
        folder: model.dir.clone(),
        open_sky: true,
        ..Series::default()
    })
}

/// One place: slews there, takes a frame, and learns where the telescope looks. Returns false if the frame does not
/// show that.
async fn look_at(
    model: &PointingModel,
    context: &RowContext,
    pointing: &PointingData,
    mount: &Mount,
    series: &Series,
    target: Icrs,
) -> Result<bool, ActionError> {
    let before = context.tools.journal.progress(&context.row.id).taken;
    let shot = |taken: u32, now| {
        let words = format!("place {} of {}, {} s", before + 1, model.n, model.exptime);
        let shot = Shot { exposure_s: model.exptime, image_type: "Light Frame", words };
        (taken == before && fits(now, model.exptime, context.row.end)).then_some(shot)
    };
    let commanded = send(context, pointing, mount, &target).await?;
    calm(context, mount, model.exptime).await;
    let series = Series { target_deg: Some((target.ra.degrees(), target.dec.degrees())), ..series.clone() };
    if expose(context, &series, shot).await? == before {
        return Ok(false);
    }
    let Some(frame) = context.last_frame() else { return Ok(false) };
    let looked = look(context, &frame).await;
    let solution = match seen(looked.as_deref()) {
        Ok(solution) => solution,
        Err((why, _)) => {
            tracing::warn!(%frame, why, "a frame of the pointing model does not show where it looks");
            return Ok(false);
        }
    };
    match &looked {
        Some(looked) if model.sync => {
            let seen = sensor_looks_at(context, &looked.frame, solution);
            mount.sync(&seen, &context.observer(context.clock().utc())?).await?;
            forget(context, pointing, mount);
        }
        Some(looked) => learn(context, pointing, &commanded, &looked.frame, solution),
        None => {}
    }
    Ok(true)
}

/// What became of it, in words.
fn summary(
    model: &PointingModel,
    context: &RowContext,
    pointing: &PointingData,
    solved: u32,
    looked_at: u32,
) -> String {
    let places = format!("{solved} of {looked_at} places show where the telescope looks");
    if model.sync {
        return format!("{places}; the mount was synchronised each time");
    }
    let learned = pointing.models.get();
    let models = learned.models.iter().filter(|model| model.camera == context.row.camera.as_str());
    let models = models.map(|model| {
        let side = model.pier_side.map(|side| format!("{side:?} of the pier: ").to_lowercase()).unwrap_or_default();
        let rms = model.rms_arcmin.map(|rms| format!(", rms {rms:.2} arcmin")).unwrap_or_default();
        let used = if model.used { "" } else { ", not used yet" };
        format!("{side}{} points{rms}{used}", model.points.len())
    });
    [vec![places], models.collect()].concat().join("; ")
}
