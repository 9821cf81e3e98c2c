//! Flats in a forecast: the same choices as in the observatory node, of a sky whose brightness follows the Sun as the
//! first guess has it.
//!
//! The brightness of the sky in a filter is not known beforehand: each filter is assumed to need the geometric mean of
//! the camera's shortest and longest exposure when the Sun stands in the middle of the window.

use contract::Name;
use units::Utc;

use super::Foresee;
use crate::action::Flats;
use crate::action::flats::FlatsSource;
use crate::flats::exposure::{Level, Light, Seen, Want, signal_adu};
use crate::flats::filter::{AHEAD_S, Filter, GOOD_S, LOOKS, MAX_ADU, WINDOW_ENDED, candidate, summary, to_ms};
use crate::flats::order::{Next, Order, Trend, next};
use crate::flats::twilight::{Window, antisolar, ln_between, slope_per_s};
use crate::plan::{Halt, SimulatedRun};
use crate::shot::fits;

/// Steps of one row: more than any twilight has.
const MOST_STEPS: u32 = 10_000;
/// A cover closes or opens in so long, s.
const COVER_S: f64 = 10.0;
/// The difference between the Sun of a forecast and that of the almanac, at most, s.
const SUN_AHEAD_S: f64 = 4.0;

impl Foresee for Flats {
    fn foresee(&self, run: &mut SimulatedRun<'_>) -> Result<(), Halt> {
        run.reads(&self.readout);
        match self.source {
            FlatsSource::Sky => of_sky(run, self.wanted(), self.order, self.moves()),
            FlatsSource::Panel => of_panel(run, self.wanted()),
        }
    }
}

/// A simulated sky.
struct Dusk {
    window: Window,
    want: Want,
}

impl Dusk {
    /// The rate of any filter at an instant and its slope, ADU/s and per s.
    fn rate(&self, run: &mut SimulatedRun<'_>, at: Utc) -> Result<(f64, f64), Halt> {
        let (sun_deg, later_deg) = (sun_deg(run, at)?, sun_deg(run, at.plus_seconds(AHEAD_S))?);
        let middle_deg = 0.5 * (self.window.min_deg + self.window.max_deg);
        let usual_s = (self.want.min_s * self.want.max_s).sqrt();
        let rate = self.want.signal_adu() / usual_s * ln_between(sun_deg, middle_deg).exp();
        Ok((rate, slope_per_s((later_deg - sun_deg) / AHEAD_S)))
    }

    /// The level of a frame that begins now.
    fn seen(&self, run: &mut SimulatedRun<'_>, exposure_s: f64, is_part: bool) -> Result<Seen, Halt> {
        let (rate, slope) = self.rate(run, run.now)?;
        let adu = self.want.bias_adu + signal_adu(exposure_s, rate, slope);
        let level = if adu < MAX_ADU { Level::Adu(adu) } else { Level::Saturated };
        Ok(Seen { started: run.now, exposure_s, level, is_part })
    }
}

fn sun_deg(run: &mut SimulatedRun<'_>, at: Utc) -> Result<f64, Halt> {
    Ok(run.observer(at)?.sun().altitude.degrees())
}

/// Flats of the twilight sky.
fn of_sky(run: &mut SimulatedRun<'_>, mut filters: Vec<Filter>, order: Order, moves: bool) -> Result<(), Halt> {
    let Some(config) = run.camera().map(|camera| camera.flats) else { return Err(no_camera(run)) };
    let had = allot(&mut filters, run.taken);
    run.cool()?;
    let dusk = Dusk {
        window: Window { min_deg: config.sun_min_deg, max_deg: config.sun_max_deg },
        want: Want::of(&config, MAX_ADU),
    };
    if config.bias_adu.is_none() {
        run.aside(0.0, false)?;
    }
    if !wait_for(run, &dusk.window, had > 0)? {
        run.note(summary(&filters, Some(&dusk.window.never())));
        return Ok(());
    }
    let (_, slope) = dusk.rate(run, run.now)?;
    let trend = if slope > 0.0 { Trend::Brightens } else { Trend::Fades };
    if moves {
        let observer = run.observer(run.now)?;
        let away = observer.to_icrs(&antisolar(&observer.sun()));
        run.open()?;
        run.slew(Some(&away))?;
    }
    let mut light = Light::new(dusk.want, filters.len(), slope);
    let before = run.taken;
    let why = take(run, &dusk, &mut filters, (order, trend), &mut light)?;
    run.spool(before)?;
    run.note(summary(&filters, why.as_deref()));
    Ok(())
}

