//! The verdict: what is heard, how it is judged, and the task that never stops doing both.

pub mod clocks;
mod ears;
pub mod frozen;
pub mod heard;
pub mod history;
mod intervals;
pub mod judge;
pub mod measure;
pub mod nodes;
pub mod recall;
pub mod rules;
pub mod sun;
pub mod task;
pub mod wind;
pub mod writers;

use std::time::Duration;

use bus::MachineTime;
use contract::observatory::{SafetyState, Unsafe, Verdict};
use units::Utc;

/// The newest verdict as the other tasks of this node see it.
#[derive(Debug, Clone, PartialEq)]
pub struct Ruling {
    /// The verdict with its reasons, as published.
    pub state: SafetyState,
    /// When it was given.
    pub judged: MachineTime,
    /// False for the first seconds of a node that has not heard all of its inputs yet: nobody acts on the verdict
    /// then, so that a restart in a safe night does not shut the roof. Bad news ends this at once.
    pub settled: bool,
}

/// A loop that judges every second is dead or starved when its ruling is older than this.
const MOST_AGE: Duration = Duration::from_secs(5);

impl Ruling {
    /// Before anything was judged: unsafe.
    pub fn none(now: MachineTime, since_utc: Utc) -> Self {
        let state = SafetyState {
            verdict: Verdict::Unsafe,
            since_utc,
            reasons: Vec::new(),
            suspended: Vec::new(),
            advisories: Vec::new(),
            time_to_safe_s: None,
            inputs: Vec::new(),
            avoid: Vec::new(),
            intervals: Vec::new(),
        };
        Self { state, judged: now, settled: false }
    }

    /// Safe, and said so recently enough to count.
    pub fn is_safe(&self, now: MachineTime) -> bool {
        self.state.verdict == Verdict::Safe && self.is_fresh(now)
    }

    /// Said recently enough to count.
    pub fn is_fresh(&self, now: MachineTime) -> bool {
        now.since(self.judged) <= MOST_AGE
    }

    /// Unsafe beyond the doubt of the first seconds.
    pub fn calls_for_closing(&self, now: MachineTime) -> bool {
        self.settled && !self.is_safe(now)
    }

    /// Why the sky is not to be exposed although nothing needs to close, if so.
    pub fn suspension(&self) -> Option<String> {
        let reasons = &self.state.suspended;
        (!reasons.is_empty()).then(|| in_words(reasons))
    }

    /// The reasons in one line.
    pub fn why(&self) -> String {
        if self.state.reasons.is_empty() { "the verdict is missing".to_owned() } else { in_words(&self.state.reasons) }
    }
}

fn in_words(reasons: &[Unsafe]) -> String {
    reasons.iter().map(|reason| format!("{}: {}", reason.input, reason.why)).collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_old_ruling_is_no_safe_one() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let mut ruling = Ruling::none(at(100), Utc::EPOCH);
        ruling.settled = true;
        assert!(ruling.calls_for_closing(at(100)));
        ruling.state.verdict = Verdict::Safe;
        assert!(ruling.is_safe(at(104)) && !ruling.calls_for_closing(at(104)));
        assert!(!ruling.is_safe(at(106)) && ruling.calls_for_closing(at(106)));
    }
}
