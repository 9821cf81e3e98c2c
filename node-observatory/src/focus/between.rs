//! The focus of a row that is under way: it follows the temperature, and is found anew where the stars grow wide.

use contract::observatory::{AlertKind, FocusOutcome, TriggerKind};
use imaging::focus::sweep::Plan;
use schedule::action::parameters::FocusWanted;
use schedule::focus_meter::Meter;
use schedule::shot::Shot;
use units::Utc;

use super::FocusData;
use super::run::{FocusRequest, find};
use crate::action_error::ActionError;
use crate::devices::focuser::Focuser;
use crate::expected::Lasts;
use crate::exposing::{Series, expose_with};
use crate::row_context::RowContext;

/// Of the travel, where nothing is known of the critical zone.
const SHARE_OF_TRAVEL: i64 = 50;
/// A run looks so many critical zones to either side (`imaging::focus::sweep`).
const ZONES: f64 = 4.0;
/// The least that a run looks to either side, steps.
const LEAST_STEPS: i64 = 10;

/// Takes frames as [`exposing::expose`](crate::exposing::expose) does, and looks after the focus between them.
pub async fn expose_in_focus(
    context: &RowContext,
    focus: &FocusData,
    series: &Series,
    next: impl FnMut(u32, Utc) -> Option<Shot> + Send,
) -> Result<u32, ActionError> {
    expose_with(context, series, || Box::pin(between_frames(context, focus, series)), next).await
}

/// Looks after the focus of a series between two of its frames; nothing where it asks for nothing.
async fn between_frames(context: &RowContext, focus: &FocusData, series: &Series) -> Result<(), ActionError> {
    let (Some(wanted), Some(focuser)) = (series.focus, context.chain()?.focuser) else { return Ok(()) };
    let wanted =
        FocusWanted { filter_offset: offset(context, series, focuser).map_or(0, |(_, offset, _)| offset), ..wanted };
    if wants_a_run(context, focus, series, wanted) {
        return refocus(context, focus, series, focuser).await;
    }
    follow_temperature(context, focus, focuser, wanted).await;
    Ok(())
}

/// The filter that the row named, its offset, and its offset by the wheel, steps.
pub fn offset(context: &RowContext, series: &Series, focuser: &Focuser) -> Option<(String, i64, i64)> {
    let filter = series.filter.as_ref()?;
    let of_wheel = context.chain().ok()?.wheel?.offset_of(filter)?;
    Some((filter.clone(), focuser.offset(filter, of_wheel), of_wheel))
}

/// How far a run looks to either side, steps: as configured, else by what the last run showed, else a share of the
/// travel.
pub fn half_range(focus: &FocusData, focuser: &Focuser, max_step: i64) -> i64 {
    search_range(focuser.config.search_steps, focus.learned.get().critical_zone(focuser.name()), max_step)
}

fn search_range(configured: Option<i64>, zone: Option<f64>, max_step: i64) -> i64 {
    // `as` saturates.
    let by_zone = zone.filter(|zone| zone.is_finite()).map(|zone| (ZONES * zone).ceil() as i64);
    let steps = configured.or(by_zone).unwrap_or(max_step / SHARE_OF_TRAVEL);
    steps.clamp(LEAST_STEPS, max_step.max(LEAST_STEPS))
}

/// A plan about a position, with the focuser's own play and side.
pub fn plan(focuser: &Focuser, start: i64, centre: i64, half_range: i64, max_step: i64) -> Plan {
    // Saturates; ASCOM's positions are 32 bits wide.
    let steps = |steps: i64| i32::try_from(steps).unwrap_or(i32::MAX);
    Plan {
        start: steps(start),
        backlash: steps(focuser.config.backlash_steps),
        approach: match focuser.config.approach {
            config::Approach::Upward => imaging::focus::sweep::ApproachSide::Upward,
            config::Approach::Downward => imaging::focus::sweep::ApproachSide::Downward,
        },
        ..Plan::about(steps(centre), steps(half_range), 0..=steps(max_step))
    }
}

/// Do the stars of this row grow wide, and may that be helped by a run? Not where the row wants them wide.
fn wants_a_run(context: &RowContext, focus: &FocusData, series: &Series, wanted: FocusWanted) -> bool {
    let focusing = &context.tools.authority.node.config.focusing;
    let is_sharp = wanted.position.is_none() && wanted.shift.unwrap_or(0) == 0;
    if focusing.on_drift != config::OnDrift::Refocus || !is_sharp {
        return false;
    }
    let camera = context.row.camera.as_str();
    let filter = series.filter.clone().or_else(|| context.chain().ok()?.wheel?.filter());
    let Some(since) = context.tools.night.trigger(TriggerKind::FocusDrift, camera, filter.as_deref()) else {
        return false;
    };
    let published = focus.state.borrow();
    let last = published.run.as_ref().filter(|run| run.camera == camera);
    let last = last.and_then(|run| Some((run.ended_utc?, run.outcome == FocusOutcome::Focused)));
    is_due(last, since, context.clock().utc(), focusing.refocus_after_min)
}

