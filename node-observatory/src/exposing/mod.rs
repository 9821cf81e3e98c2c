//! One frame after another, with nothing between them: the next is sent as soon as the state shows that the last is
//! done.

mod spooled;

use std::collections::BTreeMap;
use std::pin::Pin;

use contract::CommandId;
use contract::device::camera::{Command, Purpose, Subframe};
use contract::device::dome::Shutter;
use schedule::action::parameters::FocusWanted;
use schedule::plan::overheads::TimedPart;
use schedule::shot::Shot;
use units::Utc;

use self::spooled::Unspooled;
use crate::action_error::ActionError;
use crate::devices::camera::Camera;
use crate::devices::telescope::Mount;
use crate::expected::Lasts;
use crate::journal::{Intent, Journal};
use crate::row_context::RowContext;
use crate::slit::{self, ExposureThroughSlit};

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

/// The future of what is done before each frame.
pub type BeforeFrame<'a> = Pin<Box<dyn Future<Output = Result<(), ActionError>> + Send + 'a>>;

/// Takes frames until `next` returns none. `next` gets the number of the row's frames, including those from before a
/// restart. Returns that number. The focus is left alone.
pub async fn expose(
    context: &RowContext,
    series: &Series,
    next: impl FnMut(u32, Utc) -> Option<Shot> + Send,
) -> Result<u32, ActionError> {
    expose_with(context, series, || Box::pin(std::future::ready(Ok(()))), next).await
}

