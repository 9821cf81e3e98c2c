//! A focus run on real devices: moves, frames and values, as the sweep asks for them.

use std::time::Duration;

use contract::CommandId;
use contract::observatory::{FocusOutcome, FocusRun};
use imaging::focus::sweep::{FocusFit, FocusStep, Pass, Plan, Sweep};
use imaging::quality::Estimate;
use schedule::focus_meter::Meter;
use schedule::shot::{Shot, fits};
use units::seconds;

use super::FocusData;
use super::meter::{Read, measure, together};
use super::published_run::{About, PublishedRun};
use crate::action_error::ActionError;
use crate::command_timeout::command_timeout;
use crate::devices::focuser::Focuser;
use crate::expected::Lasts;
use crate::exposing::{Series, intend, single};
use crate::frames::looked::caught;
use crate::frames::stepped_back;
use crate::row_context::RowContext;

/// Pixels are here so long after the exposure, or the frame counts as one without stars; machine time.
const PIXELS: Duration = Duration::from_secs(60);
/// Times an exposure is halved because stars are saturated, and the shortest that results, s.
const HALVINGS: u32 = 5;
const SHORTEST_S: f64 = 0.1;
/// Machine time that two looks at the pixels are apart when a frame is known but its pixels were missed.
const READOUT_S: f64 = 120.0;

/// What is asked of a run.
#[derive(Debug, Clone)]
pub struct FocusRequest {
    /// Where to look.
    pub plan: Plan,
    /// How frames are measured.
    pub meter: Meter,
    /// Exposure time, s.
    pub exposure_s: f64,
    /// Frames at each of the first positions, and at each of the others.
    pub frames: (u32, u32),
    /// Exposures are halved while stars are saturated.
    pub reduce_exposure: bool,
    /// Size of the stars at the begin, px, where it is known.
    pub expected_px: Option<f64>,
    /// Filter that the row named, its offset, and its offset by the wheel, steps.
    pub filter: Option<(String, i64, i64)>,
    /// Whether rows take the position that was found from now on.
    pub keep: bool,
    /// Whether the frames are those that the row was asked for.
    pub counts: bool,
}

/// Runs until the focus is found and verified, or surely is not; the focuser is then there, or back where it was.
///
/// After a run that is dropped or fails, [`action::settle`](crate::action::settle) brings the focuser back.
pub async fn find(
    context: &RowContext,
    focus: &FocusData,
    series: &Series,
    focuser: &Focuser,
    request: &FocusRequest,
) -> Result<FocusRun, ActionError> {
    let mut sweep =
        Sweep::new(request.plan.clone()).map_err(|bad| ActionError::Impossible(format!("focus run: {bad}")))?;
    context.set_focus_before(Some(i64::from(request.plan.start)));
    let mut published = PublishedRun::begin(focus, context.clock(), begun(context, series, focuser, request)?);
    let mut camera = Lens { context, series, request, exposure_s: request.exposure_s, halvings: 0 };
    let mut expected_px = request.expected_px;
    let outcome = loop {
        match sweep.next() {
            FocusStep::Move(position) => {
                context.small_step(format!("focusing: to {position} steps"), Lasts::Seconds(0.0));
                focuser.go(i64::from(position)).await?;
            }
            FocusStep::Expose(pass) => {
                let count = if pass == Pass::Coarse { request.frames.0 } else { request.frames.1 };
                if !fits(context.clock().utc(), camera.exposure_s * f64::from(count), context.row.end) {
                    sweep.end("the row's window is over");
                    continue;
                }
                let words = words(&sweep, pass);
                let (value, about) = camera.look(focuser, count, &words, expected_px).await?;
                // It was asked for just now.
                let _ = sweep.measured(value);
                expected_px = expected(&sweep).or(value.map(|value| value.value)).or(expected_px);
                published.measured(&sweep, about);
            }
            FocusStep::Done(outcome) => break outcome,
        }
    };
    context.set_focus_before(None);
    Ok(match outcome {
        Ok(focused) => published.focused(&focused, request.keep),
        Err(failed) => published.failed(failed.reason.to_string()),
    })
}

fn words(sweep: &Sweep, pass: Pass) -> String {
    let pass = match pass {
        Pass::Coarse => "first look",
        Pass::Fine => "closer look",
        Pass::Verification => "verifying",
    };
    format!("focusing: {pass}, position {}", sweep.points().len() + 1)
}

/// Size of the stars where the curve is best, px: what a search may begin with; only sizes have one.
fn expected(sweep: &Sweep) -> Option<f64> {
    let last = sweep.points().last()?;
    match sweep.fit()? {
        FocusFit::Hyperbola(curve) => Some(curve.size_at(f64::from(last.position))),
        FocusFit::Smoothed { .. } => None,
    }
}

