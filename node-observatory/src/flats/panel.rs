//! Flats of a lit panel: the cover closed, its lamp on, and both left as they should be, whatever happens.

use contract::device::cover_calibrator::Cover as Shut;
use contract::device::dome::Shutter;

use super::run::Run;
use crate::action::Stage;
use crate::rig::cover_calibrator::Cover;
use crate::trouble::Trouble;
use schedule::flats::exposure::{Light, Want};
use schedule::flats::filter::{GOOD_S, WINDOW_ENDED, to_ms};
use schedule::flats::order::{Candidate, Next, Order, Trend, next};
use schedule::shot::fits;

/// How a panel was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Found {
    was_open: bool,
}

/// Changes of the brightness for one filter, at most.
const CHANGES: u32 = 4;

/// Takes the flats of a row with a panel; the row names its brightness, or it is found.
pub async fn run(run: &mut Run<'_>, brightness: Option<i64>) -> Result<(), Trouble> {
    let stage = run.stage;
    let (cover, most) = begin(stage, brightness).await?;
    let mut lamp = Lamp { cover, most, fixed: brightness.is_some(), now: brightness.unwrap_or((most / 2).max(1)) };
    lamp.light(stage).await?;
    let mut light = Light::new(run.want, run.wish.filters.len(), 0.0);
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
                let other = light.rate(index, stage.clock().utc()).and_then(|rate| lamp.other(rate, &run.want));
                match other.filter(|_| changes < CHANGES) {
                    Some(brightness) => {
                        changes += 1;
                        lamp.now = brightness;
                        lamp.light(stage).await?;
                        // Another brightness is another light.
                        (0..run.wish.filters.len()).for_each(|filter| light.forget(filter));
                    }
                    None => {
                        changes = 0;
                        run.give_up(index, if is_bright { "the panel is too bright" } else { "the panel is too dark" });
                    }
                }
            }
            Next::Take(index, exposure_s) => {
                let exposure_s = to_ms(exposure_s);
                if !fits(stage.clock().utc(), exposure_s, stage.row.end) {
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
    put_back(stage).await
}

/// Closes the cover; returns it with its largest brightness.
async fn begin(stage: &Stage, brightness: Option<i64>) -> Result<(&Cover, i64), Trouble> {
    let camera = &stage.row.camera;
    let impossible = |why: String| Err(Trouble::Impossible(format!("flats of {camera}: {why}")));
    let Some(cover) = stage.room.rig.cover_of(camera) else {
        return impossible("it has no covercalibrator; expected one in its block".to_owned());
    };
    let (device, can) = (&cover.instrument.device, cover.instrument.capabilities().await?);
    let most = can.max_brightness.max(1);
    if !can.calibrator {
        return impossible(format!("{device} has no panel"));
    }
    if let Some(brightness) = brightness.filter(|brightness| *brightness > most) {
        return impossible(format!("brightness {brightness}: {device} has at most {most}"));
    }
    stage.set_panel(Some(Found { was_open: cover.cover() == Some(Shut::Open) }));
    if can.cover {
        stage.step("closing the cover");
        cover.close().await?;
    } else if stage.room.rig.domes.iter().any(|dome| dome.shutter() != Some(Shutter::Closed)) {
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
    async fn light(&self, stage: &Stage) -> Result<(), Trouble> {
        stage.step(format!("lighting the panel, brightness {} of {}", self.now, self.most));
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
pub async fn put_back(stage: &Stage) -> Result<(), Trouble> {
    let Some(found) = stage.take_panel() else { return Ok(()) };
    let room = &stage.room;
    let Some(cover) = room.rig.cover_of(&stage.row.camera) else { return Ok(()) };
    let dark = cover.darken().await;
    let may_open = room.objection(None).is_none() && room.is_safe() && room.wish_closed.borrow().is_none();
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
