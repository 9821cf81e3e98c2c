//! The learned state of each focuser: the best position, how it follows the temperature, the offsets of filters.
//!
//! It survives a restart (`focus-TELESCOPE.json` in the data folder). A standby takes over what the commander
//! publishes.

use std::collections::BTreeMap;

use contract::Part;
use contract::observatory::{AlertKind, FocusFound as Found, FocusLearned, FocusOutcome, FocusRun};
use imaging::focus::correction::{PastRun, TemperatureModel, without_offset};
use imaging::quality::Estimate;
use serde::{Deserialize, Serialize};
use units::Celsius;

use crate::persisted::replaced;
use crate::replicated::Replicate;

/// Runs that are remembered of a focuser, the newest.
const REMEMBERED: usize = 200;
/// Runs through two filters this near in time are compared, sky s: the seeing may change, the tube hardly does.
const NEAR_S: f64 = 2.0 * 3600.0;
/// Fewest pairs of runs that give an offset.
const PAIRS: usize = 2;
/// The wheel's offset is replaced by the learned one when they differ by so many standard errors.
const SURELY: f64 = 3.0;
/// Differences further than so many standard errors from their median teach nothing.
const FAR: f64 = 4.0;
/// Runs that give the critical zone.
const ZONES: usize = 5;
/// Standard error of a run that knows none, steps.
const USUAL_ERROR: f64 = 10.0;

/// The learned state of the focus; the file and the payload are the same.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LearnedFocus(FocusLearned);

impl Replicate for LearnedFocus {
    type Payload = FocusLearned;
    const PART: Part = Part::FocusLearned;
    const FILE: &'static str = "focus";
    const WHAT: &'static str = "what is known of the focus";
    const NOT_SAVED: AlertKind = AlertKind::FocusNotSaved;

    fn put_in(&self, payload: &mut FocusLearned) -> bool {
        replaced(payload, &self.0)
    }

    fn adopt(&mut self, payload: FocusLearned) -> bool {
        !payload.focusers.is_empty() && replaced(&mut self.0, &payload)
    }
}

impl LearnedFocus {
    /// Learns from a run that found a focus and is to be kept; false where there is nothing new.
    pub fn learn(&mut self, run: &FocusRun) -> bool {
        let (FocusOutcome::Focused, Some(position), Some(_)) = (run.outcome, run.best_position, run.stored_position)
        else {
            return false;
        };
        let runs = self.0.focusers.entry(run.focuser.clone()).or_default();
        if runs.iter().any(|known| known.id == run.id.0) {
            return false;
        }
        runs.push(Found {
            id: run.id.0.clone(),
            at_utc: run.ended_utc.unwrap_or(run.started_utc),
            filter: run.filter.clone(),
            wheel_offset: run.wheel_offset.unwrap_or(0),
            position,
            error: run.best_position_error,
            critical_zone: run.critical_zone,
            temperature_c: run.temperature_c,
            altitude_deg: run.altitude_deg,
        });
        runs.sort_by_key(|run| run.at_utc);
        runs.drain(..runs.len().saturating_sub(REMEMBERED));
        true
    }

    /// Runs of a focuser that are remembered, in order of time.
    pub fn runs(&self, focuser: &str) -> &[Found] {
        self.0.focusers.get(focuser).map_or(&[], Vec::as_slice)
    }

    /// The best position without a filter's offset at a temperature, steps: where the newest run found it, moved as the
    /// temperature asks once that is known.
    pub fn best(&self, focuser: &str, temperature_c: Option<f64>) -> Option<f64> {
        let newest = self.runs(focuser).last()?;
        let moved = match (self.model(focuser), newest.temperature_c, temperature_c) {
            (Some(model), Some(then_c), Some(now_c)) => model.steps(Celsius::new(then_c), Celsius::new(now_c)),
            _ => 0.0,
        };
        Some(self.base(focuser, newest) + moved)
    }

    /// Half width of the bottom of the curve, steps: the median of the last runs, so that no single one decides.
    pub fn critical_zone(&self, focuser: &str) -> Option<f64> {
        let zones = self.runs(focuser).iter().rev().filter_map(|run| run.critical_zone);
        median(zones.filter(|zone| zone.is_finite() && *zone > 0.0).take(ZONES).collect())
    }

