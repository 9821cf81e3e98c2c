//! Brings a telescope onto a body that moves, and takes the frames of the row while it goes along.

use std::time::Duration;

use sky::{Body, Icrs, Rates, separation};
use units::{Angle, Utc, seconds};

use super::course::Course;
use super::path::Path;
use crate::action::Stage;
use crate::action::expose::{Series, expose};
use crate::pointing::{self, Flip};
use crate::rig::telescope::Mount;
use crate::trouble::Trouble;
use schedule::shot::Shot;

/// A body that has moved less than this during a slew is still met, arcsec; as in the predecessor.
const MET_ARCSEC: f64 = 1.0;
/// Slews that miss a body because it is gone when they end.
const SLEWS: u32 = 4;
/// A slew may take so much longer than the one before, s: it is shorter, but has to begin and to settle too.
const SPARE_S: f64 = 3.0;
/// The place in the headers of frames is renewed when the body has left it by this, arcsec: less than what pointing means.
const STALE_ARCSEC: f64 = 30.0;
/// Between two looks at rates, at least: machine time.
const BREATH: Duration = Duration::from_millis(20);

/// What a row asks of the following.
#[derive(Debug, Clone, Copy, Default)]
pub struct Wish {
    /// The telescope waits so long before the body, s.
    pub lead_s: f64,
    /// Rates are renewed no more often than this, s.
    pub update_s: Option<f64>,
    /// The telescope is brought back onto the body after so long, s; never where 0.
    pub recenter_s: f64,
    /// What is commanded less what is wanted, as solved frames have shown it beside the body.
    pub correction: Option<[Angle; 2]>,
}

/// Refuses a mount that cannot go beside the stars.
pub async fn can_follow(mount: &Mount) -> Result<(), Trouble> {
    if mount.instrument.capabilities().await?.set_rates {
        return Ok(());
    }
    Err(Trouble::Impossible(format!(
        "the target moves, and {} takes no rates for it (CanSetRightAscensionRate or CanSetDeclinationRate is false)",
        mount.instrument.device.name
    )))
}

/// Takes the frames of a row while the telescope goes along with `body`; returns how many there are. `shot` is told how many
/// there are already, the time, and when the last must have ended.
pub async fn observe(
    stage: &Stage,
    mount: &Mount,
    (body, wish): (&Body, &Wish),
    mut series: Series,
    shot: impl Fn(u32, Utc, Utc) -> Option<Shot> + Send + Sync,
) -> Result<u32, Trouble> {
    let (path, clock) = (Path::new(stage, mount, body), stage.clock());
    let end = path.up_until(clock.utc(), stage.row.end)?;
    stage.set_following(true);
    let (mut flip, mut turns) = (Flip::of(stage, mount), false);
    let taken = 'recenter: loop {
        let mut course = meet(stage, mount, &path, wish).await?;
        if std::mem::take(&mut turns)
            && let Some(ignored) = flip.note().await
        {
            tracing::warn!(ignored, "the moving target is followed on this side of the pier");
        }
        renew(stage, mount, &path, wish, &mut course).await?;
        let recenter = (wish.recenter_s > 0.0).then(|| clock.utc().plus_seconds(wish.recenter_s));
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
                taken = expose(stage, &series, next) => taken?,
                trouble = follow(stage, mount, &path, wish, &mut course) => return Err(trouble),
            };
            let now = clock.utc();
            let Some(following) = shot(taken, now, end) else { break 'recenter taken };
            if flip.is_due(&here, following.exposure_s, now) {
                stage.step("meridian flip");
                turns = true;
                break;
            }
            if is_due(now) {
                stage.step("back to the moving target");
                break;
            }
        }
    };
    mount.set_rates(Rates::default()).await?;
    stage.set_following(false);
    Ok(taken)
}

/// Slews to where the body will be, and waits for it there.
async fn meet(stage: &Stage, mount: &Mount, path: &Path<'_>, wish: &Wish) -> Result<Course, Trouble> {
    let clock = stage.clock();
    let mut lead_s = wish.lead_s;
    for _ in 0..SLEWS {
        let began = clock.utc();
        let meeting = began.plus_seconds(lead_s);
        let place = path.icrs(meeting)?;
        stage.step("slewing to the moving target");
        send(stage, mount, &place, wish.correction).await?;
        // a mount that tracks the place of date holds what it was sent at the time of the slew
        let arrived = clock.utc();
        let spot = path.of_mount(&place, &stage.observer(arrived)?)?;
        if arrived <= meeting {
            stage.step("waiting for the moving target");
            clock.sleep_sky(seconds(meeting.seconds_since(arrived))).await;
            return Ok(Course::begun(meeting, spot));
        }
        if path.spot(arrived)?.apart_arcsec(&spot) < MET_ARCSEC {
            return Ok(Course::begun(arrived, spot));
        }
        // the next slew is no longer than this one was
        lead_s = arrived.seconds_since(began) + SPARE_S;
    }
    let (device, verb) = (mount.instrument.device.to_string(), "reach a moving target".to_owned());
    Err(Trouble::Failed { device, verb, reason: format!("it was gone before each of {SLEWS} slews had ended") })
}

async fn send(stage: &Stage, mount: &Mount, place: &Icrs, correction: Option<[Angle; 2]>) -> Result<(), Trouble> {
    let Some([ra, dec]) = correction else { return pointing::send(stage, mount, place).await.map(|_| ()) };
    let observer = stage.visible(place)?;
    let commanded = Icrs { ra: place.ra + ra, dec: place.dec + dec }.checked()?;
    mount.point(&commanded, &observer).await
}

/// Renews the rates as the path bends, for ever; returns what went wrong.
async fn follow(stage: &Stage, mount: &Mount, path: &Path<'_>, wish: &Wish, course: &mut Course) -> Trouble {
    loop {
        let rests_s = match renew(stage, mount, path, wish, course).await {
            Ok(rests_s) => rests_s,
            Err(trouble) => return trouble,
        };
        stage.clock().sleep_sky(seconds(rests_s)).await;
        tokio::time::sleep(BREATH).await;
    }
}

/// Looks at the rates, if it is time, and sends others where they are wanted; returns seconds until the next look.
async fn renew(
    stage: &Stage,
    mount: &Mount,
    path: &Path<'_>,
    wish: &Wish,
    course: &mut Course,
) -> Result<f64, Trouble> {
    let now = stage.clock().utc();
    let interval_s = path.interval_s(now, wish.update_s)?;
    let rests_s = course.rests_s(now, interval_s);
    if rests_s > 0.0 {
        return Ok(rests_s);
    }
    if let Some(rates) = course.look(now, &path.spot(now.plus_seconds(interval_s))?, interval_s) {
        let taken = mount.set_rates(rates).await?;
        tracing::debug!(?rates, interval_s, "rates of a moving target");
        course.set(taken, rates);
    }
    Ok(interval_s)
}
