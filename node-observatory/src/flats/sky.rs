//! Flats of the twilight sky, step by step.

use ::sky::{Horizontal, Icrs, separation};
use schedule::flats::exposure::Light;
use schedule::flats::filter::{AHEAD_S, WINDOW_ENDED, to_ms};
use schedule::flats::order::{Next, Trend, next};
use schedule::flats::twilight::{Window, antisolar, dithered, is_clear_of_sun, slope_per_s};
use schedule::plan::TimedPart;
use schedule::shot::fits;
use units::seconds;

use super::run::FlatsRun;
use crate::action_error::ActionError;
use crate::devices::telescope::Mount;
use crate::expected::Lasts;
use crate::opening::{self, Opener};
use crate::row_context::RowContext;
use crate::slit::Aimed;

/// The place opposite to the Sun is gone to again when it is further off than this, deg.
const ASTRAY_DEG: f64 = 10.0;

/// Takes the flats of a row while the Sun has the right altitude; `run` reports the flats that it could not take.
pub async fn run(run: &mut FlatsRun<'_>, opener: &Opener) -> Result<(), ActionError> {
    let context = run.context;
    let config = context.chain()?.camera.flats()?;
    let window = Window { min_deg: config.sun_min_deg, max_deg: config.sun_max_deg };
    if !wait_for(context, &window).await? {
        run.end(window.never());
        return Ok(());
    }
    let (_, speed) = sun(context)?;
    let trend = if speed > 0.0 { Trend::Brightens } else { Trend::Fades };
    let mut light = Light::new(run.want, run.request.filters.len(), slope_per_s(speed));
    let mut aim = match run.request.moves {
        true => Some(FlatsAim::begin(context, opener, config.dither_arcsec).await?),
        false => None,
    };
    let (mut sound, mut current) = (None, None);
    loop {
        if !window.has(&sun(context)?.0) {
            run.end(window.left());
            break;
        }
        let what = match sound.take() {
            Some(index) => Next::Sound(index),
            None => next(run.request.order, trend, &run.candidates(&light), current),
        };
        match what {
            Next::Done => break,
            Next::GiveUp(index, true) => run.give_up(index, "too bright"),
            Next::GiveUp(index, false) => run.give_up(index, "too dark"),
            Next::Wait(index, wait_s) => {
                if !fits(context.clock().utc(), wait_s, context.row.end) {
                    run.end(WINDOW_ENDED.to_owned());
                    break;
                }
                let (how, words) = (if trend == Trend::Fades { "bright" } else { "dark" }, run.words(index));
                context.small_step(
                    format!("waiting {wait_s:.0} s: the sky is too {how} for {words}"),
                    Lasts::Seconds(wait_s),
                );
                context.clock().sleep_sky(seconds(wait_s)).await;
                sound = Some(index);
            }
            Next::Sound(index) => {
                if let Some(aim) = &mut aim {
                    aim.renew().await?;
                }
                run.turn_to(index).await?;
                if !run.sound(index, &mut light).await? {
                    run.end(WINDOW_ENDED.to_owned());
                    break;
                }
            }
            Next::Take(index, exposure_s) => {
                let exposure_s = to_ms(exposure_s);
                if !fits(context.clock().utc(), exposure_s, context.row.end) {
                    run.end(WINDOW_ENDED.to_owned());
                    break;
                }
                run.turn_to(index).await?;
                let frame = run.take(index, exposure_s).await?;
                // The telescope goes on to the next place while the frame is read and measured.
                let dither = async {
                    match &mut aim {
                        Some(aim) => aim.dither().await,
                        None => Ok(()),
                    }
                };
                let (seen, ()) = tokio::try_join!(run.judge(index, &frame), dither)?;
                light.see(index, &seen);
                current = Some(index);
            }
        }
    }
    if aim.is_some() {
        context.leave_mount();
    }
    Ok(())
}