    /// How the best position follows the temperature, once enough runs prove that it does.
    pub fn model(&self, focuser: &str) -> Option<TemperatureModel> {
        let past = |run: &Found| {
            let temperature = Celsius::new(run.temperature_c?);
            let position_error = run.error.unwrap_or(f64::NAN);
            Some(PastRun { temperature, position: self.base(focuser, run), position_error })
        };
        let runs: Vec<PastRun> = self.runs(focuser).iter().filter_map(past).collect();
        TemperatureModel::fit(&runs).ok().filter(TemperatureModel::is_proven)
    }

    /// Offset of a filter, steps. The runs through it and through the filter of most runs give it, if they surely
    /// differ from the wheel's value; else the wheel gives it.
    pub fn offset(&self, focuser: &str, filter: &str, wheel_offset: i64) -> i64 {
        let Some((reference, reference_offset)) = self.reference(focuser).filter(|(name, _)| name != filter) else {
            return wheel_offset;
        };
        let Some(learned) = self.difference(focuser, filter, &reference) else { return wheel_offset };
        let offset = learned.value + reference_offset as f64;
        if (offset - wheel_offset as f64).abs() > SURELY * learned.error { offset.round() as i64 } else { wheel_offset }
    }

    /// A run's position without its filter's offset.
    fn base(&self, focuser: &str, run: &Found) -> f64 {
        let offset = run.filter.as_ref().map_or(0, |filter| self.offset(focuser, filter, run.wheel_offset));
        without_offset(run.position, offset as f64)
    }

    /// The filter of most runs, and its offset by the wheel.
    fn reference(&self, focuser: &str) -> Option<(String, i64)> {
        let mut counts: BTreeMap<&str, (usize, i64)> = BTreeMap::new();
        for run in self.runs(focuser) {
            if let Some(filter) = &run.filter {
                let count = counts.entry(filter).or_default();
                *count = (count.0 + 1, run.wheel_offset);
            }
        }
        let most = counts.into_iter().rev().max_by_key(|(_, (count, _))| *count);
        most.map(|(filter, (_, offset))| (filter.to_owned(), offset))
    }

    /// How much further out a filter focuses than another, from runs that followed one another, steps.
    fn difference(&self, focuser: &str, filter: &str, reference: &str) -> Option<Estimate> {
        let runs = self.runs(focuser);
        let through =
            |name: &str| runs.iter().filter(move |run| run.filter.as_deref() == Some(name)).collect::<Vec<_>>();
        let references = through(reference);
        // Difference and its variance.
        let mut pairs: Vec<(f64, f64)> = Vec::new();
        for run in through(filter) {
            let apart_s = |other: &&&Found| run.at_utc.seconds_since(other.at_utc).abs();
            let nearest = references.iter().min_by(|a, b| apart_s(a).total_cmp(&apart_s(b)));
            let Some(other) = nearest.filter(|other| apart_s(other) <= NEAR_S) else { continue };
            let error = |run: &Found| run.error.unwrap_or(USUAL_ERROR).max(1.0);
            pairs.push((run.position - other.position, error(run).powi(2) + error(other).powi(2)));
        }
        agreed(pairs)
    }
}

/// The weighted mean of differences (steps, with their variances), without those that the others do not bear out; its
/// error grows as they scatter. None with too few that agree.
fn agreed(mut pairs: Vec<(f64, f64)>) -> Option<Estimate> {
    let middle = median(pairs.iter().map(|(value, _)| *value).collect())?;
    let spread = 1.4826 * median(pairs.iter().map(|(value, _)| (value - middle).abs()).collect())?;
    pairs.retain(|(value, variance)| (value - middle).abs() <= FAR * spread.max(variance.sqrt()));
    let weights: f64 = pairs.iter().map(|(_, variance)| 1.0 / variance).sum();
    let value = pairs.iter().map(|(value, variance)| value / variance).sum::<f64>() / weights;
    let squares: f64 = pairs.iter().map(|(of, variance)| (of - value).powi(2) / variance).sum();
    let scatter = (squares / (pairs.len() as f64 - 1.0).max(1.0)).max(1.0);
    (pairs.len() >= PAIRS).then(|| Estimate { value, error: (scatter / weights).sqrt() })
}

/// The median; of an even number the mean of the two in the middle. None of nothing.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let upper = *values.get(values.len() / 2)?;
    let lower = *values.get((values.len() - 1) / 2)?;
    Some(0.5 * (lower + upper))
}

#[cfg(test)]
mod tests;