/// Takes the frames; returns why they end before all are taken.
fn take(
    run: &mut SimulatedRun<'_>,
    dusk: &Dusk,
    filters: &mut [Filter],
    (order, trend): (Order, Trend),
    light: &mut Light,
) -> Result<Option<String>, Halt> {
    let (mut sound, mut current) = (None, None);
    let turn_to = |run: &mut SimulatedRun<'_>, name: Option<String>| {
        let takes_s = run.turn_to(name.as_deref());
        run.pass(takes_s)
    };
    let name = |filters: &[Filter], index: usize| filters.get(index).and_then(|filter| filter.name.clone());
    for _ in 0..MOST_STEPS {
        if !dusk.window.has(&run.observer(run.now)?.sun()) {
            return Ok(Some(dusk.window.left()));
        }
        let (now, end) = (run.now, run.row.end);
        let each = filters.iter().enumerate();
        let known: Vec<_> = each.map(|(index, filter)| candidate(filter.is_wanted(), light, index, now)).collect();
        let what = sound.take().map_or_else(|| next(order, trend, &known, current), Next::Sound);
        match what {
            Next::Done => return Ok(None),
            Next::GiveUp(index, is_bright) => {
                if let Some(filter) = filters.get_mut(index) {
                    filter.given_up = Some(if is_bright { "too bright" } else { "too dark" });
                }
            }
            Next::Wait(..) | Next::Take(..) if !fits(now, length_s(&what), end) => {
                return Ok(Some(WINDOW_ENDED.to_owned()));
            }
            Next::Wait(index, wait_s) => {
                run.pass(wait_s)?;
                sound = Some(index);
            }
            Next::Sound(index) => {
                turn_to(run, name(filters, index))?;
                let mut exposure_s = dusk.want.first_look_s(light.ready(index, run.now));
                for _ in 0..LOOKS {
                    exposure_s = to_ms(exposure_s);
                    if !fits(run.now, exposure_s, end) {
                        return Ok(Some(WINDOW_ENDED.to_owned()));
                    }
                    let seen = dusk.seen(run, exposure_s, true)?;
                    run.aside(exposure_s, true)?;
                    light.see(index, &seen);
                    match dusk.want.sound_again_s(&seen) {
                        Some(again_s) => exposure_s = again_s,
                        None => break,
                    }
                }
            }
            Next::Take(index, exposure_s) => {
                turn_to(run, name(filters, index))?;
                let exposure_s = to_ms(exposure_s);
                let seen = dusk.seen(run, exposure_s, false)?;
                light.see(index, &seen);
                if dusk.want.accepts(seen.level) {
                    run.frame(exposure_s, true)?;
                    filters.iter_mut().skip(index).take(1).for_each(|filter| filter.taken += 1);
                } else {
                    run.aside(exposure_s, true)?;
                }
                current = Some(index);
            }
        }
    }
    Ok(Some("the plan follows no more steps".to_owned()))
}

/// The time that a step needs within the row's window, s.
fn length_s(what: &Next) -> f64 {
    match what {
        Next::Wait(_, span_s) | Next::Take(_, span_s) => *span_s,
        Next::Sound(_) | Next::GiveUp(..) | Next::Done => 0.0,
    }
}

/// Waits until the Sun is in the window; false where it is not while the row may run, or was before.
fn wait_for(run: &mut SimulatedRun<'_>, window: &Window, has_begun: bool) -> Result<bool, Halt> {
    loop {
        if window.has(&run.observer(run.now)?.sun()) {
            return Ok(true);
        }
        if has_begun {
            return Ok(false);
        }
        let opens = window.opens(run.site(), run.now).map_err(|why| Halt::Failed(why.to_string()))?;
        let Some(opens) = opens.filter(|opens| *opens < run.row.end) else { return Ok(false) };
        run.wait_until(opens.plus_seconds(1.0))?;
        run.pass(SUN_AHEAD_S)?;
    }
}

/// Flats of a panel: exposures that its brightness is chosen for.
fn of_panel(run: &mut SimulatedRun<'_>, mut filters: Vec<Filter>) -> Result<(), Halt> {
    let Some(config) = run.camera().map(|camera| camera.flats) else { return Err(no_camera(run)) };
    allot(&mut filters, run.taken);
    run.cool()?;
    if config.bias_adu.is_none() {
        run.aside(0.0, false)?;
    }
    run.pass(COVER_S)?;
    let exposure_s = GOOD_S.clamp(config.exposure_min_s, config.exposure_max_s.max(config.exposure_min_s));
    let (before, mut why) = (run.taken, None);
    'all: for filter in &mut filters {
        let takes_s = run.turn_to(filter.name.as_deref());
        run.pass(takes_s)?;
        if filter.is_wanted() {
            run.aside(config.exposure_min_s, false)?;
        }
        while filter.is_wanted() {
            if !fits(run.now, exposure_s, run.row.end) {
                why = Some(WINDOW_ENDED);
                break 'all;
            }
            run.frame(exposure_s, false)?;
            filter.taken += 1;
        }
    }
    run.spool(before)?;
    run.note(summary(&filters, why));
    run.pass(COVER_S)
}

/// Assigns the frames from before an interruption to the filters in the order of the list; returns how many there were.
fn allot(filters: &mut [Filter], taken: u32) -> u32 {
    let mut left = taken;
    for filter in filters {
        filter.taken = filter.wanted.min(left);
        left -= filter.taken;
    }
    taken
}

fn no_camera(run: &SimulatedRun<'_>) -> Halt {
    let name: &Name = &run.row.camera;
    Halt::Failed(format!("no camera is called {name}"))
}
