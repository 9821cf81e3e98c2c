//! The errors of a row of the schedule.

use contract::{Kind, Reason};
use units::Utc;

/// Why a step of an action did not succeed.
#[derive(Debug, thiserror::Error)]
pub enum ActionError {
    /// A device node did not take a command.
    #[error("{device} refused to {verb} ({reason}): {detail}")]
    Refused {
        /// Who.
        device: String,
        /// What.
        verb: String,
        /// For programs.
        reason: Reason,
        /// For people.
        detail: String,
    },
    /// Nobody answered, and the state does not show that the command was taken.
    #[error("{device} did not answer to {verb}, nor does its state show it")]
    Unanswered {
        /// Who.
        device: String,
        /// What.
        verb: String,
    },
    /// The device took a command and could not do it.
    #[error("{device} failed to {verb}: {reason}")]
    Failed {
        /// Who.
        device: String,
        /// What.
        verb: String,
        /// The device's reason.
        reason: String,
    },
    /// Another command took the place of one before its effect was seen.
    #[error("{device}: {verb} was not seen to be done before {by} took its place")]
    Superseded {
        /// Who.
        device: String,
        /// What.
        verb: String,
        /// The other command, and of whom.
        by: String,
    },
    /// Something did not become true in time.
    #[error("{device}: not {what} within {after_s:.0} s")]
    Deadline {
        /// Who.
        device: String,
        /// What was waited for.
        what: String,
        /// How long.
        after_s: f64,
    },
    /// The device node was restarted and knows nothing of the command.
    #[error("the node of {device} was restarted before the command was done")]
    Restarted {
        /// Whose node.
        device: String,
    },
    /// The sensor did not reach its set point.
    #[error("{device} is not within {tolerance_k} K of {set_c} C after {minutes} min (sensor at {sensor})")]
    Cooling {
        /// Which camera.
        device: String,
        /// Set point, degrees Celsius.
        set_c: f64,
        /// Accepted distance, K.
        tolerance_k: f64,
        /// How long was waited, sky minutes.
        minutes: f64,
        /// Where the sensor is, in words.
        sensor: String,
    },
    /// The row asks for what this telescope or this sky does not offer.
    #[error("{0}")]
    Impossible(String),
    /// The sky became unsafe a moment before the row was stopped for it.
    #[error("nothing is opened: {0}")]
    NotSafe(String),
    /// Where the telescope looks could not be proven.
    #[error("{why}")]
    Unproven {
        /// Which camera, and why not.
        why: String,
        /// A later try may succeed, and is wanted.
        again: bool,
    },
    /// The target is behind the horizon of the site, or too low, and will be clear later in the row's window.
    #[error("{why}; it stands clear from {clear} on")]
    Hidden {
        /// What hides it, with numbers and units.
        why: String,
        /// From when on it does not, to a minute.
        clear: Utc,
    },
    /// The place of a named target is not known yet.
    #[error("{0}")]
    Unnamed(String),
    /// A function of the site's script failed, or the script cannot be read.
    #[error("{function} of the site's script: {why}")]
    Script {
        /// Which function.
        function: String,
        /// Why.
        why: String,
    },
    /// The sky cannot be computed.
    #[error("the sky cannot be computed: {0}")]
    Sky(#[from] sky::SkyError),
    /// The journal cannot be written, and without it no frame may be started.
    #[error("the journal cannot be written, so no frame may be started: {0}")]
    Journal(#[from] std::io::Error),
}

impl ActionError {
    /// The device that is at fault, where one is (`site/telescope/kind/name`).
    pub fn device(&self) -> Option<&str> {
        match self {
            Self::Refused { device, .. }
            | Self::Unanswered { device, .. }
            | Self::Failed { device, .. }
            | Self::Superseded { device, .. }
            | Self::Deadline { device, .. }
            | Self::Restarted { device }
            | Self::Cooling { device, .. } => Some(device),
            Self::Impossible(_)
            | Self::NotSafe(_)
            | Self::Unproven { .. }
            | Self::Script { .. }
            | Self::Unnamed(_)
            | Self::Hidden { .. } => None,
            Self::Sky(_) | Self::Journal(_) => None,
        }
    }

    /// Its kind.
    pub fn kind(&self) -> Option<Kind> {
        let named = self.device()?.split('/').nth(2)?;
        Kind::ALL.iter().copied().find(|kind| kind.to_string() == named)
    }

    /// Did the device, or its node, say nothing at all?
    pub fn is_silence(&self) -> bool {
        matches!(
            self,
            Self::Unanswered { .. } | Self::Restarted { .. } | Self::Refused { reason: Reason::NotConnected, .. }
        )
    }

    /// May the same step succeed a little later?
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Refused { reason, .. } => !matches!(reason, Reason::Malformed | Reason::NotImplemented),
            Self::Unanswered { .. }
            | Self::Failed { .. }
            | Self::Superseded { .. }
            | Self::Deadline { .. }
            | Self::Restarted { .. }
            | Self::NotSafe(_)
            | Self::Unnamed(_)
            | Self::Cooling { .. }
            | Self::Hidden { .. }
            | Self::Script { .. }
            | Self::Journal(_) => true,
            Self::Unproven { again, .. } => *again,
            Self::Impossible(_) | Self::Sky(_) => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sky_that_turns_as_a_row_opens_is_no_reason_to_give_the_row_up() {
        let error = ActionError::NotSafe("monitor: not connected yet".to_owned());
        assert!(error.may_pass() && error.kind().is_none());
        assert_eq!(error.to_string(), "nothing is opened: monitor: not connected yet");
        assert!(!ActionError::Impossible("no filter wheel".to_owned()).may_pass());
    }
}
