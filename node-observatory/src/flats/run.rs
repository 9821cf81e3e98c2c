//! The frames of a row of flats: test frames that show how bright it is, flats that are judged, and the count for each
//! filter, also after a restart.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use contract::CommandId;
use contract::device::camera::Subframe;
use contract::observatory::RowState;
use schedule::RowId;
use schedule::action::parameters::FocusWanted as Focus;
use schedule::flats::exposure::{Level, Light, Seen, Want};
use schedule::flats::filter::{Filter, LOOKS, MAX_ADU, candidate, summary, to_ms};
use schedule::flats::order::{Candidate, Order};
use schedule::plan::TimedPart;
use schedule::shot::{Shot, fits};

use crate::action_error::ActionError;
use crate::devices::camera::subframe;
use crate::expected::Lasts;
use crate::exposing::{Series, adopt, aside, intend, single};
use crate::frames::looked::Looked;
use crate::journal::Journal;
use crate::pointing::look;
use crate::row_context::RowContext;

/// ASTRATYP of the frames that only show how bright it is.
const ACTION: &str = "flats_level";
/// IMAGETYP of a flat.
const FLAT: &str = "Flat Frame";
/// IMAGETYP of a frame that only shows how bright it is: a program that collects flats does not want a part of one.
const TEST: &str = "Test Frame";
/// Side of the part of the sensor that a look reads, binned px: enough for a median, and quickly read.
const PART_PX: u32 = 256;
/// So many frames of a filter in a row that do not count, and it is given up: something else than the light is wrong.
const REFUSED_MOST: u32 = 5;
/// A frame of before a restart that is not measured within this time has left the spool, machine time.
const LATE: Duration = Duration::from_secs(20);
/// Frames count as saturated from 0.9 of the largest value on; nobody aims so high.
const HIGHEST: f64 = 0.8;
/// A frame with more saturated pixels than this is no flat.
const SATURATED: f64 = 0.01;

/// What a row asks for.
#[derive(Debug, Clone)]
pub struct FlatsRequest {
    /// Filters, as listed.
    pub filters: Vec<Filter>,
    /// In which order they are taken.
    pub order: Order,
    /// The telescope is opened and moved, and looks at the sky.
    pub moves: bool,
    /// What all frames have in common.
    pub series: Series,
}

/// A row of flats under way.
pub struct FlatsRun<'a> {
    /// Its context.
    pub context: &'a RowContext,
    /// What is wanted of each frame.
    pub want: Want,
    /// What was asked for.
    pub request: FlatsRequest,
    part: Subframe,
    reported: Option<String>,
}

impl<'a> FlatsRun<'a> {
    /// Begins, or goes on where a restart found it: cold, with what counts of each filter, and what a good frame is.
    pub async fn begin(context: &'a RowContext, mut request: FlatsRequest) -> Result<Self, ActionError> {
        let camera = context.chain()?.camera;
        camera.start_cooling().await?;
        adopt(context, request.moves).await?;
        let can = camera.instrument.capabilities().await?;
        let (bin, whole) = (request.series.bin, request.series.subframe);
        let part = match whole {
            Some(within) => middle_of(&within),
            None => subframe(camera.sensor_px().await?, bin, (PART_PX, PART_PX), (0.5, 0.5)),
        };
        let config = camera.flats()?;
        let max_adu = can.max_adu.known().copied().unwrap_or(MAX_ADU);
        let want = Want::of(&config, max_adu);
        let target_adu = want.target_adu;
        if target_adu > HIGHEST * max_adu {
            return Err(ActionError::Impossible(format!(
                "flats.target_adu = {target_adu} of {}: the camera ends at {max_adu:.0} ADU; expected at most 0.8 of that",
                context.row.camera
            )));
        }
        request.series.open_sky = request.moves;
        let mut run = Self { context, want, request, part, reported: None };
        run.resume().await?;
        if run.is_done() {
            return Ok(run);
        }
        context.step("cooling", TimedPart::Cool);
        context.cool().await?;
        if config.bias_adu.is_none() {
            run.want.bias_adu = run.bias_adu().await?;
            if run.want.bias_adu >= target_adu {
                let (bias, camera) = (run.want.bias_adu, &context.row.camera);
                let why = format!("flats: {camera} has {bias:.0} ADU without light, and {target_adu:.0} are wanted");
                return Err(ActionError::Impossible(why));
            }
        }
        Ok(run)
    }

