//! One frame after another, with nothing between them: the next is sent as soon as the state says the last is done.

use std::collections::BTreeMap;
use std::io;

use contract::device::camera::{Command, Purpose, Subframe};
use contract::device::dome::Shutter;
use units::Utc;

use super::stage::Stage;
use crate::journal::Intent;
use crate::slit;
use crate::trouble::Trouble;

/// One frame to take.
#[derive(Debug, Clone, PartialEq)]
pub struct Shot {
    /// Seconds.
    pub exposure_s: f64,
    /// IMAGETYP.
    pub image_type: &'static str,
    /// What is done, in words: `exposing 3 of 10, 30 s, V`.
    pub words: String,
}

/// What all frames of a row have in common.
#[derive(Debug, Clone, Default)]
pub struct Series {
    /// OBJECT.
    pub object: Option<String>,
    /// Target, ICRS degrees.
    pub target_deg: Option<(f64, f64)>,
    /// Filter of the row; where absent, the one that is in the beam.
    pub filter: Option<String>,
    /// Binning factor.
    pub bin: u32,
    /// Part of the sensor.
    pub subframe: Option<Subframe>,
    /// Folder for the files.
    pub folder: Option<String>,
    /// The roof must be open and its slit clear: a dome that was shut by its guard is noticed, and opened again by the
    /// retry; one that turns is waited for.
    pub open_sky: bool,
    /// For the header.
    pub metadata: BTreeMap<String, String>,
}

/// May an exposure start now? Only if it ends within the row's window.
pub fn fits(now: Utc, exposure_s: f64, end: Utc) -> bool {
    now.plus_seconds(exposure_s) <= end
}

/// Takes frames until `next` has none left; it is told how many the row has, those of before a restart included.
/// Returns that number.
pub async fn expose(
    stage: &Stage,
    series: &Series,
    mut next: impl FnMut(u32, Utc) -> Option<Shot> + Send,
) -> Result<u32, Trouble> {
    adopt(stage).await?;
    let mut taken = stage.room.journal.progress(&stage.row.id).taken;
    let Some(mut shot) = next(taken, stage.clock().utc()) else { return Ok(taken) };
    let mut intent = intend(stage).await?;
    let camera = stage.chain()?.camera;
    loop {
        if series.open_sky {
            slit::wait_until_clear(stage, shot.exposure_s).await?;
            roof_is_open(stage)?;
            sky_is_followed(stage)?;
        }
        stage.small_step(shot.words.clone());
        stage.set_exposing(Some(intent.frame.clone()));
        stage.room.journal.sent(&stage.row.id);
        camera.instrument.ask_in_turn(&intent.frame, command(stage, series, &shot, intent.sequence)).await?;
        // the next id goes to disk while this frame collects light
        let prepared = intend(stage).await;
        camera.exposed(&intent.frame, shot.exposure_s).await?;
        stage.set_exposing(None);
        taken += 1;
        note_taken(stage, &intent);
        let night = stage.night().to_string();
        stage.room.ledger.expect(&intent.frame, &night, &stage.row.camera, stage.clock().machine());
        stage.room.board.row(stage.index, |row| row.frames = taken);
        match next(taken, stage.clock().utc()) {
            Some(following) => shot = following,
            None => return Ok(taken),
        }
        intent = prepared?;
    }
}

fn command(stage: &Stage, series: &Series, shot: &Shot, sequence: u32) -> Command {
    let in_beam = || stage.chain().ok()?.wheel?.filter();
    let purpose = Purpose {
        action: stage.row.action.name().to_owned(),
        object: series.object.clone(),
        image_type: shot.image_type.to_owned(),
        filter: series.filter.clone().or_else(in_beam),
        ra_deg: series.target_deg.map(|(ra, _)| ra),
        dec_deg: series.target_deg.map(|(_, dec)| dec),
        night: stage.night().to_string(),
        sequence,
        row: Some(stage.index),
        folder: series.folder.clone(),
        paired: stage.paired(),
        metadata: series.metadata.clone(),
    };
    Command::Expose {
        exposure_s: shot.exposure_s,
        light: shot.image_type == "Light Frame",
        bin: series.bin,
        subframe: series.subframe,
        purpose: Box::new(purpose),
    }
}

/// A dome that says anything but "open" hides the sky; one that says nothing right now may still be open.
fn roof_is_open(stage: &Stage) -> Result<(), Trouble> {
    for dome in &stage.room.rig.domes {
        if let Some(shutter) = dome.shutter().filter(|shutter| *shutter != Shutter::Open) {
            let (device, reason) = (dome.instrument.device.to_string(), format!("the shutter is {shutter:?}"));
            return Err(Trouble::Failed { device, verb: "stay open".to_owned(), reason });
        }
    }
    Ok(())
}

/// A mount that says that it does not track smears the sky: its device node may have stopped it.
fn sky_is_followed(stage: &Stage) -> Result<(), Trouble> {
    let Some(mount) = stage.chain()?.mount else { return Ok(()) };
    let stands = mount.instrument.fresh().is_some_and(|state| state.fields.tracking.known() == Some(&false));
    if !stands {
        return Ok(());
    }
    let (device, reason) = (mount.instrument.device.to_string(), "tracking was switched off".to_owned());
    Err(Trouble::Failed { device, verb: "follow the sky".to_owned(), reason })
}

/// A frame of this row that was under way when this node was restarted is waited for, not taken twice.
async fn adopt(stage: &Stage) -> Result<(), Trouble> {
    let open = stage.room.journal.progress(&stage.row.id).open;
    let camera = stage.chain()?.camera;
    let Some(exposure) = camera.instrument.fresh().and_then(|state| state.fields.exposure) else { return Ok(()) };
    if !open.contains(&exposure.id) {
        return Ok(());
    }
    stage.step("finishing the frame that was under way");
    camera.exposed(&exposure.id, exposure.exposure_s).await?;
    let (room, frame) = (stage.room.clone(), exposure.id);
    let noted = tokio::task::spawn_blocking(move || room.journal.taken(&frame, room.node.bus.clock().utc()));
    noted.await.map_err(io::Error::other)??;
    Ok(())
}

async fn intend(stage: &Stage) -> Result<Intent, Trouble> {
    let (room, row) = (stage.room.clone(), stage.row.id.clone());
    let intent = tokio::task::spawn_blocking(move || room.journal.intend(&row, room.node.bus.clock().utc()));
    Ok(intent.await.map_err(io::Error::other)??)
}

/// Writes, beside the next exposure, that a frame was taken.
fn note_taken(stage: &Stage, intent: &Intent) {
    let (room, frame) = (stage.room.clone(), intent.frame.clone());
    tokio::task::spawn_blocking(move || {
        if let Err(error) = room.journal.taken(&frame, room.node.bus.clock().utc()) {
            tracing::warn!(%error, "a taken frame is not in the journal; a restart may take it again");
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exposure_starts_only_if_it_ends_within_the_window() {
        let at = |text: &str| -> Utc { text.parse().unwrap() };
        let end = at("2026-11-21T04:00:00Z");
        assert!(fits(at("2026-11-21T03:59:00Z"), 60.0, end));
        assert!(!fits(at("2026-11-21T03:59:00.001Z"), 60.0, end));
    }
}
