//! The newest verdict with when it was given: whether it still counts, and what follows from it.

use std::time::Duration;

use contract::observatory::{Interval, SafetyState, Unsafe, Verdict};
use units::{MachineTime, Utc};

use crate::judge::{Judgement, time_to_safe_s};
use crate::nodes::NODE_INPUT;

/// The newest verdict as the other tasks of this node see it.
#[derive(Debug, Clone, PartialEq)]
pub struct CurrentVerdict {
    /// The verdict with its reasons, as published.
    pub state: SafetyState,
    /// When it was given.
    pub judged: MachineTime,
    /// False for the first seconds of a node that has not received all of its inputs yet: nobody acts on the verdict
    /// then, so that a restart in a safe night does not shut the roof. A bad input ends this at once.
    pub settled: bool,
    /// Why a dome that is shut stays shut although the sky is safe: something was missed, and is not known.
    pub keeps_shut: Vec<Unsafe>,
    /// The clock may be ahead by so much, s: what has surely passed passed before that.
    pub ahead_s: f64,
}

/// A loop that judges every second is dead or starved when its verdict is older than this.
const MOST_AGE: Duration = Duration::from_secs(5);

impl CurrentVerdict {
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
        Self { state, judged: now, settled: false, keeps_shut: Vec::new(), ahead_s: 0.0 }
    }

    /// Whether a row may begin as far as this is known: one that needs no sky does not in the place of one that only waits
    /// for the first verdict of this node.
    pub fn lets_begin(&self, needs_safe: bool) -> bool {
        self.settled || needs_safe
    }

    /// A judgement as it holds after this verdict: an unsafe one stays unsafe over what was missed, a safe one does not
    /// end for it. Before the first inputs have come, none is known that could stay.
    pub fn hold(&self, mut judgement: Judgement) -> Judgement {
        if judgement.verdict == Verdict::Unsafe || judgement.keeps_shut.is_empty() {
            return judgement;
        }
        if self.settled && self.state.verdict == Verdict::Unsafe {
            judgement.verdict = Verdict::Unsafe;
            judgement.time_to_safe_s = time_to_safe_s(&judgement.keeps_shut);
            judgement.reasons.clone_from(&judgement.keeps_shut);
        } else {
            judgement.advisories.extend(judgement.keeps_shut.iter().cloned());
        }
        judgement
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
        self.keeps_shut = judgement.keeps_shut;
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

    /// Why a dome that is shut stays shut although the sky is safe, if so.
    pub fn why_kept_shut(&self) -> Option<String> {
        (!self.keeps_shut.is_empty()).then(|| in_words(&self.keeps_shut))
    }

    /// Why it stays shut for longer than an answer takes, if so: a dwell runs over what was missed.
    pub fn shut_for_a_dwell(&self) -> Option<String> {
        let of_a_dwell = self.keeps_shut.iter().find(|reason| reason.clears_in_s.is_some());
        of_a_dwell.map(|reason| in_words(std::slice::from_ref(reason)))
    }

    /// Why nothing at all is to be exposed, a dark as little as the sky: a node has too little room for frames, or a wrong
    /// clock.
    pub fn unfit_nodes(&self) -> Option<String> {
        let is_of_node = |reason: &&Unsafe| reason.input.starts_with(NODE_INPUT);
        let reasons: Vec<Unsafe> = self.state.suspended.iter().filter(is_of_node).cloned().collect();
        (!reasons.is_empty()).then(|| in_words(&reasons))
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
    fn before_the_first_verdict_no_row_begins_in_the_place_of_one_that_waits_for_it() {
        let mut verdict = CurrentVerdict::none(MachineTime::from_boot(Duration::ZERO), Utc::EPOCH);
        assert_eq!([true, false].map(|needs_safe| verdict.lets_begin(needs_safe)), [true, false]);
        verdict.settled = true;
        assert_eq!([true, false].map(|needs_safe| verdict.lets_begin(needs_safe)), [true, true]);
    }

    #[test]
    fn a_verdict_that_stays_keeps_its_beginning_and_a_settled_one_stays_settled() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let judgement = |verdict| Judgement {
            verdict,
            reasons: Vec::new(),
            suspended: Vec::new(),
            advisories: Vec::new(),
            keeps_shut: Vec::new(),
            time_to_safe_s: None,
            inputs: Vec::new(),
            avoid: Vec::new(),
            speaks_against: false,
        };
        let mut current_verdict = CurrentVerdict::none(at(0), Utc::EPOCH);
        let mut since = |verdict, settled, second| {
            current_verdict.renew(
                judgement(verdict),
                Vec::new(),
                settled,
                Utc::from_seconds(second as f64),
                at(second),
            );
            (current_verdict.state.since_utc.seconds(), current_verdict.settled, current_verdict.judged == at(second))
        };
        assert_eq!(since(Verdict::Unsafe, false, 1), (0.0, false, true));
        assert_eq!(since(Verdict::Safe, true, 2), (2.0, true, true));
        assert_eq!(since(Verdict::Safe, false, 3), (2.0, true, true));
    }

    #[test]
    fn an_old_verdict_is_no_safe_one() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let mut verdict = CurrentVerdict::none(at(100), Utc::EPOCH);
        verdict.settled = true;
        assert!(verdict.calls_for_closing(at(100)));
        verdict.state.verdict = Verdict::Safe;
        assert!(verdict.is_safe(at(104)) && !verdict.calls_for_closing(at(104)));
        assert!(!verdict.is_safe(at(106)) && verdict.calls_for_closing(at(106)));
    }

    #[test]
    fn a_node_without_room_stops_every_exposure_and_a_cloud_only_those_of_the_sky() {
        let mut current_verdict = CurrentVerdict::none(MachineTime::from_boot(Duration::ZERO), Utc::EPOCH);
        let against = |input: &str| Unsafe { input: input.to_owned(), why: "why".to_owned(), clears_in_s: None };
        current_verdict.state.suspended = vec![against("wx/SkyQuality")];
        assert_eq!(current_verdict.unfit_nodes(), None);
        current_verdict.state.suspended.push(against("node/device/main"));
        assert_eq!(current_verdict.unfit_nodes().as_deref(), Some("node/device/main: why"));
    }
}