    /// Counts what was taken before a restart; a frame that nobody judged yet is judged now.
    async fn resume(&mut self) -> Result<(), ActionError> {
        let (tools, row) = (&self.context.tools, &self.context.row.id);
        for frame in tools.journal.flats(row).unjudged {
            self.context.step("judging a frame of before", Lasts::Seconds(LATE.as_secs_f64()));
            let looked = tokio::time::timeout(LATE, tools.frames.looks.of(&frame)).await.ok();
            let filter = looked.as_ref().and_then(|looked| looked.frame.purpose.filter.clone());
            let seen = looked.and_then(|looked| seen(&looked, false).ok());
            self.note(&frame, filter, seen.as_ref()).await?;
        }
        allot(&mut self.request.filters, tools.journal.flats(row).good);
        self.show();
        Ok(())
    }

    /// Whether nothing is wanted any more.
    pub fn is_done(&self) -> bool {
        !self.request.filters.iter().any(Filter::is_wanted)
    }

    /// What is known of each filter now.
    pub fn candidates(&self, light: &Light) -> Vec<Candidate> {
        let now = self.context.clock().utc();
        let each = self.request.filters.iter().enumerate();
        each.map(|(index, filter)| candidate(filter.is_wanted(), light, index, now)).collect()
    }

    /// Brings a filter into the beam, and the focus to where it belongs with it.
    pub async fn turn_to(&self, index: usize) -> Result<(), ActionError> {
        self.context.filter_and_focus(self.filter(index).as_deref(), Focus::default()).await
    }

    fn filter(&self, index: usize) -> Option<String> {
        self.request.filters.get(index).and_then(|filter| filter.name.clone())
    }

    /// Sees how bright a filter is, with as many looks as that takes, and learns it; false when the row ends before.
    pub async fn sound(&self, index: usize, light: &mut Light) -> Result<bool, ActionError> {
        let mut exposure_s = self.want.first_look_s(light.ready(index, self.context.clock().utc()));
        for _ in 0..LOOKS {
            exposure_s = to_ms(exposure_s);
            if !fits(self.context.clock().utc(), exposure_s, self.context.row.end) {
                return Ok(false);
            }
            let seen = self.look(index, exposure_s).await?;
            light.see(index, &seen);
            match self.want.sound_again_s(&seen) {
                Some(again_s) => exposure_s = again_s,
                None => break,
            }
        }
        Ok(true)
    }

    async fn look(&self, index: usize, exposure_s: f64) -> Result<Seen, ActionError> {
        let words = format!("how bright is {}: {exposure_s} s", self.words(index));
        self.aside(self.filter(index), exposure_s, words).await
    }

    /// Median without light. Its frame is small and none of the night's calibrations, so its type is not theirs.
    async fn bias_adu(&self) -> Result<f64, ActionError> {
        match self.aside(None, 0.0, "a bias frame".to_owned()).await?.level {
            Level::Adu(adu) => Ok(adu),
            Level::Saturated => Err(unmeasured(self.context, "a bias frame is saturated")?),
        }
    }

    async fn aside(&self, filter: Option<String>, exposure_s: f64, words: String) -> Result<Seen, ActionError> {
        let open_sky = self.request.moves && exposure_s > 0.0;
        let series = Series { filter, subframe: Some(self.part), open_sky, ..self.request.series.clone() };
        let shot = Shot { exposure_s, image_type: TEST, words };
        let frame = aside(self.context, &series, &shot, ACTION).await?;
        measured(self.context, &frame, true).await
    }