/// The Sun now, and how fast its altitude changes, deg per s.
fn sun(context: &RowContext) -> Result<(Horizontal, f64), ActionError> {
    let now = context.clock().utc();
    let (sun, later) = (context.observer(now)?.sun(), context.observer(now.plus_seconds(AHEAD_S))?.sun());
    Ok((sun, (later.altitude.degrees() - sun.altitude.degrees()) / AHEAD_S))
}

/// Waits until the Sun has the right altitude; false if it does not get it while the row may run, or did before.
async fn wait_for(context: &RowContext, window: &Window) -> Result<bool, ActionError> {
    let has_begun = context.tools.journal.progress(&context.row.id).taken > 0;
    loop {
        let (now, sun) = (context.clock().utc(), sun(context)?.0);
        if window.has(&sun) {
            return Ok(true);
        }
        if has_begun {
            // Flats that dusk has left over do not make the other rows wait until dawn.
            return Ok(false);
        }
        let Some(opens) = window.opens(context.tools.authority.site()?, now)?.filter(|opens| *opens < context.row.end)
        else {
            return Ok(false);
        };
        let (sun_deg, at) = (sun.altitude.degrees(), opens.strftime("%H:%M:%S"));
        // A second more: the window has no end of its own.
        let wait_s = opens.seconds_since(now) + 1.0;
        context.step(format!("waiting for the Sun, now at {sun_deg:.1} deg, until {at} UTC"), Lasts::Seconds(wait_s));
        context.clock().sleep_sky(seconds(wait_s)).await;
    }
}

/// Where the telescope looks: opposite to the Sun, each frame a little away from the last one.
struct FlatsAim<'a> {
    context: &'a RowContext,
    mount: &'a Mount,
    base: Icrs,
    index: u32,
    step_arcsec: f64,
    aimed: Option<Aimed<'a>>,
}

impl<'a> FlatsAim<'a> {
    /// Opens, and goes there.
    async fn begin(context: &'a RowContext, opener: &Opener, step_arcsec: f64) -> Result<Self, ActionError> {
        let chain = context.chain()?;
        let mount = chain.mount.ok_or_else(|| {
            let why = "has no mount; disable_telescope_movement = true takes flats where it looks";
            ActionError::Impossible(format!("{} {why}", context.row.camera))
        })?;
        let base = opposite(context)?;
        // The slit goes there while the mount slews.
        let aimed = Some(Aimed::at(&context.tools.slits, mount, base));
        let index = context.tools.journal.progress(&context.row.id).taken;
        let aim = Self { context, mount, base, index, step_arcsec, aimed };
        context.step("opening", TimedPart::Open);
        opening::open(opener, &chain).await?;
        context.step("slewing away from the Sun", TimedPart::Slew);
        aim.go().await?;
        Ok(aim)
    }

    /// Goes to the place opposite to the Sun again, where the sky has carried the telescope away from it.
    async fn renew(&mut self) -> Result<(), ActionError> {
        let base = opposite(self.context)?;
        if separation(&base, &self.base).degrees() < ASTRAY_DEG {
            return Ok(());
        }
        self.base = base;
        // The end of the old value takes back the aim that it published.
        self.aimed = None;
        self.aimed = Some(Aimed::at(&self.context.tools.slits, self.mount, base));
        self.go().await
    }

    async fn dither(&mut self) -> Result<(), ActionError> {
        self.index += 1;
        if self.step_arcsec > 0.0 { self.go().await } else { Ok(()) }
    }

    async fn go(&self) -> Result<(), ActionError> {
        let place = dithered(&self.base, self.index, self.step_arcsec);
        let observer = self.context.visible(&place)?;
        if !is_clear_of_sun(&observer.to_horizontal(&place), &observer.sun()) {
            return Err(ActionError::Impossible("flats: the telescope would look near the Sun".to_owned()));
        }
        self.mount.point(&place, &observer).await
    }
}

/// The place opposite to the Sun now.
fn opposite(context: &RowContext) -> Result<Icrs, ActionError> {
    let observer = context.observer(context.clock().utc())?;
    Ok(observer.to_icrs(&antisolar(&observer.sun())))
}
