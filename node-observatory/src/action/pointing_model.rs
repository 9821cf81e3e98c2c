//! `pointing_model`: learns over the whole sky how the telescope misses where it is sent.

use schedule::action::PointingModel;
use schedule::pointing_grid;
use schedule::shot::{Shot, fits};
use sky::Icrs;

use super::expose::{Series, expose};
use super::{Execute, Stage, read_out};
use crate::frames::dark;
use crate::opening;
use crate::pointing::{calm, forget, learn, look, seen, send, sensor_looks_at};
use crate::rig::telescope::Mount;
use crate::slit::Aimed;
use crate::trouble::Trouble;

impl Execute for PointingModel {
    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        let chain = stage.chain()?;
        let mount = chain.mount.ok_or_else(|| Trouble::Impossible(format!("{} has no mount", stage.row.camera)))?;
        chain.camera.start_cooling().await?;
        stage.step("opening");
        let open = opening::open(&stage.room, &chain);
        tokio::try_join!(open, stage.filter_and_focus(self.filter.as_deref(), self.defocus.wanted()))?;
        stage.step("cooling");
        stage.cool().await?;
        let series = series(self, stage).await?;
        let dark = match self.dark_subtraction {
            true => Some(dark::take(stage, &series, self.exptime).await?),
            false => None,
        };
        let no_dark = dark.as_ref().and_then(|dark| dark.as_ref().err());
        if let Some(why) = no_dark {
            tracing::warn!(why, "there is no dark: frames are measured as they are");
        }
        let (mut solved, mut looked_at) = (0, 0);
        loop {
            let place = stage.room.journal.progress(&stage.row.id).taken;
            let now = stage.clock().utc();
            if place >= self.n || !fits(now, self.exptime, stage.row.end) {
                break;
            }
            let Some(target) = pointing_grid::target(place, self.n, &mount.horizon_limits, &stage.observer(now)?)
            else {
                break;
            };
            // The slit goes there while the mount slews.
            let _aimed = Aimed::at(&stage.room, mount, target);
            solved += u32::from(look_at(self, stage, mount, &series, target).await?);
            looked_at += 1;
        }
        mount.track(false).await?;
        if looked_at > 0 && solved == 0 {
            let why = format!("none of {looked_at} frames shows where {} looks", stage.row.camera);
            return Err(Trouble::Unproven { why, again: false });
        }
        let no_dark = no_dark.map(|why| format!("; without a dark: {why}")).unwrap_or_default();
        Ok(told(self, stage, solved, looked_at) + no_dark.as_str())
    }
}

async fn series(model: &PointingModel, stage: &Stage) -> Result<Series, Trouble> {
    Ok(Series {
        action: None,
        focus: None,
        object: Some(model.object.clone()),
        filter: model.filter.clone(),
        bin: model.readout.bin,
        subframe: read_out(&model.readout, stage.chain()?.camera).await?,
        folder: model.dir.clone(),
        open_sky: true,
        ..Series::default()
    })
}

/// One place: slews there, takes a frame, and learns where the telescope looks. Returns false if the frame does not
/// show that.
async fn look_at(
    model: &PointingModel,
    stage: &Stage,
    mount: &Mount,
    series: &Series,
    target: Icrs,
) -> Result<bool, Trouble> {
    let before = stage.room.journal.progress(&stage.row.id).taken;
    let shot = |taken: u32, now| {
        let words = format!("place {} of {}, {} s", before + 1, model.n, model.exptime);
        let shot = Shot { exposure_s: model.exptime, image_type: "Light Frame", words };
        (taken == before && fits(now, model.exptime, stage.row.end)).then_some(shot)
    };
    let commanded = send(stage, mount, &target).await?;
    calm(stage, mount, model.exptime).await;
    let series = Series { target_deg: Some((target.ra.degrees(), target.dec.degrees())), ..series.clone() };
    if expose(stage, &series, shot).await? == before {
        return Ok(false);
    }
    let Some(frame) = stage.last_frame() else { return Ok(false) };
    let looked = look(stage, &frame).await;
    let solution = match seen(looked.as_deref()) {
        Ok(solution) => solution,
        Err((why, _)) => {
            tracing::warn!(%frame, why, "a place of the pointing model does not tell where it looks");
            return Ok(false);
        }
    };
    match &looked {
        Some(looked) if model.sync => {
            let seen = sensor_looks_at(stage, &looked.frame, solution);
            mount.sync(&seen, &stage.observer(stage.clock().utc())?).await?;
            forget(stage, mount);
        }
        Some(looked) => learn(stage, &commanded, &looked.frame, solution),
        None => {}
    }
    Ok(true)
}

/// What became of it, in words.
fn told(model: &PointingModel, stage: &Stage, solved: u32, looked_at: u32) -> String {
    let places = format!("{solved} of {looked_at} places show where the telescope looks");
    if model.sync {
        return format!("{places}; the mount was told each time");
    }
    let book = stage.room.pointing_book.get();
    let models = book.models.iter().filter(|model| model.camera == stage.row.camera.as_str());
    let models = models.map(|model| {
        let side = model.pier_side.map(|side| format!("{side:?} of the pier: ").to_lowercase()).unwrap_or_default();
        let rms = model.rms_arcmin.map(|rms| format!(", rms {rms:.2} arcmin")).unwrap_or_default();
        let used = if model.used { "" } else { ", not used yet" };
        format!("{side}{} points{rms}{used}", model.points.len())
    });
    [vec![places], models.collect()].concat().join("; ")
}
