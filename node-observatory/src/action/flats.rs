//! `flats`: flat fields of the twilight sky, or of a panel.

use schedule::action::Flats;
use schedule::action::flats::Source;

use super::expose::Series;
use super::{Execute, Stage, read_out};
use crate::flats::run::{Run, Wish};
use crate::flats::{panel, sky as twilight};
use crate::trouble::Trouble;

impl Execute for Flats {
    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        let series = Series {
            bin: self.readout.bin,
            subframe: read_out(&self.readout, stage.chain()?.camera).await?,
            folder: self.dir.clone(),
            metadata: self.metadata.texts(),
            ..Series::default()
        };
        let wish = Wish { filters: self.wanted(), order: self.order, moves: self.moves(), series };
        let mut run = Run::begin(stage, wish).await?;
        match self.source {
            _ if run.is_done() => {}
            Source::Sky => twilight::run(&mut run).await?,
            Source::Panel => panel::run(&mut run, self.brightness).await?,
        }
        Ok(run.told())
    }
}