    /// Takes a frame of the row.
    pub async fn take(&self, index: usize, exposure_s: f64) -> Result<CommandId, ActionError> {
        let Some(filter) = self.request.filters.get(index) else { return Err(none(self.context)) };
        let words = format!("flat {} of {}, {}, {exposure_s} s", filter.taken + 1, filter.wanted, filter.words());
        let series = Series { filter: filter.name.clone(), ..self.request.series.clone() };
        let intent = intend(self.context).await?;
        let shot = Shot { exposure_s, image_type: FLAT, words };
        single(self.context, &series, &shot, &intent, true).await?;
        Ok(intent.frame)
    }

    /// Waits for what a frame shows, and counts it if it is good.
    pub async fn judge(&mut self, index: usize, frame: &CommandId) -> Result<Seen, ActionError> {
        let seen = measured(self.context, frame, false).await?;
        let counts = self.note(frame, self.filter(index), Some(&seen)).await?;
        let (context, want) = (self.context, self.want);
        if let Some(filter) = self.request.filters.get_mut(index) {
            filter.refused = if counts { 0 } else { filter.refused + 1 };
            filter.taken += u32::from(counts);
            if !counts {
                let (target_adu, within_adu) = (want.target_adu.round(), want.tolerance_adu.round());
                let (name, level) = (filter.words(), seen.level);
                tracing::warn!(%frame, filter = name, ?level, target_adu, within_adu, "a flat does not count");
            }
            if filter.refused >= REFUSED_MOST {
                filter.given_up = Some("its level does not hold");
                tracing::warn!(
                    row = RowState::told(context.index),
                    filter = filter.words(),
                    "given up: its level does not hold"
                );
            }
        }
        self.show();
        Ok(seen)
    }

    /// Records whether a frame counts, and reports it to the archives when it does not.
    async fn note(&self, frame: &CommandId, filter: Option<String>, seen: Option<&Seen>) -> Result<bool, ActionError> {
        let counts = seen.is_some_and(|seen| self.want.accepts(seen.level));
        let level_adu = seen.and_then(|seen| match seen.level {
            Level::Adu(adu) => Some((10.0 * adu).round() / 10.0),
            Level::Saturated => None,
        });
        let id = frame.clone();
        let judged =
            move |journal: &Journal, row: &RowId, now| journal.judged(row, &id, filter, level_adu, counts, now);
        self.context.write(judged).await?;
        if !counts {
            let Want { target_adu, tolerance_adu, .. } = self.want;
            let found = match seen.map(|seen| seen.level) {
                Some(Level::Adu(adu)) => format!("{adu:.0} ADU"),
                Some(Level::Saturated) => "saturated".to_owned(),
                None => "not measured".to_owned(),
            };
            let why = format!("flat: {found}, expected {target_adu:.0} within {tolerance_adu:.0} ADU");
            if let Err(error) =
                self.context.tools.frames.facts.publish_refused(&self.context.tools.authority.node, frame, why).await
            {
                tracing::warn!(%frame, %error, "the reason why a frame does not count could not be published");
            }
        }
        Ok(counts)
    }

    /// Takes no more of a filter.
    pub fn give_up(&mut self, index: usize, why: &'static str) {
        if let Some(filter) = self.request.filters.get_mut(index) {
            self.context.step(format!("no flats of {} any more: {why}", filter.words()), Lasts::Unbounded);
            filter.given_up = Some(why);
        }
    }

    /// Notes why the row ends before all is taken.
    pub fn end(&mut self, why: String) {
        self.reported = Some(why);
    }

    /// A filter in words.
    pub fn words(&self, index: usize) -> String {
        self.request.filters.get(index).map(Filter::words).unwrap_or_default()
    }

    /// How it went: nothing where all was taken.
    pub fn summary(&self) -> String {
        summary(&self.request.filters, self.reported.as_deref())
    }

    fn show(&self) {
        let taken = self.context.tools.journal.progress(&self.context.row.id).taken;
        self.context.tools.night.row(self.context.index, |row| row.frames = taken);
    }
}

/// The middle of a part, no larger than a look needs.
fn middle_of(part: &Subframe) -> Subframe {
    let along = |start: u32, size: u32| {
        let inner = size.min(PART_PX);
        (start + (size - inner) / 2, inner)
    };
    let ((x_px, width_px), (y_px, height_px)) = (along(part.x_px, part.width_px), along(part.y_px, part.height_px));
    Subframe { x_px, y_px, width_px, height_px }
}

