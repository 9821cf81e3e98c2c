//! Where the focus is at another temperature, through another filter, and what the play of the gears is.

use units::Celsius;

use super::hyperbola::Hyperbola;
use crate::quality::Estimate;

/// The focus that one run found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PastRun {
    /// Temperature of the tube (or the air) during the run.
    pub temperature: Celsius,
    /// Best position, less the filter's offset ([`without_offset`]), steps.
    pub position: f64,
    /// Its standard error, steps; NaN if it is not known.
    pub position_error: f64,
}

/// How the focus follows the temperature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TemperatureModel {
    /// Steps per degree.
    pub steps_per_c: Estimate,
    /// Scatter of the runs about the line, steps.
    pub scatter_steps: f64,
    /// Runs the line was fitted to.
    pub runs: usize,
    /// Coldest and warmest of them.
    pub span: (Celsius, Celsius),
}

/// Why there is no temperature model yet.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoModel {
    /// Too few runs.
    #[error("{runs} runs are known, {RUNS} are needed")]
    TooFew {
        /// Runs with finite numbers.
        runs: usize,
    },
    /// All at nearly the same temperature.
    #[error("the runs span {span_c:.1} degrees, {SPAN_C} are needed")]
    TooAlike {
        /// Highest less lowest temperature, degrees.
        span_c: f64,
    },
}

/// Runs, and degrees between the coldest and the warmest, that a line needs: chosen, not measured.
const RUNS: usize = 10;
const SPAN_C: f64 = 5.0;
/// Runs are not distinguished by errors below this, steps: a very small one must not decide alone.
const LEAST_ERROR: f64 = 1.0;
/// A coefficient is proven that differs from none by so many standard errors ...
const PROVEN: f64 = 4.0;
/// ... and a line is followed beyond its runs by this share of the span between them: further out it may bend, and a broken
/// thermometer (85 C, -127 C) must not send the focuser away.
const BEYOND: f64 = 0.5;
/// Outliers beyond this many scatters are left out.
const FAR: f64 = 4.0;

impl TemperatureModel {
    /// Fits a line to the runs, weighed with their errors; runs that lie far off are left out.
    ///
    /// # Errors
    /// [`NoModel`] until there are 10 such runs that span 5 degrees.
    pub fn fit(runs: &[PastRun]) -> Result<Self, NoModel> {
        let is_finite = |run: &&PastRun| run.temperature.celsius().is_finite() && run.position.is_finite();
        let all: Vec<PastRun> = runs.iter().filter(is_finite).copied().collect();
        check(&all)?;
        let off = off_most(&all);
        let limit = FAR * (1.4826 * super::median(off.clone()).unwrap_or(0.0)).max(usual_error(&all));
        let near: Vec<PastRun> = all.iter().zip(&off).filter(|(_, off)| **off <= limit).map(|(run, _)| *run).collect();
        let used = near;
        check(&used)?;
        let line = line(&used);
        let squares: f64 = used.iter().map(|run| line.off(run).powi(2)).sum();
        let scatter_steps = (squares / (used.len() - 2) as f64).sqrt();
        let steps_per_c = Estimate { value: line.slope, error: scatter_steps / line.spread.sqrt() };
        let (coldest, warmest) = ends(&used);
        let span = (Celsius::new(coldest), Celsius::new(warmest));
        Ok(Self { steps_per_c, scatter_steps, runs: used.len(), span })
    }

    /// Whether the runs prove that the focus follows the temperature: following what only looks so makes it worse.
    pub fn is_proven(&self) -> bool {
        self.steps_per_c.value.abs() > PROVEN * self.steps_per_c.error
    }

    /// How far to move after the temperature went from one value to another, steps; 0 for temperatures that are not
    /// finite. Either counts no further out than half the span of the runs beyond its end.
    pub fn steps(&self, from: Celsius, to: Celsius) -> f64 {
        let (coldest, warmest) = (self.span.0.celsius(), self.span.1.celsius());
        let beyond = BEYOND * (warmest - coldest);
        let within = |at: Celsius| at.celsius().max(coldest - beyond).min(warmest + beyond);
        let is_known = from.celsius().is_finite() && to.celsius().is_finite();
        let steps = self.steps_per_c.value * (within(to) - within(from));
        if is_known && steps.is_finite() { steps } else { 0.0 }
    }
}

/// Lowest and highest temperature, degrees.
fn ends(runs: &[PastRun]) -> (f64, f64) {
    let temperatures = runs.iter().map(|run| run.temperature.celsius());
    temperatures.fold((f64::MAX, f64::MIN), |(low, high), t| (low.min(t), high.max(t)))
}

fn check(runs: &[PastRun]) -> Result<(), NoModel> {
    let (low, high) = ends(runs);
    if runs.len() < RUNS {
        Err(NoModel::TooFew { runs: runs.len() })
    } else if high - low < SPAN_C {
        Err(NoModel::TooAlike { span_c: high - low })
    } else {
        Ok(())
    }
}

