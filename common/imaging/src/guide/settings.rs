//! How to guide: what a site may choose.

use super::pid::Gains;

/// How an axis is controlled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Control {
    /// By prediction: a bank of Kalman filters that learns noise, drift and worm.
    Predict,
    /// As the predecessor did.
    Pid(Gains),
}

/// What a site may choose. Lengths are px of the frames guided on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuideSettings {
    /// Control of right ascension (East pulses) and of declination (North pulses).
    pub control: [Control; 2],
    /// No pulse for less than this, px; None: for less than the error of the measurement, at most 0.15 px.
    pub dead_band_px: Option<f64>,
    /// Longest pulse; what is longer is cut to this, ms.
    pub longest_pulse_ms: u32,
    /// A shift greater than this, twice in a row, means that the field is lost, px.
    pub cap_px: f64,
    /// Greatest shift that is taken back by pulses while stabilising, px.
    pub stabilise_cap_px: f64,
    /// Whether Dec turns round only when there is reason to (a gear with play).
    pub resist_dec_reversal: bool,
    /// Period of the worm of right ascension, s, where it is known; else it is learned.
    pub worm_period_s: Option<f64>,
    /// How long a known drift is still taken back while no star is seen, s.
    pub hold_drift_s: f64,
    /// How long clouds may last before help is called, s.
    pub alert_after_s: f64,
}

impl Default for GuideSettings {
    fn default() -> Self {
        Self {
            control: [Control::Predict; 2],
            dead_band_px: None,
            longest_pulse_ms: 2500,
            cap_px: 20.0,
            stabilise_cap_px: 40.0,
            resist_dec_reversal: true,
            worm_period_s: None,
            hold_drift_s: 300.0,
            alert_after_s: 900.0,
        }
    }
}

impl GuideSettings {
    /// The predecessor's controller in both axes.
    pub fn pid() -> Self {
        Self { control: [Control::Pid(Gains::FIRST_AXIS), Control::Pid(Gains::SECOND_AXIS)], ..Self::default() }
    }
}

/// The greatest dead band that is chosen by itself, px.
const DEAD_BAND_PX: f64 = 0.15;

impl GuideSettings {
    /// The dead band for a measurement of this standard error, px.
    pub(super) fn dead_band_px(&self, error_px: f64) -> f64 {
        let chosen = self.dead_band_px.filter(|band| band.is_finite() && *band >= 0.0);
        chosen.unwrap_or(if error_px < DEAD_BAND_PX { error_px.max(0.0) } else { DEAD_BAND_PX })
    }
}
