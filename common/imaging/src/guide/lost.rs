//! What to do while the field is lost: look for it in whole frames, slew back, solve, call a person.

use super::decision::Ask;
use super::settings::GuideSettings;
use crate::shift::NoShift;

/// Two frames confirm a shift if they agree within this, px, and what a mount may drift from one to the other, px/s.
const AGREE_PX: f64 = 5.0;
const DRIFT_PX_S: f64 = 0.1;
/// Frames with stars that do not match, until a plate solution is asked for, and until all is given up.
const STRANGERS: (u32, u32) = (3, 6);

/// What was seen since the field was lost.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct LostField {
    /// Time (s) and shift (px) of the last frame.
    last: Option<(f64, [f64; 2])>,
    strangers: u32,
}

/// What a frame means for a lost field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum LostFieldOutcome {
    /// It is within reach of pulses.
    Near,
    /// Not yet; this may help.
    Not(Ask),
    /// Never.
    GivenUp,
}

impl LostField {
    /// The field is off by this much on the detector, px.
    pub(super) fn seen(&mut self, off_px: [f64; 2], time_s: f64, settings: &GuideSettings) -> LostFieldOutcome {
        let size_px = off_px[0].hypot(off_px[1]);
        let agrees = |(last_s, last): (f64, [f64; 2])| {
            (last[0] - off_px[0]).hypot(last[1] - off_px[1]) <= AGREE_PX + DRIFT_PX_S * (time_s - last_s)
        };
        let confirmed = self.last.is_some_and(agrees);
        self.last = Some((time_s, off_px));
        if size_px <= settings.cap_px || (confirmed && size_px <= settings.stabilise_cap_px) {
            LostFieldOutcome::Near
        } else if confirmed {
            LostFieldOutcome::Not(Ask::Recentre { dx_px: -off_px[0], dy_px: -off_px[1] })
        } else {
            LostFieldOutcome::Not(Ask::Register)
        }
    }

    /// No shift was found in a frame, this long (s) after the last one that was.
    pub(super) fn missed(&mut self, why: &NoShift, since_s: f64, settings: &GuideSettings) -> LostFieldOutcome {
        self.last = None;
        match why {
            NoShift::NoMatch { .. } | NoShift::Shapes(..) => {
                self.strangers += 1;
                match self.strangers {
                    n if n >= STRANGERS.1 => LostFieldOutcome::GivenUp,
                    n if n >= STRANGERS.0 => LostFieldOutcome::Not(Ask::PlateSolve),
                    _ => LostFieldOutcome::Not(Ask::Register),
                }
            }
            // clouds: they pass
            NoShift::TooFewStars { .. } | NoShift::Uncertain { .. } | NoShift::NoPeak { .. } => {
                LostFieldOutcome::Not(if since_s > settings.alert_after_s { Ask::Alarm } else { Ask::Register })
            }
        }
    }
}
