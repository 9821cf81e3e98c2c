//! `flats`: flat fields of the twilight sky, or of a panel.

use schedule::action::Flats;
use schedule::action::flats::FlatsSource;

use super::{Execute, Techniques, read_out};
use crate::action_error::ActionError;
use crate::exposing::Series;
use crate::flats::run::{FlatsRequest, FlatsRun};
use crate::flats::{panel, sky as twilight};
use crate::row_context::RowContext;

impl Execute for Flats {
    async fn run(&self, context: &RowContext, techniques: &Techniques) -> Result<String, ActionError> {
        let series = Series {
            bin: self.readout.bin,
            subframe: read_out(&self.readout, context.chain()?.camera).await?,
            folder: self.dir.clone(),
            metadata: self.metadata.texts(),
            ..Series::default()
        };
        let request = FlatsRequest { filters: self.wanted(), order: self.order, moves: self.moves(), series };
        let mut run = FlatsRun::begin(context, request).await?;
        match self.source {
            _ if run.is_done() => {}
            FlatsSource::Sky => twilight::run(&mut run, &techniques.opener).await?,
            FlatsSource::Panel => panel::run(&mut run, self.brightness).await?,
        }
        Ok(run.summary())
    }
}
