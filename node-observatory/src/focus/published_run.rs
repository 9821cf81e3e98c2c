//! The state of a run while it is under way, and its record when it has ended, however it ends.

use bus::Clock;
use contract::CommandId;
use contract::observatory::{FocusCurve, FocusOutcome, FocusPass, FocusPoint, FocusRun};
use imaging::focus::Better;
use imaging::focus::sweep::{FocusFit, FocusMeasurement, Focused, Pass, Sweep};

use super::FocusData;
use super::meter::Read;

/// What is known of a point in addition to its value.
#[derive(Debug, Clone, Default)]
pub struct About {
    /// The frames.
    pub frames: Vec<CommandId>,
    /// What the last of them gave.
    pub read: Read,
    /// Temperature at the focuser, degrees Celsius.
    pub temperature_c: Option<f64>,
}

/// A published run; one that is dropped before its end was interrupted.
pub struct PublishedRun<'a> {
    focus: &'a FocusData,
    clock: &'a Clock,
    run: FocusRun,
    about: Vec<About>,
    is_reported: bool,
}

impl<'a> PublishedRun<'a> {
    /// Shows that a run begins.
    pub fn begin(focus: &'a FocusData, clock: &'a Clock, run: FocusRun) -> Self {
        let published = Self { focus, clock, run, about: Vec::new(), is_reported: false };
        published.show(format!("{} looks for the focus of {}", published.run.focuser, published.run.camera));
        published
    }

    /// A position was measured.
    pub fn measured(&mut self, sweep: &Sweep, about: About) {
        self.about.push(about);
        let fit = sweep.fit();
        self.run.points = points(sweep.points(), &self.about, fit.as_ref());
        self.run.curve = fit.as_ref().and_then(curve);
        let temperatures: Vec<f64> = self.about.iter().filter_map(|about| about.temperature_c).collect();
        let mean = temperatures.iter().sum::<f64>() / temperatures.len().max(1) as f64;
        self.run.temperature_c = (!temperatures.is_empty()).then_some((mean * 1000.0).round() / 1000.0);
        self.show(format!("{} positions measured", self.run.points.len()));
    }

    /// The run found the focus; with `keep`, rows take it from now on.
    pub fn focused(mut self, focused: &Focused, keep: bool) -> FocusRun {
        let (fit, run) = (&focused.fit, &mut self.run);
        let best = finite(fit.best_position()).unwrap_or(f64::from(focused.position));
        run.outcome = FocusOutcome::Focused;
        run.best_position = Some(best);
        run.best_position_error = fit.best_position_error().and_then(finite);
        run.critical_zone = fit.critical_zone().and_then(finite);
        run.stored_position = keep.then_some(best - run.filter_offset as f64);
        run.verified = finite(focused.verified);
        run.curve = curve(fit).or(run.curve.take());
        let detail = format!("focused at {} steps: {:.2} ({})", focused.position, focused.verified, run.value_label);
        self.end(detail)
    }

    /// The run found no focus.
    pub fn failed(mut self, reason: String) -> FocusRun {
        self.run.outcome = FocusOutcome::Failed;
        let detail = format!("no focus: {reason}");
        self.run.reason = Some(reason);
        self.end(detail)
    }

    fn end(&mut self, detail: String) -> FocusRun {
        self.is_reported = true;
        self.run.ended_utc = Some(self.clock.utc());
        self.focus.learned.change(|learned| learned.learn(&self.run));
        tracing::info!(camera = self.run.camera, points = self.run.points.len(), detail, "focus run");
        self.show(detail);
        // The receiver lives as long as the node.
        let _ = self.focus.ended_runs.send(self.run.clone());
        self.run.clone()
    }

    fn show(&self, detail: String) {
        self.focus.state.send_modify(|published| {
            published.active = self.run.outcome == FocusOutcome::Running;
            published.detail = detail;
            published.run = Some(self.run.clone());
        });
    }
}

impl Drop for PublishedRun<'_> {
    fn drop(&mut self) {
        if !self.is_reported {
            self.run.outcome = FocusOutcome::Failed;
            self.run.reason = Some("interrupted".to_owned());
            self.end("no focus: the run was interrupted".to_owned());
        }
    }
}

fn points(points: &[FocusMeasurement], about: &[About], fit: Option<&FocusFit>) -> Vec<FocusPoint> {
    let mut number = 0;
    let points = points.iter().zip(about).map(|(point, about)| {
        let used = match fit {
            Some(FocusFit::Hyperbola(curve)) if point.pass != Pass::Verification => {
                number += 1;
                curve.used.get(number - 1).copied()
            }
            _ => None,
        };
        FocusPoint {
            position: i64::from(point.position),
            pass: match point.pass {
                Pass::Coarse => FocusPass::Coarse,
                Pass::Fine => FocusPass::Fine,
                Pass::Verification => FocusPass::Verification,
            },
            value: point.value.and_then(|value| finite(value.value)),
            error: point.value.and_then(|value| finite(value.error)),
            stars: about.read.stars,
            reason: about.read.reason.clone(),
            used,
            frames: about.frames.clone(),
            temperature_c: about.temperature_c,
            others: about.read.others.clone(),
        }
    });
    points.collect()
}

/// A curve as it is published; `None` if one of its numbers is not finite.
fn curve(fit: &FocusFit) -> Option<FocusCurve> {
    let (best_position, best_value) = (finite(fit.best_position())?, finite(fit.best_value())?);
    match fit {
        FocusFit::Hyperbola(curve) => Some(FocusCurve {
            model: "hyperbola".to_owned(),
            best_position,
            best_value,
            slope_per_step: Some(finite(curve.slope)?),
            larger_is_better: false,
            places: Vec::new(),
        }),
        FocusFit::Smoothed { smoother, better, curve, .. } => Some(FocusCurve {
            model: (*smoother).to_owned(),
            best_position,
            best_value,
            slope_per_step: None,
            larger_is_better: *better == Better::Larger,
            places: curve.iter().map(|(position, value)| [*position, *value]).collect(),
        }),
    }
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}