/// Whether the focus is to be found anew because the stars are wide since an instant. Where the last run found it,
/// stars that were wide before the run prove nothing, and stars that stay wide are seeing; one that failed is tried
/// again.
fn is_due(last: Option<(Utc, bool)>, wide_since: Utc, now: Utc, rest_min: f64) -> bool {
    last.is_none_or(|(ended, found)| {
        let rested = now.seconds_since(ended) >= 60.0 * rest_min;
        rested && (!found || wide_since > ended)
    })
}

/// Finds the focus where the telescope looks. A run that fails leaves the focus as it was, and the row goes on.
async fn refocus(
    context: &RowContext,
    focus: &FocusData,
    series: &Series,
    focuser: &Focuser,
) -> Result<(), ActionError> {
    let can = focuser.instrument.capabilities().await?;
    let Some(start) = focuser.position() else { return Ok(()) };
    let travel = Focuser::travel(&can, start);
    context.step("the stars grow wide: focusing", Lasts::Seconds(0.0));
    let request = FocusRequest {
        plan: plan(focuser, start, start, half_range(focus, focuser, travel), travel),
        meter: Meter { operator: None, least_snr: 10.0, others: Vec::new(), looks_for_saturation: false },
        exposure_s: context.tools.authority.node.config.focusing.refocus_exposure_s,
        frames: (1, 1),
        reduce_exposure: false,
        expected_px: None,
        filter: offset(context, series, focuser),
        keep: true,
        counts: false,
    };
    let frames = Series { action: Some("autofocus"), focus: None, object: None, subframe: None, ..series.clone() };
    let run = find(context, focus, &frames, focuser, &request).await?;
    publish_run(context, &run);
    Ok(())
}

/// Keeps an alert active while the last run of a camera failed.
pub fn publish_run(context: &RowContext, run: &contract::observatory::FocusRun) {
    let (alerts, camera) = (&context.tools.authority.node.alerts, &context.row.camera);
    match run.outcome {
        FocusOutcome::Failed => {
            let reason = run.reason.as_deref().unwrap_or_default();
            alerts.raise(AlertKind::FocusFailed, camera, &format!("the focus of {camera} was not found: {reason}"));
        }
        FocusOutcome::Focused | FocusOutcome::Running => alerts.clear(AlertKind::FocusFailed, camera),
    }
}

/// Moves the focuser for the temperature, if the model is known and the move is more than a trifle. A failure is
/// reported: the row goes on at the present focus.
async fn follow_temperature(context: &RowContext, focus: &FocusData, focuser: &Focuser, wanted: FocusWanted) {
    let learned = focus.learned.get();
    let (Some(zone), true) = (learned.critical_zone(focuser.name()), learned.model(focuser.name()).is_some()) else {
        return;
    };
    let (Some(position), Ok(target)) = (focuser.position(), focuser.target(wanted)) else { return };
    let least = context.tools.authority.node.config.focusing.follow_share * zone;
    let off = position.abs_diff(target);
    if wanted.position.is_some() || (off as f64) < least || off <= focuser.config.tolerance_steps.unsigned_abs() {
        return;
    }
    tracing::info!(
        from = position,
        to = target,
        temperature_c = focuser.temperature_c(),
        "the focus follows the temperature"
    );
    if let Err(error) = focuser.focus(wanted).await {
        tracing::warn!(%error, "the focus does not follow the temperature");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_focus_is_found_anew_when_stars_grow_wide_after_a_run_and_again_after_one_that_failed() {
        let at = |min: f64| Utc::from_seconds(1.8e9 + 60.0 * min);
        let due = |last, since, now| is_due(last, at(since), at(now), 30.0);
        assert!(due(None, 0.0, 1.0));
        assert!(!due(Some((at(0.0), true)), 5.0, 29.0), "not so soon");
        assert!(due(Some((at(0.0), true)), 5.0, 30.0));
        assert!(!due(Some((at(6.0), true)), 5.0, 300.0), "wide before the run and ever since: that is the seeing");
        assert!(!due(Some((at(6.0), false)), 5.0, 35.0));
        assert!(due(Some((at(6.0), false)), 5.0, 36.0), "clouds have gone, perhaps");
    }

    #[test]
    fn a_run_looks_as_far_as_configured_or_as_the_last_one_taught() {
        assert_eq!(search_range(Some(300), Some(120.0), 50_000), 300);
        assert_eq!(search_range(None, Some(120.3), 50_000), 482);
        assert_eq!(search_range(None, None, 50_000), 1000);
        assert_eq!(search_range(None, Some(f64::NAN), 50_000), 1000);
        assert_eq!(search_range(None, Some(1e30), 50_000), 50_000, "no further than its travel");
        assert_eq!(search_range(Some(3), None, 50_000), LEAST_STEPS);
        assert_eq!(search_range(None, None, 5), LEAST_STEPS);
    }
}
