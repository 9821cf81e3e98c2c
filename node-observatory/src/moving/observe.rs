//! Brings a telescope onto a body that moves, and takes the frames of the row while it goes along.

use schedule::plan::TimedPart;
use std::time::Duration;

use schedule::shot::Shot;
use sky::{Body, Icrs, Rates, separation};
use units::{Angle, Utc, seconds};

use super::path::Path;
use super::rated_motion::RatedMotion;
use crate::action_error::ActionError;
use crate::devices::telescope::Mount;
use crate::expected::Lasts;
use crate::exposing::Series;
use crate::focus::{FocusData, expose_in_focus};
use crate::pointing::{self, Flip, PointingData};
use crate::row_context::RowContext;

/// A body that has moved less than this during a slew is still met, arcsec.
const MET_ARCSEC: f64 = 1.0;
/// Slews that miss a body because it is gone when they end.
const SLEWS: u32 = 4;
/// A slew may take so much longer than the one before, s: it is shorter, but has to begin and to settle too.
const SPARE_S: f64 = 3.0;
/// The place in the headers of frames is renewed when the body has left it by this, arcsec: less than what pointing
/// means.
const STALE_ARCSEC: f64 = 30.0;
/// Between two looks at rates, at least: machine time.
const BREATH: Duration = Duration::from_millis(20);

/// What a row asks of the following.
#[derive(Debug, Clone, Copy, Default)]
pub struct FollowRequest {
    /// The telescope waits so long before the body, s.
    pub lead_s: f64,
    /// Rates are renewed no more often than this, s.
    pub update_s: Option<f64>,
    /// The telescope is brought back onto the body after so long, s; never where 0.
    pub recenter_s: f64,
    /// The commanded place minus the wanted one, as solved frames have shown it near the body.
    pub correction: Option<[Angle; 2]>,
}

/// Refuses a mount that cannot move relative to the stars.
pub async fn can_follow(mount: &Mount) -> Result<(), ActionError> {
    if mount.instrument.capabilities().await?.set_rates {
        return Ok(());
    }
    Err(ActionError::Impossible(format!(
        "the target moves, and {} takes no rates for it (CanSetRightAscensionRate or CanSetDeclinationRate is false)",
        mount.instrument.device.name
    )))
}

/// Takes the frames of a row while the telescope follows `body`; returns how many there are. `shot` gets the number of
/// frames so far, the time, and when the last must have ended.
pub async fn observe(
    context: &RowContext,
    (pointing, focus): (&PointingData, &FocusData),
    mount: &Mount,
    (body, request): (&Body, &FollowRequest),
    mut series: Series,
    shot: impl Fn(u32, Utc, Utc) -> Option<Shot> + Send + Sync,
) -> Result<u32, ActionError> {
    let (path, clock) = (Path::new(context, mount, body), context.clock());
    let end = path.up_until(clock.utc(), context.row.end)?;
    context.set_following(true);
    let (mut flip, mut turned_from) = (Flip::of(context, mount), None);
    let taken = 'recenter: loop {
        let mut motion = meet(context, pointing, mount, &path, request).await?;
        if let Some(side) = turned_from.take()
            && let Some(ignored) = flip.note(side).await
        {
            tracing::warn!(ignored, "the moving target is followed on this side of the pier");
        }
        renew(context, mount, &path, request, &mut motion).await?;
        let recenter = (request.recenter_s > 0.0).then(|| clock.utc().plus_seconds(request.recenter_s));
        let is_due = |now: Utc| recenter.is_some_and(|at| now >= at);
        loop {
            let here = path.icrs(clock.utc())?;
            series.target_deg = Some((here.ra.degrees(), here.dec.degrees()));
            let is_stale =
                |now| path.icrs(now).is_ok_and(|there| separation(&here, &there).arcseconds() > STALE_ARCSEC);
            let mut first = true;
            let next = |taken, now| {
                let is_first = std::mem::take(&mut first);
                let flips = |shot: &Shot| flip.is_due(&here, shot.exposure_s, now);
                shot(taken, now, end).filter(|shot| is_first || !(is_due(now) || is_stale(now) || flips(shot)))
            };
            let taken = tokio::select! {
                taken = expose_in_focus(context, focus, &series, next) => taken?,
                error = follow(context, mount, &path, request, &mut motion) => return Err(error),
            };
            let now = clock.utc();
            let Some(following) = shot(taken, now, end) else { break 'recenter taken };
            if flip.is_due(&here, following.exposure_s, now) {
                context.step("meridian flip", TimedPart::Slew);
                turned_from = flip.side();
                break;
            }
            if is_due(now) {
                context.step("back to the moving target", TimedPart::Slew);
                break;
            }
        }
    };
    // The frames are taken; the end of tracking ends the rates too.
    if let Err(error) = mount.set_rates(Rates::default()).await {
        tracing::warn!(%error, "the mount may still go along with the moving target, until its tracking ends");
    }
    context.set_following(false);
    Ok(taken)
}

