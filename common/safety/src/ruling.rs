//! The newest verdict with when it was given: whether it still counts, and what follows from it.

use std::time::Duration;

use contract::observatory::{Interval, SafetyState, Unsafe, Verdict};
use units::{MachineTime, Utc};

use crate::judge::Judgement;

/// The newest verdict as the other tasks of this node see it.
#[derive(Debug, Clone, PartialEq)]
pub struct Ruling {
    /// The verdict with its reasons, as published.
    pub state: SafetyState,
    /// When it was given.
    pub judged: MachineTime,
    /// False for the first seconds of a node that has not received all of its inputs yet: nobody acts on the verdict
    /// then, so that a restart in a safe night does not shut the roof. A bad input ends this at once.
    pub settled: bool,
}

/// A loop that judges every second is dead or starved when its verdict is older than this.
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

    /// Takes in a new judgement, given now; once `settled` it stays so.
    pub fn renew(&mut self, judgement: Judgement, intervals: Vec<Interval>, settled: bool, utc: Utc, now: MachineTime) {
        let is_same = self.state.verdict == judgement.verdict;
        self.state = SafetyState {
            verdict: judgement.verdict,
            since_utc: if is_same { self.state.since_utc } else { utc },
            reasons: judgement.reasons,
            suspended: judgement.suspended,
            advisories: judgement.advisories,
            time_to_safe_s: judgement.time_to_safe_s,
            inputs: judgement.inputs,
            avoid: judgement.avoid,
            intervals,
        };
        self.judged = now;
        self.settled |= settled;
    }

    /// Safe, and judged recently enough to count.
    pub fn is_safe(&self, now: MachineTime) -> bool {
        self.state.verdict == Verdict::Safe && self.is_fresh(now)
    }

    /// Judged recently enough to count.
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
    fn a_verdict_that_stays_keeps_its_beginning_and_a_settled_ruling_stays_settled() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let judgement = |verdict| Judgement {
            verdict,
            reasons: Vec::new(),
            suspended: Vec::new(),
            advisories: Vec::new(),
            time_to_safe_s: None,
            inputs: Vec::new(),
            avoid: Vec::new(),
            speaks_against: false,
        };
        let mut ruling = Ruling::none(at(0), Utc::EPOCH);
        let mut since = |verdict, settled, second| {
            ruling.renew(judgement(verdict), Vec::new(), settled, Utc::from_seconds(second as f64), at(second));
            (ruling.state.since_utc.seconds(), ruling.settled, ruling.judged == at(second))
        };
        assert_eq!(since(Verdict::Unsafe, false, 1), (0.0, false, true));
        assert_eq!(since(Verdict::Safe, true, 2), (2.0, true, true));
        assert_eq!(since(Verdict::Safe, false, 3), (2.0, true, true));
    }

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
