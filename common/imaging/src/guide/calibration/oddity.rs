//! What is odd about a calibration by pulses, and why there may be none.

use super::direction::Direction;

/// What is odd about a calibration that can be used all the same.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Warning {
    /// The axes do not stand upright on each other.
    #[error("the axes are {off_deg:.1} deg from a right angle, more than 12.5: is the polar alignment right?")]
    NotOrthogonal {
        /// Deviation from 90 degrees.
        off_deg: f64,
    },
    /// Fewer than four steps.
    #[error("only {steps} steps in {axis}: shorten the pulses")]
    FewSteps {
        /// `RA` or `Dec`.
        axis: &'static str,
        /// Steps that were made.
        steps: usize,
    },
    /// The speed is not that of guide rate and scale.
    #[error("{axis} moves by {px_s:.2} px/s where {expected_px_s:.2} were expected: check guide rate and scale")]
    Speed {
        /// `RA` or `Dec`.
        axis: &'static str,
        /// Measured, px/s.
        px_s: f64,
        /// Expected, px/s.
        expected_px_s: f64,
    },
    /// Too near to the pole for use at other declinations.
    #[error("calibrated at dec {dec_deg:.1}: it cannot be used at other declinations; calibrate below 60")]
    NearPole {
        /// Declination, degrees.
        dec_deg: f64,
    },
    /// Dec never took hold when it turned round.
    #[error("declination did not take hold when it turned South: it loses more than {play_s:.1} s")]
    OneWay {
        /// Pulses South that were given, s.
        play_s: f64,
    },
    /// The way back is not the way out.
    #[error("East came back by {share:.2} of the way West: wind, or a mount that sticks")]
    NotBack {
        /// Way back over way out.
        share: f64,
    },
}

/// Why there is no calibration.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoCalibration {
    /// The star hardly moved.
    #[error("{direction:?}: {steps} pulses of {pulse_ms} ms moved the star by {moved_px:.1} px; lengthen the pulses")]
    DidNotMove {
        /// Where to.
        direction: Direction,
        /// Pulses that were given.
        steps: usize,
        /// Their length, ms.
        pulse_ms: u32,
        /// How far it moved, px.
        moved_px: f64,
    },
    /// Dec never took hold.
    #[error("North: no three good moves in a row within {steps} pulses; the Dec gear does not take hold")]
    Backlash {
        /// Pulses that were given.
        steps: usize,
    },
    /// Times of frames do not go on, so that nothing is known of the drift.
    #[error("a frame of {mid_s:.1} s came after one of {before_s:.1} s: was the clock set? calibrate again")]
    Clock {
        /// Middle of the frame before, s.
        before_s: f64,
        /// Middle of the frame, s.
        mid_s: f64,
    },
    /// Several frames in a row showed no star.
    #[error("the star was lost while calibrating")]
    StarLost,
    /// It is over already.
    #[error("this calibration has ended; begin a new one")]
    Over,
    /// The result is not two directions.
    #[error("both axes move the star along the same line")]
    Parallel,
}
