//! `autofocus`: finds the focus with a run of frames near the zenith, and keeps it.

use imaging::focus::sweep::Plan;
use schedule::action::Autofocus;
use schedule::action::autofocus::search::Search;
use schedule::action::parameters::FocusWanted;
use schedule::plan::TimedPart;
use schedule::wrong::Wrong;

use super::{Execute, Techniques, read_out};
use crate::action_error::ActionError;
use crate::devices::focuser::Focuser;
use crate::exposing::Series;
use crate::focus::run::{FocusRequest, find};
use crate::focus::{field, half_range, offset, publish_run};
use crate::opening;
use crate::pointing;
use crate::row_context::RowContext;
use crate::slit::Aimed;

impl Execute for Autofocus {
    async fn run(&self, context: &RowContext, techniques: &Techniques) -> Result<String, ActionError> {
        let chain = context.chain()?;
        let impossible = |why: String| ActionError::Impossible(why);
        let nonsense = |wrong: Wrong| ActionError::Impossible(wrong.to_string());
        let camera = &context.row.camera;
        let focuser = chain.focuser.ok_or_else(|| impossible(format!("{camera} has no focuser")))?;
        let can = focuser.instrument.capabilities().await?;
        if !can.absolute {
            return Err(impossible(format!("{} does not know its position", focuser.name())));
        }
        chain.camera.start_cooling().await?;
        let chosen = match chain.mount {
            Some(_) => Some(field::for_run(&self.field, context).await?),
            None => None,
        };
        let place = chosen.as_ref().map(|chosen| chosen.place);
        let pointed = place.zip(chain.mount);
        let _aimed = pointed.map(|(place, mount)| Aimed::at(&context.tools.slits, mount, place));
        let point = async {
            context.step("opening", TimedPart::Open);
            opening::open(&techniques.opener, &chain).await?;
            if let (Some((place, mount)), Some(chosen)) = (pointed, &chosen) {
                context.visible(&place)?;
                context.step(format!("slewing to {}", chosen.words), TimedPart::Slew);
                pointing::send(context, &techniques.pointing, mount, &place).await?;
            }
            Ok(())
        };
        tokio::try_join!(point, context.filter_and_focus(self.filter.as_deref(), FocusWanted::default()))?;
        context.step("cooling", TimedPart::Cool);
        context.cool().await?;

        let series = Series {
            target_deg: place.map(|place| (place.ra.degrees(), place.dec.degrees())),
            filter: self.filter.clone(),
            bin: self.readout.bin,
            subframe: read_out(&self.readout, chain.camera).await?,
            folder: self.save_path.clone(),
            open_sky: true,
            ..Series::default()
        };
        let unknown = || ActionError::Failed {
            device: focuser.instrument.device.to_string(),
            verb: "focus".to_owned(),
            reason: "its position is not known".to_owned(),
        };
        let start = focuser.position().ok_or_else(unknown)?;
        let travel = Focuser::travel(&can, start);
        let usual = half_range(&techniques.focus, focuser, travel);
        let request = FocusRequest {
            plan: plan(&self.search, focuser, start, usual, travel).map_err(nonsense)?,
            meter: self.search.meter(self.reduce_exposure_time).map_err(nonsense)?,
            exposure_s: self.exptime,
            frames: self.search.frames(),
            reduce_exposure: self.reduce_exposure_time,
            expected_px: self.fwhm,
            filter: offset(context, &series, focuser),
            keep: self.save,
            counts: true,
        };
        let run = find(context, &techniques.focus, &series, focuser, &request).await?;
        publish_run(context, &run);
        context.leave_mount();
        let detail = techniques.focus.state.borrow().detail.clone();
        let where_to = chosen.map(|chosen| format!("; field: {}", chosen.words)).unwrap_or_default();
        match run.reason {
            None => Ok(format!("{detail}{where_to}")),
            Some(_) => Err(ActionError::Impossible(format!("{detail}{where_to}"))),
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