fn begun(
    context: &RowContext,
    series: &Series,
    focuser: &Focuser,
    request: &FocusRequest,
) -> Result<FocusRun, ActionError> {
    let now = context.clock().utc();
    let place = series.target_deg.map(|(ra_deg, dec_deg)| sky::Icrs::from_degrees(ra_deg, dec_deg));
    let altitude =
        place.map(|place| context.observer(now).map(|sky| sky.to_horizontal(&place).altitude)).transpose()?;
    let (filter, offsets) = match &request.filter {
        Some((filter, offset, of_wheel)) => (Some(filter.clone()), (*offset, Some(*of_wheel))),
        None => (None, (0, None)),
    };
    Ok(FocusRun {
        id: CommandId::fresh(),
        camera: context.row.camera.to_string(),
        focuser: focuser.name().to_owned(),
        filter,
        filter_offset: offsets.0,
        wheel_offset: offsets.1,
        night: context.night().to_string(),
        started_utc: now,
        ended_utc: None,
        outcome: FocusOutcome::Running,
        reason: None,
        start_position: i64::from(request.plan.start),
        best_position: None,
        best_position_error: None,
        stored_position: None,
        critical_zone: None,
        verified: None,
        operator: request.meter.name().to_owned(),
        value_label: request.meter.label().to_owned(),
        temperature_c: focuser.temperature_c(),
        altitude_deg: altitude.map(|altitude| altitude.degrees()),
        points: Vec::new(),
        curve: None,
    })
}

/// Takes and measures the frames of a run.
struct Lens<'a> {
    context: &'a RowContext,
    series: &'a Series,
    request: &'a FocusRequest,
    exposure_s: f64,
    halvings: u32,
}

impl Lens<'_> {
    /// What so many frames at one position show together.
    async fn look(
        &mut self,
        focuser: &Focuser,
        count: u32,
        words: &str,
        expected_px: Option<f64>,
    ) -> Result<(Option<Estimate>, About), ActionError> {
        let (mut about, mut values) = (About::default(), Vec::new());
        for _ in 0..count.max(1) {
            let read = loop {
                let (frame, read) = self.frame(words, expected_px).await?;
                about.frames.push(frame);
                // No shorter than the camera can.
                let can = self.context.chain()?.camera.instrument.can();
                let shortest_s = can.and_then(|can| can.exposure_min_s).unwrap_or(0.0).max(SHORTEST_S);
                let may_halve =
                    self.request.reduce_exposure && self.halvings < HALVINGS && self.exposure_s > shortest_s;
                if !(read.saturated && may_halve) {
                    break read;
                }
                self.halvings += 1;
                self.exposure_s = (0.5 * self.exposure_s).max(shortest_s);
                tracing::info!(exposure_s = self.exposure_s, "stars are saturated: focusing with shorter exposures");
            };
            values.extend(read.value);
            about.read = read;
        }
        about.temperature_c = focuser.temperature_c();
        Ok((together(&values), about))
    }

    /// Takes one frame and measures it.
    async fn frame(&self, words: &str, expected_px: Option<f64>) -> Result<(CommandId, Read), ActionError> {
        let looks = &self.context.tools.frames.looks;
        let mut pixels = looks.follow_pixels();
        let intent = intend(self.context).await?;
        let words = format!("{words}, {} s", self.exposure_s);
        let shot = Shot { exposure_s: self.exposure_s, image_type: "Light Frame", words };
        let most = command_timeout(self.context.clock(), seconds(self.exposure_s + READOUT_S)) + PIXELS;
        let taking = single(self.context, self.series, &shot, &intent, self.request.counts);
        let catching = async {
            let caught = tokio::time::timeout(most, caught(&mut pixels, &intent.frame)).await;
            Ok(caught.ok().flatten())
        };
        let missed = async {
            // Once the frame was looked at, its pixels have been fetched, or never will be.
            let looked = looks.of(&intent.frame).await;
            looked.facts.reason.clone()
        };
        let catching = async {
            tokio::select! {
                biased;
                fetched = catching => fetched,
                reason = missed => {
                    tracing::debug!(frame = %intent.frame, reason, "the pixels of a focus frame were missed");
                    Ok(None)
                }
            }
        };
        let ((), fetched) = tokio::try_join!(taking, catching)?;
        let Some(fetched) = fetched else {
            return Ok((intent.frame, Read::nothing("the frame's pixels did not arrive".to_owned())));
        };
        let meter = self.request.meter.clone();
        let read = stepped_back(move || measure(&meter, &fetched, expected_px)).await;
        Ok((intent.frame, read.unwrap_or_else(Read::nothing)))
    }
}
