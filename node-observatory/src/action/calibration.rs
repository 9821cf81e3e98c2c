//! `calibration`: bias and dark frames, whatever the sky does.

use schedule::action::Calibration;
use schedule::action::parameters::FocusWanted;
use schedule::plan::TimedPart;

use super::{Execute, Techniques, read_out};
use crate::action_error::ActionError;
use crate::exposing::{Series, expose};
use crate::row_context::RowContext;

impl Execute for Calibration {
    async fn run(&self, context: &RowContext, _: &Techniques) -> Result<String, ActionError> {
        context.step("cooling, filter and focus", TimedPart::Cool);
        let ready = context.filter_and_focus(self.filter.as_deref(), FocusWanted::default());
        tokio::try_join!(context.cool(), ready)?;
        let series = Series {
            filter: self.filter.clone(),
            bin: self.readout.bin,
            subframe: read_out(&self.readout, context.chain()?.camera).await?,
            folder: self.dir.clone(),
            metadata: self.metadata.texts(),
            ..Series::default()
        };
        let end = context.row.end;
        let taken =
            expose(context, &series, |taken, now| self.shot_within(taken, context.tools.authority.surely(now), end))
                .await?;
        Ok(self.summary(taken))
    }
}