/// How far each run lies off the line of the median slope between any two (Theil and Sen): a single run, however far off
/// and whatever its temperature, does not turn it.
fn off_most(runs: &[PastRun]) -> Vec<f64> {
    let place = |run: &PastRun| (run.temperature.celsius(), run.position);
    let pairs = runs.iter().enumerate().flat_map(|(n, a)| runs.iter().skip(n + 1).map(move |b| (place(a), place(b))));
    let slopes = pairs.map(|(a, b)| (b.1 - a.1) / (b.0 - a.0)).filter(|slope| slope.is_finite());
    let slope = super::median(slopes.collect()).unwrap_or(0.0);
    let rest = |run: &PastRun| run.position - slope * run.temperature.celsius();
    let level = super::median(runs.iter().map(rest).collect()).unwrap_or(0.0);
    runs.iter().map(|run| (rest(run) - level).abs()).collect()
}

struct TemperatureLine {
    middle: (f64, f64),
    slope: f64,
    /// Sum of squared distances from the mean temperature, with weights of mean 1.
    spread: f64,
}

impl TemperatureLine {
    fn off(&self, run: &PastRun) -> f64 {
        run.position - self.middle.1 - self.slope * (run.temperature.celsius() - self.middle.0)
    }
}

/// The median error of the runs that know one, steps.
fn usual_error(runs: &[PastRun]) -> f64 {
    let known = runs.iter().map(|run| run.position_error).filter(|error| error.is_finite()).collect();
    super::median(known).unwrap_or(LEAST_ERROR).max(LEAST_ERROR)
}

fn line(runs: &[PastRun]) -> TemperatureLine {
    // an error that is not known counts as the usual one
    let usual = usual_error(runs);
    let error =
        |run: &PastRun| if run.position_error.is_finite() { run.position_error.max(0.3 * usual) } else { usual };
    let weights: Vec<f64> = runs.iter().map(|run| (usual / error(run)).powi(2)).collect();
    let total: f64 = weights.iter().sum();
    let mean = |of: fn(&PastRun) -> f64| runs.iter().zip(&weights).map(|(run, w)| w * of(run)).sum::<f64>() / total;
    let middle = (mean(|run| run.temperature.celsius()), mean(|run| run.position));
    let scale = runs.len() as f64 / total;
    let (mut spread, mut along) = (0.0, 0.0);
    for (run, weight) in runs.iter().zip(&weights) {
        let dt = run.temperature.celsius() - middle.0;
        spread += scale * weight * dt * dt;
        along += scale * weight * dt * (run.position - middle.1);
    }
    TemperatureLine { middle, slope: along / spread, spread }
}

/// What is kept as the best focus: the position that a run found, less the offset of the filter it was made through.
/// The offset is added again whenever that filter is set (leaving it in counts it twice).
pub fn without_offset(found_position: f64, filter_offset_steps: f64) -> f64 {
    found_position - filter_offset_steps
}

/// Where the focuser belongs: best focus, shift wanted by the observer and the filter's offset, within its travel.
/// None when one of them is not finite.
pub fn target(
    best_position: f64,
    shift_steps: f64,
    filter_offset_steps: f64,
    limits: std::ops::RangeInclusive<i32>,
) -> Option<i32> {
    let (low, high) = (f64::from(*limits.start()), f64::from(*limits.end()));
    let target = best_position + shift_steps + filter_offset_steps;
    target.is_finite().then(|| target.round().min(high).max(low) as i32)
}

/// A filter's offset against a reference filter: runs through both, one after the other, at one temperature.
pub fn filter_offset(filter: &Hyperbola, reference: &Hyperbola) -> Estimate {
    difference(filter, reference)
}

/// The play of the gears: the focus of a run upwards less that of a run downwards, steps. Overshoot by twice as much.
pub fn backlash(upward: &Hyperbola, downward: &Hyperbola) -> Estimate {
    difference(upward, downward)
}

