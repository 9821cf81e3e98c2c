//! `autofocus`: finds the focus with a run of frames near the zenith, and keeps it.

use imaging::focus::sweep::Plan;
use schedule::action::Autofocus;
use schedule::action::autofocus::search::Search;
use schedule::action::parameters::FocusWanted;
use schedule::wrong::Wrong;

use super::expose::Series;
use super::{Execute, Stage, read_out};
use crate::focus::run::{Wish, find};
use crate::focus::{field, half_range, offset, tell};
use crate::opening;
use crate::pointing;
use crate::rig::focuser::Focuser;
use crate::slit::Aimed;
use crate::trouble::Trouble;

impl Execute for Autofocus {
    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        let chain = stage.chain()?;
        let impossible = |why: String| Trouble::Impossible(why);
        let nonsense = |wrong: Wrong| Trouble::Impossible(wrong.to_string());
        let camera = &stage.row.camera;
        let focuser = chain.focuser.ok_or_else(|| impossible(format!("{camera} has no focuser")))?;
        let can = focuser.instrument.capabilities().await?;
        if !can.absolute {
            return Err(impossible(format!("{} does not know its position", focuser.name())));
        }
        chain.camera.start_cooling().await?;
        let chosen = match chain.mount {
            Some(_) => Some(field::for_run(&self.field, stage).await?),
            None => None,
        };
        let place = chosen.as_ref().map(|chosen| chosen.place);
        let pointed = place.zip(chain.mount);
        let _aimed = pointed.map(|(place, mount)| Aimed::at(&stage.room, mount, place));
        let point = async {
            stage.step("opening");
            opening::open(&stage.room, &chain).await?;
            if let (Some((place, mount)), Some(chosen)) = (pointed, &chosen) {
                stage.visible(&place)?;
                stage.step(format!("slewing to {}", chosen.words));
                pointing::send(stage, mount, &place).await?;
            }
            Ok(())
        };
        tokio::try_join!(point, stage.filter_and_focus(self.filter.as_deref(), FocusWanted::default()))?;
        stage.step("cooling");
        stage.cool().await?;

        let series = Series {
            target_deg: place.map(|place| (place.ra.degrees(), place.dec.degrees())),
            filter: self.filter.clone(),
            bin: self.readout.bin,
            subframe: read_out(&self.readout, chain.camera).await?,
            folder: self.save_path.clone(),
            open_sky: true,
            ..Series::default()
        };
        let unknown = || Trouble::Failed {
            device: focuser.instrument.device.to_string(),
            verb: "focus".to_owned(),
            reason: "its position is not known".to_owned(),
        };
        let start = focuser.position().ok_or_else(unknown)?;
        let usual = half_range(stage, focuser, can.max_step);
        let wish = Wish {
            plan: plan(&self.search, focuser, start, usual, can.max_step).map_err(nonsense)?,
            meter: self.search.meter(self.reduce_exposure_time).map_err(nonsense)?,
            exposure_s: self.exptime,
            frames: self.search.frames(),
            reduce_exposure: self.reduce_exposure_time,
            expected_px: self.fwhm,
            filter: offset(stage, &series, focuser),
            keep: self.save,
            counts: true,
        };
        let run = find(stage, &series, focuser, &wish).await?;
        tell(stage, &run);
        if let Some(mount) = chain.mount {
            mount.track(false).await?;
        }
        let detail = stage.room.focus.borrow().detail.clone();
        let where_to = chosen.map(|chosen| format!("; field: {}", chosen.words)).unwrap_or_default();
        match run.reason {
            None => Ok(format!("{detail}{where_to}")),
            Some(_) => Err(Trouble::Impossible(format!("{detail}{where_to}"))),
        }
    }
}

/// The run for a focuser at `start`, its best focus; `usual` is the half width where the row names none.
fn plan(search: &Search, focuser: &Focuser, start: i64, usual: i64, max_step: i64) -> Result<Plan, Wrong> {
    let (centre, half_range) = search.range(start, usual, max_step);
    let (coarse, fine) = search.positions();
    let closer_percent = search.closer_percent();
    let curve = search.meter(false)?.curve(search.smoother()?);
    Ok(Plan { coarse, fine, closer_percent, curve, ..crate::focus::plan(focuser, start, centre, half_range, max_step) })
}