/// Slews to where the body will be, and waits for it there.
async fn meet(
    context: &RowContext,
    pointing: &PointingData,
    mount: &Mount,
    path: &Path<'_>,
    request: &FollowRequest,
) -> Result<RatedMotion, ActionError> {
    let clock = context.clock();
    let mut lead_s = request.lead_s;
    for _ in 0..SLEWS {
        let began = clock.utc();
        let meeting = began.plus_seconds(lead_s);
        let place = path.icrs(meeting)?;
        context.step("slewing to the moving target", TimedPart::Slew);
        send(context, pointing, mount, &place, request.correction).await?;
        // A mount that tracks the place of date holds what it was sent at the time of the slew.
        let arrived = clock.utc();
        let spot = path.of_mount(&place, &context.observer(arrived)?)?;
        if arrived <= meeting {
            let wait_s = meeting.seconds_since(arrived);
            context.step("waiting for the moving target", Lasts::Seconds(wait_s));
            clock.sleep_sky(seconds(wait_s)).await;
            return Ok(RatedMotion::begun(meeting, spot));
        }
        if path.spot(arrived)?.apart_arcsec(&spot) < MET_ARCSEC {
            return Ok(RatedMotion::begun(arrived, spot));
        }
        // The next slew is no longer than this one was.
        lead_s = arrived.seconds_since(began) + SPARE_S;
    }
    let (device, verb) = (mount.instrument.device.to_string(), "reach a moving target".to_owned());
    Err(ActionError::Failed { device, verb, reason: format!("it was gone before each of {SLEWS} slews had ended") })
}

async fn send(
    context: &RowContext,
    pointing: &PointingData,
    mount: &Mount,
    place: &Icrs,
    correction: Option<[Angle; 2]>,
) -> Result<(), ActionError> {
    let Some([ra, dec]) = correction else { return pointing::send(context, pointing, mount, place).await.map(|_| ()) };
    let observer = context.visible(place)?;
    let commanded = Icrs { ra: place.ra + ra, dec: place.dec + dec }.checked()?;
    mount.point(&commanded, &observer).await
}

/// Renews the rates as the path bends, for ever; returns what went wrong.
async fn follow(
    context: &RowContext,
    mount: &Mount,
    path: &Path<'_>,
    request: &FollowRequest,
    motion: &mut RatedMotion,
) -> ActionError {
    loop {
        let rests_s = match renew(context, mount, path, request, motion).await {
            Ok(rests_s) => rests_s,
            Err(error) => return error,
        };
        context.clock().sleep_sky(seconds(rests_s)).await;
        tokio::time::sleep(BREATH).await;
    }
}

/// Looks at the rates, if it is time, and sends others where they are wanted; returns seconds until the next look.
async fn renew(
    context: &RowContext,
    mount: &Mount,
    path: &Path<'_>,
    request: &FollowRequest,
    motion: &mut RatedMotion,
) -> Result<f64, ActionError> {
    let now = context.clock().utc();
    let interval_s = path.interval_s(now, request.update_s)?;
    let rests_s = motion.rests_s(now, interval_s);
    if rests_s > 0.0 {
        return Ok(rests_s);
    }
    if let Some(rates) = motion.look(now, &path.spot(now.plus_seconds(interval_s))?, interval_s) {
        let taken = mount.set_rates(rates).await?;
        tracing::debug!(?rates, interval_s, "rates of a moving target");
        motion.set(taken, rates);
    }
    Ok(interval_s)
}