fn difference(a: &Hyperbola, b: &Hyperbola) -> Estimate {
    let error = a.best_position_error.hypot(b.best_position_error);
    Estimate { value: a.best_position - b.best_position, error }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn run(temperature_c: f64, position: f64) -> PastRun {
        PastRun { temperature: Celsius::new(temperature_c), position, position_error: 4.0 }
    }

    fn runs(count: usize, span_c: f64) -> Vec<PastRun> {
        let at = |n: usize| span_c * n as f64 / (count - 1) as f64 - 3.0;
        (0..count).map(|n| run(at(n), 5000.0 - 12.0 * at(n) + if n % 2 == 0 { 3.0 } else { -3.0 })).collect()
    }

    #[test]
    fn ten_runs_over_five_degrees_give_the_coefficient() {
        let model = TemperatureModel::fit(&runs(10, 5.0)).unwrap();
        assert!((model.steps_per_c.value + 12.0).abs() < 2.0 * model.steps_per_c.error, "{model:?}");
        assert!((2.5..4.5).contains(&model.scatter_steps) && model.runs == 10, "{model:?}");
        let steps = model.steps(Celsius::new(1.0), Celsius::new(-2.0));
        assert!((steps - 36.0).abs() < 6.0, "{steps}");
        assert_eq!(TemperatureModel::fit(&runs(9, 9.0)), Err(NoModel::TooFew { runs: 9 }));
        assert!(matches!(TemperatureModel::fit(&runs(30, 4.9)), Err(NoModel::TooAlike { .. })));
    }

    #[test]
    fn a_coefficient_that_only_looks_so_is_not_proven() {
        let follows = TemperatureModel::fit(&runs(10, 5.0)).unwrap();
        assert!(follows.is_proven(), "{follows:?}");
        // no coefficient, and a scatter of 40 steps that by chance leans a little
        let leans = [30.0, -45.0, 38.0, -20.0, -41.0, 44.0, 12.0, -33.0, 50.0, 9.0, -12.0, 35.0];
        let at = |n: usize| run(0.6 * n as f64, 5000.0 + leans[n]);
        let model = TemperatureModel::fit(&(0..12).map(at).collect::<Vec<_>>()).unwrap();
        assert!(model.steps_per_c.value.abs() > 1.0 && !model.is_proven(), "{model:?}");
    }

    #[test]
    fn a_line_is_not_followed_far_beyond_its_runs() {
        let model = TemperatureModel::fit(&runs(10, 5.0)).unwrap();
        let steps = |from, to| model.steps(Celsius::new(from), Celsius::new(to));
        // runs from -3 to 2 C: half of that span beyond either end
        let most = steps(-5.5, 4.5);
        assert!((most + 120.0).abs() < 12.0, "{most}");
        assert_eq!(steps(-5.5, 85.0), most);
        assert_eq!(steps(-127.0, 4.5), most);
        assert_eq!((steps(f64::INFINITY, 1.0), steps(90.0, 95.0)), (0.0, 0.0));
    }

    #[test]
    fn a_run_gone_wrong_is_left_out() {
        let mut all = runs(14, 8.0);
        all[3].position += 400.0;
        all[5].temperature = Celsius::new(f64::NAN);
        let model = TemperatureModel::fit(&all).unwrap();
        assert!((model.steps_per_c.value + 12.0).abs() < 1.0 && model.runs == 12, "{model:?}");
        assert_eq!(model.steps(Celsius::new(f64::NAN), Celsius::new(1.0)), 0.0);
    }

    #[test]
    fn a_broken_thermometer_or_one_bad_run_at_an_end_turns_no_line() {
        for (temperature_c, off) in [(85.0, 0.0), (-127.0, 0.0), (-3.0, 700.0), (5.0, -700.0)] {
            let mut all = runs(12, 8.0);
            all[11] = run(temperature_c, 5000.0 - 12.0 * temperature_c.clamp(-3.0, 5.0) + off);
            let model = TemperatureModel::fit(&all).unwrap();
            assert!((model.steps_per_c.value + 12.0).abs() < 1.0 && model.runs == 11, "{model:?}");
        }
        // too few are left
        let mut all = runs(10, 8.0);
        all[9].position += 700.0;
        assert_eq!(TemperatureModel::fit(&all), Err(NoModel::TooFew { runs: 9 }));
    }

    #[test]
    fn an_offset_is_taken_off_once_and_added_once() {
        let best = without_offset(5230.0, 80.0);
        assert_eq!(target(best, 0.0, 80.0, 0..=10_000), Some(5230));
        assert_eq!(target(best, 25.0, -30.0, 0..=10_000), Some(5145));
        assert_eq!(target(best, 1e9, 0.0, 0..=10_000), Some(10_000));
        assert_eq!(target(best, -1e9, 0.0, 100..=10_000), Some(100));
        assert_eq!(target(f64::NAN, 0.0, 0.0, 7..=9), None);
    }

    proptest! {
        #[test]
        fn any_runs_have_a_finite_model_or_none(
            runs in prop::collection::vec((prop_oneof![-30.0_f64..40.0, Just(f64::NAN)], -1e6_f64..1e6,
                prop_oneof![0.0_f64..100.0, Just(f64::NAN), Just(0.0)]), 0..30)
        ) {
            let runs: Vec<PastRun> = runs.into_iter()
                .map(|(t, position, position_error)| PastRun { temperature: Celsius::new(t), position, position_error })
                .collect();
            if let Ok(model) = TemperatureModel::fit(&runs) {
                prop_assert!(model.steps_per_c.value.is_finite() && model.steps_per_c.error.is_finite());
            }
        }
    }
}