/// Gives each filter what counts of it; one that is listed twice gets the first frames first, and a row that names none
/// gets all.
fn allot(filters: &mut [Filter], mut good: BTreeMap<String, u32>) {
    let all = good.values().sum();
    for filter in filters {
        match &filter.name {
            Some(name) => {
                let left = good.entry(name.clone()).or_default();
                filter.taken = filter.wanted.min(*left);
                *left -= filter.taken;
            }
            None => filter.taken = filter.wanted.min(all),
        }
    }
}

/// How bright a frame of now is.
async fn measured(context: &RowContext, frame: &CommandId, is_part: bool) -> Result<Seen, ActionError> {
    let looked: Option<Arc<Looked>> = look(context, frame).await;
    let answer = looked.ok_or_else(|| "it was not looked at within 60 s".to_owned());
    match answer.and_then(|looked| seen(&looked, is_part)) {
        Ok(seen) => Ok(seen),
        Err(why) => Err(unmeasured(context, &why)?),
    }
}

/// How bright a frame is, by its facts.
fn seen(looked: &Looked, is_part: bool) -> Result<Seen, String> {
    let (frame, facts) = (&looked.frame, &looked.facts);
    let level = match (facts.sky_adu, facts.saturated_fraction) {
        (_, Some(share)) if share > SATURATED => Level::Saturated,
        (Some(adu), _) => Level::Adu(adu),
        (None, _) => return Err(facts.reason.clone().unwrap_or_else(|| "it has no level".to_owned())),
    };
    Ok(Seen { started: frame.started_utc, exposure_s: frame.exposure_s, level, is_part })
}

fn unmeasured(context: &RowContext, why: &str) -> Result<ActionError, ActionError> {
    let device = context.chain()?.camera.instrument.device.to_string();
    Ok(ActionError::Failed { device, verb: "show how bright it is".to_owned(), reason: why.to_owned() })
}

fn none(context: &RowContext) -> ActionError {
    ActionError::Impossible(format!("row {} has no such filter", RowState::told(context.index)))
}

#[cfg(test)]
mod tests {
    use contract::observatory::FrameFacts;

    use super::*;
    use crate::frames::tests::frame;

    #[test]
    fn what_counts_of_a_filter_is_allotted_in_the_order_of_the_list() {
        let filter = |name: &str, n| Filter::new(Some(name.to_owned()), n);
        let mut filters = [filter("R", 3), filter("B", 2), filter("R", 3)];
        let good = BTreeMap::from([("R", 4), ("B", 1)].map(|(name, n)| (name.to_owned(), n)));
        allot(&mut filters, good.clone());
        assert_eq!(filters.map(|filter| filter.taken), [3, 1, 1]);
        let mut unnamed = [Filter::new(None, 9)];
        allot(&mut unnamed, good);
        assert_eq!(unnamed[0].taken, 5);
    }

    #[test]
    fn a_frame_gives_its_level_or_the_reason() {
        let look = |sky_adu, saturated_fraction, reason: Option<&str>| {
            let facts =
                FrameFacts { sky_adu, saturated_fraction, reason: reason.map(str::to_owned), ..Default::default() };
            seen(&Looked { frame: frame("f"), facts, measured: None, solved: None }, false).map(|seen| seen.level)
        };
        assert_eq!(look(Some(20_000.0), Some(0.0001), None), Ok(Level::Adu(20_000.0)));
        assert_eq!(look(Some(20_000.0), Some(0.2), None), Ok(Level::Saturated));
        assert_eq!(look(None, Some(1.0), Some("no usable sky")), Ok(Level::Saturated));
        assert_eq!(look(None, None, Some("not fetched")), Err("not fetched".to_owned()));
    }

    #[test]
    fn a_look_reads_the_middle_of_what_the_row_reads() {
        let part = Subframe { x_px: 100, y_px: 200, width_px: 1000, height_px: 50 };
        assert_eq!(middle_of(&part), Subframe { x_px: 472, y_px: 200, width_px: 256, height_px: 50 });
    }
}
