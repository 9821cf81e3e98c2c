//! `calibration`: bias and dark frames, whatever the sky does.

use schedule::action::Calibration;
use schedule::action::parameters::FocusWanted;

use super::expose::{Series, expose};
use super::{Execute, Stage, read_out};
use crate::trouble::Trouble;

impl Execute for Calibration {
    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        stage.step("cooling, filter and focus");
        let ready = stage.filter_and_focus(self.filter.as_deref(), FocusWanted::default());
        tokio::try_join!(stage.cool(), ready)?;
        let series = Series {
            filter: self.filter.clone(),
            bin: self.readout.bin,
            subframe: read_out(&self.readout, stage.chain()?.camera).await?,
            folder: self.dir.clone(),
            metadata: self.metadata.texts(),
            ..Series::default()
        };
        let end = stage.row.end;
        let taken = expose(stage, &series, |taken, now| self.shot_within(taken, now, end)).await?;
        Ok(self.told(taken))
    }
}
