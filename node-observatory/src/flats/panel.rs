//! Flats of a lit panel: the cover closed, its lamp on, and both left as they should be, whatever happens.

use contract::device::cover_calibrator::Cover as Shut;
use contract::device::dome::Shutter;
use schedule::flats::exposure::{Light, Want};
use schedule::flats::filter::{GOOD_S, WINDOW_ENDED, to_ms};
use schedule::flats::order::{Candidate, Next, Order, Trend, next};
use schedule::plan::TimedPart;
use schedule::shot::fits;

use super::run::FlatsRun;
use crate::action_error::ActionError;
use crate::devices::cover_calibrator::Cover;
use crate::expected::Lasts;
use crate::row_context::{FoundPanel, RowContext};

/// Changes of the brightness for one filter, at most.
const CHANGES: u32 = 4;

/// Takes the flats of a row with a panel; the row names its brightness, or it is found.
pub async fn run(run: &mut FlatsRun<'_>, brightness: Option<i64>) -> Result<(), ActionError> {
    let context = run.context;
    let (cover, most) = begin(context, brightness).await?;
    let mut lamp = Lamp { cover, most, fixed: brightness.is_some(), now: brightness.unwrap_or((most / 2).max(1)) };
    lamp.light(context).await?;
    let mut light = Light::new(run.want, run.request.filters.len(), 0.0);
    let mut changes = 0;
    loop {
        // A lamp waits for nobody: in the order of the list, each filter with the brightness that suits it.
        let known = |filter: Candidate| Candidate { is_fresh: filter.ready.is_some(), ..filter };
        let candidates: Vec<Candidate> = run.candidates(&light).into_iter().map(known).collect();
        match next(Order::Listed, Trend::Stays, &candidates, None) {
            Next::Done | Next::Wait(..) => break,
            Next::Sound(index) => {
                run.turn_to(index).await?;
                if !run.sound(index, &mut light).await? {
                    run.end(WINDOW_ENDED.to_owned());
                    break;
                }
            }
            Next::GiveUp(index, is_bright) => {
                let other = light.rate(index, context.clock().utc()).and_then(|rate| lamp.other(rate, &run.want));
                match other.filter(|_| changes < CHANGES) {
                    Some(brightness) => {
                        changes += 1;
                        lamp.now = brightness;
                        lamp.light(context).await?;
                        // Another brightness is another light.
                        (0..run.request.filters.len()).for_each(|filter| light.forget(filter));
                    }
                    None => {
                        changes = 0;
                        run.give_up(index, if is_bright { "the panel is too bright" } else { "the panel is too dark" });
                    }
                }
            }
            Next::Take(index, exposure_s) => {
                let exposure_s = to_ms(exposure_s);
                if !fits(context.clock().utc(), exposure_s, context.row.end) {
                    run.end(WINDOW_ENDED.to_owned());
                    break;
                }
                changes = 0;
                run.turn_to(index).await?;
                let frame = run.take(index, exposure_s).await?;
                let seen = run.judge(index, &frame).await?;
                light.see(index, &seen);
            }
        }
    }
    put_back(context).await
}

/// Closes the cover; returns it with its largest brightness.
async fn begin(context: &RowContext, brightness: Option<i64>) -> Result<(&Cover, i64), ActionError> {
    let camera = &context.row.camera;
    let impossible = |why: String| Err(ActionError::Impossible(format!("flats of {camera}: {why}")));
    let Some(cover) = context.tools.devices.cover_of(camera) else {
        return impossible("it has no covercalibrator; expected one in its block".to_owned());
    };
    let device = &cover.instrument.device;
    let can = cover.instrument.capabilities_with(&["MaxBrightness", "CoverState", "CalibratorState"]).await?;
    // Where the panel does not report it, it decides itself what it takes.
    let most = if can.max_brightness > 0 { can.max_brightness } else { brightness.unwrap_or(1).max(1) };
    if !can.calibrator {
        return impossible(format!("{device} has no panel"));
    }
    if let Some(brightness) = brightness.filter(|brightness| *brightness > most) {
        return impossible(format!("brightness {brightness}: {device} has at most {most}"));
    }
    context.set_panel(Some(FoundPanel { was_open: cover.cover() == Some(Shut::Open) }));
    if can.cover {
        context.step("closing the cover", TimedPart::Close);
        cover.close().await?;
    } else if context.tools.devices.domes.iter().any(|dome| dome.shutter() != Some(Shutter::Closed)) {
        return impossible(format!("{device} has no cover, and the dome is not closed: the sky would shine in"));
    }
    Ok((cover, most))
}

/// The lamp, as it is lit.
struct Lamp<'a> {
    cover: &'a Cover,
    most: i64,
    /// The row wants this brightness and no other.
    fixed: bool,
    now: i64,
}

impl Lamp<'_> {
    async fn light(&self, context: &RowContext) -> Result<(), ActionError> {
        context.step(format!("lighting the panel, brightness {} of {}", self.now, self.most), Lasts::Seconds(0.0));
        self.cover.light(self.now).await
    }

    /// The brightness that makes a good exposure of this rate, ADU per s, where it is another one.
    fn other(&self, rate: f64, want: &Want) -> Option<i64> {
        let other = brightness(self.now, self.most, rate, want);
        (!self.fixed && other != self.now).then_some(other)
    }
}

/// The brightness, 1 to `most`, that makes a good exposure where `now` gives this rate, ADU per s.
fn brightness(now: i64, most: i64, rate: f64, want: &Want) -> i64 {
    let good_s = GOOD_S.clamp(want.min_s, want.max_s);
    let wanted = now as f64 * (want.target_adu - want.bias_adu) / good_s / rate.max(1e-9);
    // `as` saturates.
    (wanted.round() as i64).clamp(1, most)
}

/// Darkens the panel, and opens the cover again if it was found open and the sky is safe; a cover that was found shut,
/// or is wanted shut by now, stays shut. Does nothing where no panel was used.
pub async fn put_back(context: &RowContext) -> Result<(), ActionError> {
    let Some(found) = context.take_panel() else { return Ok(()) };
    let (authority, devices) = (&context.tools.authority, &context.tools.devices);
    let Some(cover) = devices.cover_of(&context.row.camera) else { return Ok(()) };
    let dark = cover.darken().await;
    let may_open =
        authority.objection(None).is_none() && authority.is_safe() && authority.close_request.borrow().is_none();
    if found.was_open && may_open && dark.is_ok() {
        cover.open().await?;
    }
    dark
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_brightness_follows_what_is_missing_within_what_the_panel_has() {
        let want = Want { target_adu: 30_500.0, tolerance_adu: 6000.0, bias_adu: 500.0, min_s: 1.0, max_s: 60.0 };
        // 30000 ADU in 5 s are 6000 per s.
        for (now, rate, expected) in
            [(128, 6000.0, 128), (128, 96_000.0, 8), (10, 60.0, 255), (1, 1e9, 1), (9, 0.0, 255)]
        {
            assert_eq!(brightness(now, 255, rate, &want), expected, "{now} {rate}");
        }
        let short = Want { min_s: 0.1, max_s: 2.0, ..want };
        assert_eq!(brightness(100, 255, 6000.0, &short), 250);
    }
}
