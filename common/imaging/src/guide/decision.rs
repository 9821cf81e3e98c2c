//! What the guider answers to a frame: pulses, why, and what it thinks, for the mount, the observer and the log.

/// Pulses to be given now, ms. East and North are positive, West and South negative.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Pulses {
    /// East, or West if negative, ms.
    pub east_ms: i32,
    /// North, or South if negative, ms.
    pub north_ms: i32,
}

/// Why an axis is pulsed, or is not.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Why {
    /// Towards where the star is expected in the next frame.
    Corrected,
    /// The same, cut to the longest pulse; the rest follows.
    Clipped,
    /// The error is within the dead band.
    WithinDeadBand,
    /// Dec would have to turn round, and there is not yet reason enough.
    ReversalResisted,
    /// The measurement was too surprising; what was expected before is corrected.
    Outlier,
    /// No star was seen; the known drift is taken back.
    DriftHeld,
    /// No star was seen, and no drift is known.
    NotMeasured,
    /// The shift is beyond the cap.
    BeyondCap,
    /// The field is lost: nothing is pulsed until it is found.
    Lost,
    /// The frame is not after the last one, repeats it, or its numbers are not finite.
    Unusable,
    /// Guiding has been given up.
    Stopped,
}

/// Where the guider stands.
///
/// ```text
///   Acquire --first measurement--> Stabilise --2 frames < 1 px, or 3--> Guide
///      ^                              ^                                  | no star twice, or twice beyond the cap
///      | moved()                      '---- found again ---- Lost <------'
///      '---------------- after a slew ---------------------- Lost ----> Stopped
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// No frame was measured yet.
    Acquire,
    /// The first corrections, up to a greater cap, without a gate.
    Stabilise,
    /// At work.
    Guide,
    /// The field is not where it should be, or not seen.
    Lost,
    /// Given up.
    Stopped,
}

/// What the guider asks for when pulses do not help.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ask {
    /// Compare the stars of the whole next frame with the reference.
    Register,
    /// Slew so that the stars move by this on the detector, then say [`super::Guider::moved`].
    Recentre {
        /// Along x, px.
        dx_px: f64,
        /// Along y, px.
        dy_px: f64,
    },
    /// Solve a frame, slew to the target, then say [`super::Guider::moved`].
    PlateSolve,
    /// Nothing helps: call a person.
    Alarm,
}

/// What is known of one axis, px along it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AxisLog {
    /// Error that was measured, px; None where nothing was.
    pub error_px: Option<f64>,
    /// Error that had been expected for this frame, px.
    pub expected_px: f64,
    /// Standard deviation of a measurement around what was expected, px.
    pub spread_px: f64,
    /// Drift of the mount without corrections, px/s.
    pub drift_px_s: f64,
    /// Period of the worm that was learned, s.
    pub worm_period_s: Option<f64>,
}

/// Why the field is not held although its stars are seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unstable {
    /// Pulses to one side and to the other follow each other, and the errors stay.
    Oscillates,
    /// The errors stay, whatever is pulsed.
    NotHeld,
    /// Pulses move the stars against their calibration.
    WrongWay,
}

/// What the guider thinks, for the log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Log {
    /// Right ascension.
    pub east: AxisLog,
    /// Declination.
    pub north: AxisLog,
    /// Flux of the stars over that in the reference.
    pub transparency: Option<f64>,
    /// Stars that were used.
    pub stars: usize,
    /// How fast the field turns, and the standard error, deg/h.
    pub rotation_deg_h: Option<(f64, f64)>,
    /// Whether the field turns beyond doubt by more than 0.05 deg/h: polar misalignment or rotator fault.
    pub rotates: bool,
    /// Why the field is not held, if it is not.
    pub unstable: Option<Unstable>,
}

/// The answer to a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decision {
    /// To be given at once.
    pub pulses: Pulses,
    /// Why right ascension is pulsed, or is not.
    pub east: Why,
    /// Why declination is pulsed, or is not.
    pub north: Why,
    /// Where the guider stands after this frame.
    pub state: State,
    /// What it asks for in addition.
    pub ask: Option<Ask>,
    /// What it thinks.
    pub log: Log,
}
