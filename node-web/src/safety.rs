//! The verdict as the page shows it, and how much it concerns an operator together with the posture.

use bus::MachineTime;
use contract::observatory::{Posture, Priority, SafetyState, Unsafe, Verdict};
use schemars::JsonSchema;
use serde::Serialize;
use units::Utc;

use crate::freshness::Quality;
use crate::model::Entry;

/// An opening that the sky does not allow is given so long to end before it is critical, machine seconds.
const GRACE_S: f64 = 30.0;

/// The verdict as the page shows it.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize)]
pub struct Safety {
    /// The word.
    pub state: SafetyWord,
    /// Sky time since when the verdict holds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub since_utc: Option<Utc>,
    /// Why it is not safe.
    pub reasons: Vec<Unsafe>,
    /// Why the sky is not exposed although nothing has to close.
    pub suspended: Vec<Unsafe>,
    /// The values that are close to a limit.
    pub advisories: Vec<Unsafe>,
    /// Sky seconds until it can be safe.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_to_safe_s: Option<f64>,
}

/// The three words of safety.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SafetyWord {
    /// The observatory node's verdict is safe, and fresh.
    Safe,
    /// Its verdict is unsafe.
    Unsafe,
    /// There is no fresh verdict.
    Unknown,
}

impl SafetyWord {
    /// Its word, the same as in JSON.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Safe => "safe",
            Self::Unsafe => "unsafe",
            Self::Unknown => "unknown",
        }
    }
}

/// The verdict in words; a stale one counts as unknown, and says since when its observatory node is silent.
pub fn words(state: Option<&(&Entry, SafetyState)>, silent_since: Option<Utc>, now: MachineTime) -> Safety {
    let fresh = state.filter(|(entry, _)| entry.quality(now) == Quality::Fresh);
    if let Some((_, state)) = fresh {
        return Safety {
            state: match state.verdict {
                Verdict::Safe => SafetyWord::Safe,
                Verdict::Unsafe => SafetyWord::Unsafe,
            },
            since_utc: Some(state.since_utc),
            reasons: state.reasons.clone(),
            suspended: state.suspended.clone(),
            advisories: state.advisories.clone(),
            time_to_safe_s: state.time_to_safe_s,
        };
    }
    let last = state.map(|(_, state)| match state.verdict {
        Verdict::Safe => "; its last verdict was safe",
        Verdict::Unsafe => "; its last verdict was unsafe",
    });
    let without = match silent_since {
        Some(_) => overview::silent(silent_since),
        None => "it publishes no verdict any more, so safety is unknown".to_owned(),
    };
    let why = format!("{without}{}", last.unwrap_or_default());
    let silent = Unsafe { input: "observatory node".to_owned(), why, clears_in_s: None };
    Safety {
        state: SafetyWord::Unknown,
        since_utc: None,
        reasons: if state.is_some() || silent_since.is_some() { vec![silent] } else { Vec::new() },
        suspended: Vec::new(),
        advisories: Vec::new(),
        time_to_safe_s: None,
    }
}

/// How urgently the two words together concern an operator.
pub fn concern(safety: SafetyWord, posture: Posture, held_s: f64) -> Option<Priority> {
    let after_grace = |late, early| if held_s > GRACE_S { late } else { early };
    match (safety, posture) {
        (SafetyWord::Safe, Posture::Closed | Posture::Opening | Posture::Open | Posture::Closing) => None,
        (SafetyWord::Safe, Posture::Unknown) => Some(Priority::High),
        (SafetyWord::Unsafe, Posture::Closed) => None,
        (SafetyWord::Unsafe, Posture::Closing) => Some(after_grace(Priority::Critical, Priority::Medium)),
        (SafetyWord::Unsafe, Posture::Open) => Some(after_grace(Priority::Critical, Priority::High)),
        (SafetyWord::Unsafe, Posture::Opening | Posture::Unknown) => Some(Priority::Critical),
        (SafetyWord::Unknown, Posture::Closed) => Some(Priority::Medium),
        (SafetyWord::Unknown, Posture::Opening | Posture::Closing) => Some(Priority::High),
        (SafetyWord::Unknown, Posture::Open | Posture::Unknown) => Some(Priority::Critical),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unsafe_and_closed_is_quiet_but_open_and_blind_is_the_loudest() {
        assert_eq!(concern(SafetyWord::Unsafe, Posture::Closed, 1e6), None);
        assert_eq!(concern(SafetyWord::Safe, Posture::Open, 0.0), None);
        assert_eq!(concern(SafetyWord::Unknown, Posture::Unknown, 0.0), Some(Priority::Critical));
        assert_eq!(concern(SafetyWord::Unsafe, Posture::Opening, 0.0), Some(Priority::Critical));
    }

    #[test]
    fn a_roof_that_is_still_open_becomes_critical_after_the_grace() {
        assert_eq!(concern(SafetyWord::Unsafe, Posture::Open, 10.0), Some(Priority::High));
        assert_eq!(concern(SafetyWord::Unsafe, Posture::Open, 31.0), Some(Priority::Critical));
        assert_eq!(concern(SafetyWord::Unsafe, Posture::Closing, 10.0), Some(Priority::Medium));
    }
}
