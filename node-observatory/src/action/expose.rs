//! One frame after another, with nothing between them: the next is sent as soon as the state shows that the last is
//! done.

use std::collections::BTreeMap;
use std::io;

use contract::CommandId;
use contract::device::camera::{Command, Purpose, Subframe};
use contract::device::dome::Shutter;
use units::Utc;

use schedule::shot::Shot;

use super::spooled::Unspooled;
use super::stage::Stage;
use crate::focus;
use crate::journal::Intent;
use crate::rig::camera::Camera;
use crate::slit::{self, Seen};
use crate::trouble::Trouble;
use schedule::action::parameters::FocusWanted;
use schedule::plan::overheads::Span;

/// What all frames of a row have in common.
#[derive(Debug, Clone, Default)]
pub struct Series {
    /// What the frames are for; where absent, the row's action.
    pub action: Option<&'static str>,
    /// What the row asks of the focus, which is looked after between frames; where absent, it is left alone.
    pub focus: Option<FocusWanted>,
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

/// Takes frames until `next` returns none. `next` gets the number of the row's frames, including those from before a
/// restart. Returns that number.
pub async fn expose(
    stage: &Stage,
    series: &Series,
    mut next: impl FnMut(u32, Utc) -> Option<Shot> + Send,
) -> Result<u32, Trouble> {
    adopt(stage, series.open_sky).await?;
    let mut taken = stage.room.journal.progress(&stage.row.id).taken;
    let mut unspooled = Unspooled::of(stage)?;
    let Some(mut shot) = next(taken, stage.clock().utc()) else { return Ok(taken) };
    let camera = stage.chain()?.camera;
    loop {
        // Not held in this future's own space: it is large, and rarely does anything.
        Box::pin(focus::between_frames(stage, series)).await?;
        // The id that was prepared, unless a focus run has taken it meanwhile: no two frames have one.
        let intent = intend(stage).await?;
        ready(stage, series, &shot, &intent.frame).await?;
        stage.room.journal.sent(&stage.row.id);
        camera.instrument.ask_in_turn(&intent.frame, own(stage, series, &shot, intent.sequence)).await?;
        // The next id goes to disk while this frame collects light.
        let prepared = intend(stage).await;
        exposed(stage, camera, &intent.frame, shot.exposure_s, series.open_sky).await?;
        taken += 1;
        unspooled.add(&intent.frame);
        stage.room.board.row(stage.index, |row| row.frames = taken);
        // Here a row that the schedule has no longer is ended: no frame is under way.
        tokio::task::yield_now().await;
        let mut following = next(taken, stage.clock().utc());
        if following.is_none() {
            // These are enough only if each of them is on disk.
            let shut = stage.clock().utc();
            let lost = unspooled.settle(stage).await?;
            stage.took(Span::Spool, shut);
            if lost > 0 {
                taken = taken.saturating_sub(lost);
                stage.room.board.row(stage.index, |row| row.frames = taken);
                following = next(taken, stage.clock().utc());
            }
        }
        match following {
            Some(following) => shot = following,
            None => return Ok(taken),
        }
        prepared?;
    }
}

/// Takes one frame in addition to the row's own frames, with the purpose `action`: the file is stored, and the frame
/// never counts. Returns its id when its exposure has ended.
pub async fn aside(stage: &Stage, series: &Series, shot: &Shot, action: &str) -> Result<CommandId, Trouble> {
    let (room, row) = (stage.room.clone(), stage.row.id.clone());
    let intent = tokio::task::spawn_blocking(move || room.journal.aside(&row, room.node.bus.clock().utc()));
    let Intent { frame, sequence } = intent.await.map_err(io::Error::other)??;
    let camera = stage.chain()?.camera;
    ready(stage, series, shot, &frame).await?;
    let command = command(stage, series, shot, action, sequence);
    camera.instrument.ask_in_turn(&frame, command).await?;
    exposed(stage, camera, &frame, shot.exposure_s, series.open_sky).await?;
    Ok(frame)
}

/// Waits until the sky can be seen, where that is wanted; the frame is under way from then on.
async fn ready(stage: &Stage, series: &Series, shot: &Shot, frame: &CommandId) -> Result<(), Trouble> {
    if series.open_sky {
        slit::wait_until_clear(stage, shot.exposure_s).await?;
        roof_is_open(stage)?;
        sky_is_followed(stage)?;
    }
    stage.small_step(shot.words.clone());
    stage.set_exposing(Some(frame.clone()));
    Ok(())
}

/// The command for a frame of the row itself.
fn own(stage: &Stage, series: &Series, shot: &Shot, sequence: u32) -> Command {
    command(stage, series, shot, series.action.unwrap_or(stage.row.action.name()), sequence)
}

/// Takes one frame whose id was made before ([`intend`]); the next one waits for what it shows. Where it does not
/// count, it is none of those that the row was asked for.
pub async fn single(stage: &Stage, series: &Series, shot: &Shot, intent: &Intent, counts: bool) -> Result<(), Trouble> {
    let camera = stage.chain()?.camera;
    ready(stage, series, shot, &intent.frame).await?;
    stage.room.journal.sent(&stage.row.id);
    if !counts {
        // Before its announcement or a restart can make it count; nothing of it was hidden.
        let (room, row, frame) = (stage.room.clone(), stage.row.id.clone(), intent.frame.clone());
        let noted = tokio::task::spawn_blocking(move || {
            room.journal.hidden(&row, &frame, 0.0, false, room.node.bus.clock().utc())
        });
        noted.await.map_err(io::Error::other)??;
    }
    let mut unspooled = Unspooled::of(stage)?;
    camera.instrument.ask_in_turn(&intent.frame, own(stage, series, shot, intent.sequence)).await?;
    exposed(stage, camera, &intent.frame, shot.exposure_s, series.open_sky).await?;
    unspooled.add(&intent.frame);
    if unspooled.settle(stage).await? > 0 {
        return Err(Trouble::Restarted { device: camera.instrument.device.to_string() });
    }
    if counts {
        stage.room.board.row(stage.index, |row| row.frames += 1);
    }
    Ok(())
}

fn command(stage: &Stage, series: &Series, shot: &Shot, action: &str, sequence: u32) -> Command {
    let in_beam = || stage.chain().ok()?.wheel?.filter();
    let purpose = Purpose {
        action: action.to_owned(),
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
        light: !matches!(shot.image_type, "Bias Frame" | "Dark Frame"),
        bin: series.bin,
        subframe: series.subframe,
        purpose: Box::new(purpose),
    }
}

/// A dome that reports anything but "open" hides the sky; one that reports nothing right now may still be open.
fn roof_is_open(stage: &Stage) -> Result<(), Trouble> {
    for dome in &stage.room.rig.domes {
        if let Some(shutter) = dome.shutter().filter(|shutter| *shutter != Shutter::Open) {
            let (device, reason) =
                (dome.instrument.device.to_string(), format!("the shutter is {shutter:?}").to_lowercase());
            return Err(Trouble::Failed { device, verb: "stay open".to_owned(), reason });
        }
    }
    Ok(())
}

/// A mount that reports that it does not track smears the sky: its device node may have stopped it.
fn sky_is_followed(stage: &Stage) -> Result<(), Trouble> {
    let Some(mount) = stage.chain()?.mount else { return Ok(()) };
    let stands = mount.instrument.fresh().is_some_and(|state| state.fields.tracking.known() == Some(&false));
    if !stands {
        return Ok(());
    }
    let (device, reason) = (mount.instrument.device.to_string(), "tracking was switched off".to_owned());
    Err(Trouble::Failed { device, verb: "follow the sky".to_owned(), reason })
}

/// Waits until a frame's light is in. One that the dome's slit has hidden too much of does not count, and is a fault of
/// the dome; it is aborted where that still saves time.
async fn exposed(
    stage: &Stage,
    camera: &Camera,
    frame: &CommandId,
    exposure_s: f64,
    open_sky: bool,
) -> Result<(), Trouble> {
    let seen = if open_sky {
        slit::through_the_slit(stage, camera, frame, exposure_s).await?
    } else {
        camera.exposed(frame, exposure_s).await?;
        Seen::Counts(None)
    };
    if let Seen::Hopeless(lost, overtaken) = seen {
        note_hidden(stage, frame, lost, false).await?;
        if let Err(trouble) = camera.abort().await {
            tracing::warn!(%trouble, "the exposure was not aborted; it ends by itself, and does not count");
        }
        stage.set_exposing(None);
        return Err(overtaken);
    }
    stage.set_exposing(None);
    let night = stage.night().to_string();
    stage.room.ledger.expect(frame, &night, &stage.row.camera, stage.clock().machine());
    match seen {
        Seen::Spoilt(lost, overtaken) => {
            note_hidden(stage, frame, lost, false).await?;
            Err(overtaken)
        }
        Seen::Counts(Some(lost)) => note_hidden(stage, frame, lost, true).await,
        Seen::Counts(None) | Seen::Hopeless(..) => Ok(()),
    }
}

/// Records how much light a frame lost behind the dome, before its announcement or a restart can make it count, and
/// reports it to the archives that store the frame.
async fn note_hidden(stage: &Stage, frame: &CommandId, lost: f64, counts: bool) -> Result<(), Trouble> {
    let lost_percent = (1000.0 * lost).round() / 10.0;
    tracing::warn!(%frame, lost_percent, counts, "the dome hid a part of the frame's light");
    let (room, row, noted) = (stage.room.clone(), stage.row.id.clone(), frame.clone());
    let noted = tokio::task::spawn_blocking(move || {
        room.journal.hidden(&row, &noted, lost_percent, counts, room.node.bus.clock().utc())
    });
    noted.await.map_err(io::Error::other)??;
    if let Err(error) = stage.room.facts.tell_hidden(&stage.room, frame, lost_percent).await {
        tracing::warn!(%frame, %error, "what the dome hid of a frame could not be told");
    }
    Ok(())
}

/// A frame of this row that was under way when this node was restarted is waited for, not taken twice; nothing is moved
/// before that.
pub async fn adopt(stage: &Stage, open_sky: bool) -> Result<(), Trouble> {
    let open = stage.room.journal.progress(&stage.row.id).open;
    let camera = stage.chain()?.camera;
    let Some(exposure) = camera.instrument.fresh().and_then(|state| state.fields.exposure) else { return Ok(()) };
    if !open.contains(&exposure.id) {
        return Ok(());
    }
    stage.step("finishing the frame that was under way");
    let mut unspooled = Unspooled::of(stage)?;
    exposed(stage, camera, &exposure.id, exposure.exposure_s, open_sky).await?;
    // What counts next counts with it, or without it where it was lost.
    unspooled.add(&exposure.id);
    unspooled.settle(stage).await?;
    Ok(())
}

/// Makes the id of the next frame; it is on disk when this returns.
pub async fn intend(stage: &Stage) -> Result<Intent, Trouble> {
    let (room, row) = (stage.room.clone(), stage.row.id.clone());
    let intent = tokio::task::spawn_blocking(move || room.journal.intend(&row, room.node.bus.clock().utc()));
    Ok(intent.await.map_err(io::Error::other)??)
}