/// As [`expose`], with something to do before each frame.
pub async fn expose_with<'a>(
    context: &'a RowContext,
    series: &'a Series,
    before: impl Fn() -> BeforeFrame<'a> + Send,
    mut next: impl FnMut(u32, Utc) -> Option<Shot> + Send,
) -> Result<u32, ActionError> {
    adopt(context, series.open_sky).await?;
    let mut taken = context.tools.journal.progress(&context.row.id).taken;
    let mut unspooled = Unspooled::of(context)?;
    let Some(mut shot) = next(taken, context.clock().utc()) else { return Ok(taken) };
    let camera = context.chain()?.camera;
    loop {
        // Boxed: it is large, and rarely does anything.
        before().await?;
        // The id that was prepared, unless a focus run has taken it meanwhile: no two frames have one.
        let intent = intend(context).await?;
        ready(context, series, &shot, &intent.frame).await?;
        context.tools.journal.sent(&context.row.id);
        camera.instrument.ask_in_turn(&intent.frame, own(context, series, &shot, intent.sequence)).await?;
        // The next id goes to disk while this frame collects light.
        let prepared = intend(context).await;
        exposed(context, camera, &intent.frame, shot.exposure_s, series.open_sky).await?;
        taken += 1;
        unspooled.add(&intent.frame);
        context.tools.night.row(context.index, |row| row.frames = taken);
        // Here a row that the schedule has no longer is ended: no frame is under way.
        tokio::task::yield_now().await;
        let mut following = next(taken, context.clock().utc());
        if following.is_none() {
            // These are enough only if each of them is on disk.
            let shut = context.clock().utc();
            let lost = unspooled.settle(context).await?;
            context.took(TimedPart::Spool, shut);
            if lost > 0 {
                taken = taken.saturating_sub(lost);
                context.tools.night.row(context.index, |row| row.frames = taken);
                following = next(taken, context.clock().utc());
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
pub async fn aside(context: &RowContext, series: &Series, shot: &Shot, action: &str) -> Result<CommandId, ActionError> {
    let Intent { frame, sequence } = context.write(Journal::aside).await?;
    let camera = context.chain()?.camera;
    ready(context, series, shot, &frame).await?;
    let command = command(context, series, shot, action, sequence);
    camera.instrument.ask_in_turn(&frame, command).await?;
    exposed(context, camera, &frame, shot.exposure_s, series.open_sky).await?;
    Ok(frame)
}

/// Waits until the sky can be seen, where that is wanted; the frame is under way from then on.
async fn ready(context: &RowContext, series: &Series, shot: &Shot, frame: &CommandId) -> Result<(), ActionError> {
    if series.open_sky {
        let began = |why: &str| context.step(format!("waiting for the dome's slit: {why}"), TimedPart::Slit);
        let ended = |since: Utc| context.took(TimedPart::Slit, since);
        slit::wait_until_clear(&context.tools.slits, context.chain()?.mount, shot.exposure_s, began, ended).await?;
        roof_is_open(context)?;
        sky_is_followed(context)?;
    }
    nodes_are_fit(context).await;
    context.small_step(shot.words.clone(), Lasts::Frame(shot.exposure_s));
    context.set_exposing(Some(frame.clone()));
    Ok(())
}

/// Waits while a node has no room for frames or a wrong clock. A row that wants the sky is interrupted by this anyway; a
/// dark or a bias would be lost in a full spool as well.
async fn nodes_are_fit(context: &RowContext) {
    let mut verdict = context.tools.authority.verdict.clone();
    let mut waits = false;
    loop {
        let why = verdict.borrow_and_update().unfit_nodes();
        let Some(why) = why else { return };
        if !waits {
            context.step(format!("waiting before the next frame: {why}"), Lasts::Unbounded);
            waits = true;
        }
        // The safety loop ends only with this node.
        if verdict.changed().await.is_err() {
            return;
        }
    }
}

/// The command for a frame of the row itself.
fn own(context: &RowContext, series: &Series, shot: &Shot, sequence: u32) -> Command {
    command(context, series, shot, series.action.unwrap_or(context.row.action.name()), sequence)
}

/// Takes one frame whose id was made before ([`intend`]); the next one waits for what it shows. Where it does not
/// count, it is none of those that the row was asked for.
pub async fn single(
    context: &RowContext,
    series: &Series,
    shot: &Shot,
    intent: &Intent,
    counts: bool,
) -> Result<(), ActionError> {
    let camera = context.chain()?.camera;
    ready(context, series, shot, &intent.frame).await?;
    context.tools.journal.sent(&context.row.id);
    if !counts {
        // Before its announcement or a restart can make it count; nothing of it was hidden.
        let frame = intent.frame.clone();
        context.write(move |journal, row, now| journal.hidden(row, &frame, 0.0, false, now)).await?;
    }
    let mut unspooled = Unspooled::of(context)?;
    camera.instrument.ask_in_turn(&intent.frame, own(context, series, shot, intent.sequence)).await?;
    exposed(context, camera, &intent.frame, shot.exposure_s, series.open_sky).await?;
    unspooled.add(&intent.frame);
    if unspooled.settle(context).await? > 0 {
        return Err(ActionError::Restarted { device: camera.instrument.device.to_string() });
    }
    if counts {
        context.tools.night.row(context.index, |row| row.frames += 1);
    }
    Ok(())
}

fn command(context: &RowContext, series: &Series, shot: &Shot, action: &str, sequence: u32) -> Command {
    let in_beam = || context.chain().ok()?.wheel?.filter();
    let purpose = Purpose {
        action: action.to_owned(),
        object: series.object.clone(),
        image_type: shot.image_type.to_owned(),
        filter: series.filter.clone().or_else(in_beam),
        ra_deg: series.target_deg.map(|(ra, _)| ra),
        dec_deg: series.target_deg.map(|(_, dec)| dec),
        night: context.night().to_string(),
        sequence,
        row: Some(context.index),
        programme: context.row.programme.clone(),
        folder: series.folder.clone(),
        paired: context.paired(),
        metadata: series.metadata.clone(),
    };
    Command::Expose {
        exposure_s: shot.exposure_s,
        // What takes no time needs no shutter, whatever it is for.
        light: shot.exposure_s > 0.0 && !matches!(shot.image_type, "Bias Frame" | "Dark Frame"),
        bin: series.bin,
        subframe: series.subframe,
        purpose: Box::new(purpose),
    }
}

/// A dome that reports anything but "open" hides the sky; one that reports nothing right now may still be open.
fn roof_is_open(context: &RowContext) -> Result<(), ActionError> {
    for dome in &context.tools.devices.domes {
        if let Some(shutter) = dome.shutter().filter(|shutter| *shutter != Shutter::Open) {
            let (device, reason) =
                (dome.instrument.device.to_string(), format!("the shutter is {shutter:?}").to_lowercase());
            return Err(ActionError::Failed { device, verb: "stay open".to_owned(), reason });
        }
    }
    Ok(())
}

/// A mount that reports that it does not track smears the sky: its device node may have stopped it.
fn sky_is_followed(context: &RowContext) -> Result<(), ActionError> {
    let Some(mount) = context.chain()?.mount else { return Ok(()) };
    if let Some(beyond) = mount.is_stopped_for() {
        return Err(mount.stopped_at(&beyond));
    }
    let stands = mount.instrument.fresh().is_some_and(|state| state.fields.tracking.known() == Some(&false));
    if !stands {
        return Ok(());
    }
    let (device, reason) = (mount.instrument.device.to_string(), "tracking was switched off".to_owned());
    Err(ActionError::Failed { device, verb: "follow the sky".to_owned(), reason })
}

/// Waits until the mount's device node stops it at a limit.
async fn stopped_at_a_limit(mount: Option<&Mount>) -> ActionError {
    let Some(mount) = mount else { return std::future::pending().await };
    let mut states = mount.instrument.follow();
    loop {
        if let Some(beyond) = mount.is_stopped_for() {
            return mount.stopped_at(&beyond);
        }
        states.changed().await;
    }
}

/// Waits until a frame's light is in. One that the dome's slit has hidden too much of does not count, and is a fault of
/// the dome; it is aborted where that still saves time.
async fn exposed(
    context: &RowContext,
    camera: &Camera,
    frame: &CommandId,
    exposure_s: f64,
    open_sky: bool,
) -> Result<(), ActionError> {
    let seen = if open_sky {
        let mount = context.chain()?.mount;
        tokio::select! {
            seen = slit::through_the_slit(&context.tools.slits, mount, camera, frame, exposure_s) => seen?,
            // Nothing is exposed beyond a limit, and what was is no frame of the target.
            stopped = stopped_at_a_limit(mount) => {
                note_hidden(context, frame, 0.0, false).await?;
                if let Err(error) = camera.abort().await {
                    tracing::warn!(%error, "the exposure was not aborted; it ends by itself, and does not count");
                }
                context.set_exposing(None);
                return Err(stopped);
            }
        }
    } else {
        camera.exposed(frame, exposure_s).await?;
        ExposureThroughSlit::Counts(None)
    };
    if let ExposureThroughSlit::Hopeless(lost, overtaken) = seen {
        note_hidden(context, frame, lost, false).await?;
        if let Err(error) = camera.abort().await {
            tracing::warn!(%error, "the exposure was not aborted; it ends by itself, and does not count");
        }
        context.set_exposing(None);
        return Err(overtaken);
    }
    context.set_exposing(None);
    let night = context.night().to_string();
    context.tools.ledger.expect(frame, &night, &context.row.camera, context.clock().machine());
    match seen {
        ExposureThroughSlit::Spoilt(lost, overtaken) => {
            note_hidden(context, frame, lost, false).await?;
            Err(overtaken)
        }
        ExposureThroughSlit::Counts(Some(lost)) => note_hidden(context, frame, lost, true).await,
        ExposureThroughSlit::Counts(None) | ExposureThroughSlit::Hopeless(..) => Ok(()),
    }
}

/// Records how much light a frame lost behind the dome, before its announcement or a restart can make it count, and
/// reports it to the archives that store the frame.
async fn note_hidden(context: &RowContext, frame: &CommandId, lost: f64, counts: bool) -> Result<(), ActionError> {
    let lost_percent = (1000.0 * lost).round() / 10.0;
    tracing::warn!(%frame, lost_percent, counts, "the dome hid a part of the frame's light");
    let noted = frame.clone();
    context.write(move |journal, row, now| journal.hidden(row, &noted, lost_percent, counts, now)).await?;
    if let Err(error) =
        context.tools.frames.facts.publish_hidden(&context.tools.authority.node, frame, lost_percent).await
    {
        tracing::warn!(%frame, %error, "the share of a frame that the dome hid could not be published");
    }
    Ok(())
}

/// A frame of this row that was under way when this node was restarted is waited for, not taken twice; nothing is moved
/// before that.
pub async fn adopt(context: &RowContext, open_sky: bool) -> Result<(), ActionError> {
    let open = context.tools.journal.progress(&context.row.id).open;
    let camera = context.chain()?.camera;
    let Some(exposure) = camera.instrument.fresh().and_then(|state| state.fields.exposure) else { return Ok(()) };
    if !open.contains(&exposure.id) {
        return Ok(());
    }
    context.step("finishing the frame that was under way", Lasts::Frame(exposure.exposure_s));
    let mut unspooled = Unspooled::of(context)?;
    exposed(context, camera, &exposure.id, exposure.exposure_s, open_sky).await?;
    // What counts next counts with it, or without it where it was lost.
    unspooled.add(&exposure.id);
    unspooled.settle(context).await?;
    Ok(())
}

/// Makes the id of the next frame; it is on disk when this returns.
pub async fn intend(context: &RowContext) -> Result<Intent, ActionError> {
    Ok(context.write(Journal::intend).await?)
}
