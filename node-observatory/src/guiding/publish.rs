//! The publications of guiding: a record of each frame, and how well the field is held.

use std::collections::VecDeque;

use bus::Publisher;
use contract::Key;
use contract::device::camera::Frame;
use contract::observatory::{AxisCorrection, Correction, GuideStage, PulseWhy};
use imaging::guide::{AxisLog, Decision, State, Unstable, Why};
use node::Node;
use tokio::sync::OnceCell;

use super::pulse::{Given, Taken};
use super::session::{FieldMeasurement, Session};

/// Frames that the root mean square is taken of.
const FRAMES: usize = 20;

/// Distances on the last frames.
#[derive(Debug, Default)]
pub struct Residuals {
    squares_px2: VecDeque<f64>,
}

impl Residuals {
    /// Notes how far the stars were off while the field was held, px.
    pub fn note(&mut self, distance_px: f64) {
        if distance_px.is_finite() {
            self.squares_px2.push_back(distance_px.powi(2));
            if self.squares_px2.len() > FRAMES {
                self.squares_px2.pop_front();
            }
        }
    }

    /// Their root mean square, px; None before the first.
    pub fn rms_px(&self) -> Option<f64> {
        let count = self.squares_px2.len();
        (count > 0).then(|| rounded((self.squares_px2.iter().sum::<f64>() / count as f64).sqrt()))
    }

    /// Frames that it is taken of.
    pub fn count(&self) -> usize {
        self.squares_px2.len()
    }
}

/// The record of a frame.
pub fn correction(
    frame: &Frame,
    session: &Session,
    seen: &FieldMeasurement,
    decision: &Decision,
    given: &Given,
    rms_px: Option<f64>,
) -> Correction {
    let shift = seen.measured.as_ref().ok().map(|measured| measured.shift);
    let if_finite = |value: f64| value.is_finite().then(|| rounded(value));
    Correction {
        frame: frame.id.clone(),
        camera: frame.camera.clone(),
        mid_utc: frame.started_utc.plus_seconds(0.5 * frame.exposure_s),
        object: Some(session.field.object.clone()),
        filter: session.field.filter.clone(),
        pier_side: session.field.pier_side,
        reference: session.reference_frame.clone(),
        stage: stage(decision.state),
        dx_px: shift.and_then(|shift| if_finite(shift.dx_px)),
        dy_px: shift.and_then(|shift| if_finite(shift.dy_px)),
        shift_error_px: shift.and_then(|shift| if_finite(shift.error_px().0.max(shift.error_px().1))),
        rotation_deg: shift
            .filter(|shift| shift.covariance[2][2] > 0.0)
            .and_then(|shift| if_finite(shift.rotation_deg)),
        rotation_deg_per_h: decision.log.rotation_deg_h.and_then(|(rate, _)| if_finite(rate)),
        stars: shift.map_or(0, |shift| u32::try_from(shift.stars).unwrap_or(u32::MAX)),
        fwhm_px: seen.measured.as_ref().ok().and_then(|measured| measured.fwhm_px).and_then(if_finite),
        transparency: shift.and_then(|shift| shift.transparency).and_then(if_finite),
        method: shift.map(|_| seen.method),
        reason: seen.reason.clone().or_else(|| given.refused.as_ref().map(|refused| refused.why.clone())),
        east: axis(decision.east, &decision.log.east, decision.pulses.east_ms, given.east),
        north: axis(decision.north, &decision.log.north, decision.pulses.north_ms, given.north),
        rms_px,
        further_action: None,
    }
}

fn axis(why: Why, log: &AxisLog, pulse_ms: i32, given: Taken) -> AxisCorrection {
    // Before the first frame nothing is expected, with any spread.
    let or_zero = |value: f64| if value.is_finite() { rounded(value) } else { 0.0 };
    AxisCorrection {
        why: pulse_why(why),
        error_px: log.error_px.filter(|error| error.is_finite()).map(rounded),
        expected_px: or_zero(log.expected_px),
        spread_px: or_zero(log.spread_px),
        drift_px_per_s: or_zero(log.drift_px_s),
        worm_period_s: log.worm_period_s.filter(|period| period.is_finite()).map(rounded),
        pulse_ms,
        given_ms: given.map_or(0, |(_, ms)| ms),
    }
}

/// Without digits that no measurement has.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

/// The published form of the guider's state.
pub fn stage(state: State) -> GuideStage {
    match state {
        State::Acquire => GuideStage::Acquire,
        State::Stabilise => GuideStage::Stabilise,
        State::Guide => GuideStage::Guide,
        State::Lost => GuideStage::Lost,
        State::Stopped => GuideStage::Stopped,
    }
}

/// A stage in words.
pub fn word(stage: GuideStage) -> &'static str {
    match stage {
        GuideStage::Acquire => "acquiring",
        GuideStage::Stabilise => "stabilising",
        GuideStage::Guide => "guiding",
        GuideStage::Lost => "lost",
        GuideStage::Stopped => "given up",
    }
}

fn pulse_why(why: Why) -> PulseWhy {
    match why {
        Why::Corrected => PulseWhy::Corrected,
        Why::Clipped => PulseWhy::Clipped,
        Why::WithinDeadBand => PulseWhy::WithinDeadBand,
        Why::ReversalResisted => PulseWhy::ReversalResisted,
        Why::Outlier => PulseWhy::Outlier,
        Why::DriftHeld => PulseWhy::DriftHeld,
        Why::NotMeasured => PulseWhy::NotMeasured,
        Why::BeyondCap => PulseWhy::BeyondCap,
        Why::Lost => PulseWhy::Lost,
        Why::Unusable => PulseWhy::Unusable,
        Why::Stopped => PulseWhy::Stopped,
    }
}

/// Why the field is not held although its stars are seen, and what to do.
pub fn unstable(unstable: Unstable) -> &'static str {
    match unstable {
        Unstable::Oscillates => {
            "pulses throw the field to and fro: drift and play of the gear are learned anew with gentle pulses; if it stays, \
             run calibrate_guiding"
        }
        Unstable::NotHeld => {
            "pulses do not bring the field back: drift and play of the gear are learned anew; look at the wind and the \
             mount's guide rates, and run calibrate_guiding"
        }
        Unstable::WrongWay => {
            "pulses moved the stars against the calibration, and are given the other way round: run calibrate_guiding, or \
             set guiding.dec_reversed_after_flip as this mount has it"
        }
    }
}

/// Publishes a record. All records of this incarnation of the node go out through one publisher, so that their numbers
/// reveal a gap.
pub async fn publish(node: &Node, corrections: &OnceCell<Publisher<Correction>>, correction: Correction) {
    let key = Key::Correction(node.config.address());
    let line = corrections.get_or_try_init(|| node.bus.publisher(&key)).await;
    let published = match line {
        Ok(line) => line.put(correction).await,
        Err(error) => Err(error),
    };
    if let Err(error) = published {
        tracing::warn!(%error, "a guide correction could not be published");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_residual_is_that_of_the_last_frames_and_takes_in_no_nonsense() {
        let mut residuals = Residuals::default();
        assert_eq!(residuals.rms_px(), None);
        residuals.note(f64::NAN);
        assert_eq!(residuals.rms_px(), None);
        residuals.note(100.0);
        for _ in 0..FRAMES {
            residuals.note(0.3);
        }
        assert_eq!((residuals.rms_px(), residuals.count()), (Some(0.3), FRAMES));
    }
}
