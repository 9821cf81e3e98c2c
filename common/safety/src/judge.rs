//! The verdict: a pure function of the rules, of the received states, and of now.
//!
//! Unknown, stale, NaN and missing are unsafe with a reason; any unsafe input makes the whole unsafe. Nothing is safe
//! from the start: the dwell window of every input must be filled with good readings without a gap. The device nodes
//! may vouch for the time before this node was started (`recall.rs`; a safety monitor's state contains how long).

use std::time::Duration;

use config::Response;
use contract::observatory::{InputLimit, InputState, Sector, Unsafe, Verdict};

use super::history::{Evidence, Now, Record};
use super::reading::{Measured, MonitorReading};
use super::received::History;
use super::rules::{LimitRule, MonitorRule, Rules};

/// The verdict and what it rests on.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// The verdict.
    pub verdict: Verdict,
    /// Why it is unsafe; empty when safe.
    pub reasons: Vec<Unsafe>,
    /// Why the sky is not to be exposed, in addition to the reasons.
    pub suspended: Vec<Unsafe>,
    /// What is only reported.
    pub advisories: Vec<Unsafe>,
    /// Why a dome that is shut stays shut, whatever the verdict: something was missed, and is not known. An open one stays
    /// open over it.
    pub keeps_shut: Vec<Unsafe>,
    /// Sky seconds until all known dwell times have run out; `None` where nobody can know.
    pub time_to_safe_s: Option<f64>,
    /// Every input with its newest value and age.
    pub inputs: Vec<InputState>,
    /// Directions that no telescope is to point to.
    pub avoid: Vec<Sector>,
    /// Some input has a bad value now, as opposed to no value.
    pub speaks_against: bool,
}

/// Judges.
pub fn judge(rules: &Rules, history: &History, now: Now) -> Judgement {
    let mut evaluation = Evaluation::default();
    if let Some(why) = &rules.stay_closed {
        evaluation.speaks_against = true;
        evaluation.closing("stay closed", why.clone(), None);
    }
    if rules.monitors.is_empty() && !rules.limits.iter().any(|rule| rule.response == Response::Close) {
        let why = "no safety monitor and no limit that closes is in use, so that no input reports whether it rains; add one to \
                   observatory.toml";
        evaluation.closing("safety inputs", why.to_owned(), None);
    }
    for (index, rule) in rules.monitors.iter().enumerate() {
        match history.monitors.get(index) {
            Some(record) => evaluate_monitor(rule, record, history.allowed_of_monitor(rule), now, &mut evaluation),
            None => evaluation.closing(&rule.input, "nothing received yet".to_owned(), None),
        }
    }
    for (rule, record) in limits(rules, history) {
        if rule.needs_each() {
            evaluate_required(rule, record, history.allowed(rule), now, &mut evaluation);
        } else {
            evaluate_optional(rule, record, history, now, &mut evaluation);
        }
    }
    evaluate_votes(rules, history, now, &mut evaluation);
    if let Some(most_deg) = rules.sun_altitude_max_deg {
        evaluate_sun(most_deg, history, &mut evaluation);
    }
    if !rules.frozen_after.is_zero() {
        evaluate_frozen(rules, history, now, &mut evaluation);
    }
    for complaint in history.nodes.complaints(rules.clock_offset_max_s, rules.disk_free_min_gb, now.machine) {
        evaluation.against(Response::Suspend, &complaint.input, complaint.why, None);
    }
    let avoid = rules.wind_sector.map(|sector| history.winds.sectors(&sector, now.machine)).unwrap_or_default();
    Judgement { avoid, keeps_shut: history.keeps_shut(rules, now), ..evaluation.close() }
}

/// The limits with their received values; both were made from the same rules.
fn limits<'a>(
    rules: &'a Rules,
    history: &'a History,
) -> impl Iterator<Item = (&'a LimitRule, &'a Record<Measured>)> + Clone {
    rules.limits.iter().zip(&history.limits)
}

#[derive(Default)]
struct Evaluation {
    reasons: Vec<Unsafe>,
    suspended: Vec<Unsafe>,
    advisories: Vec<Unsafe>,
    inputs: Vec<InputState>,
    speaks_against: bool,
}

impl Evaluation {
    fn against(&mut self, response: Response, input: &str, why: String, clears_in: Option<Duration>) {
        let clears_in_s = clears_in.map(|left| left.as_secs_f64());
        let reasons = match response {
            Response::Close => &mut self.reasons,
            Response::Suspend => &mut self.suspended,
            Response::Advise => &mut self.advisories,
        };
        reasons.push(Unsafe { input: input.to_owned(), why, clears_in_s });
    }

    fn closing(&mut self, input: &str, why: String, clears_in: Option<Duration>) {
        self.against(Response::Close, input, why, clears_in);
    }

    /// A limit that is violated now, or of whose window too little is known; `when` follows a value in the reason.
    fn violated(&mut self, rule: &LimitRule, measured: Measured, when: &str) {
        let Measured { value, unknown_for, contradiction, .. } = measured;
        if let Some(contradiction) = contradiction.filter(|_| rule.bad.contain(value)) {
            return self.against(rule.response, &rule.input, format!("{contradiction}{when}"), None);
        }
        if rule.reopen.contain(value) && !unknown_for.is_zero() {
            let over = rule.measure.over();
            let known_for = over.saturating_sub(unknown_for);
            let why = format!("values for {:.1} of the {:.1} min that are needed", minutes(known_for), minutes(over));
            let left = (rule.dwell != Duration::MAX).then(|| unknown_for.saturating_add(rule.dwell));
            return self.against(rule.response, &rule.input, why, left);
        }
        // A value that is not good enough to reopen is not bad yet: a record of the time before may know that it was
        // good.
        self.speaks_against |= rule.response == Response::Close && !rule.bad.contain(value);
        self.against(rule.response, &rule.input, violation(rule, value) + when, None);
    }

    /// A dwell that is not filled yet.
    fn unproven(&mut self, response: Response, input: &str, proven: Duration, dwell: Duration) {
        if proven < dwell {
            let why = format!("good for {:.1} of {:.1} min", minutes(proven), minutes(dwell));
            // A dwell that never ends has no end to report.
            let left = (dwell != Duration::MAX).then_some(dwell.saturating_sub(proven));
            self.against(response, input, why, left);
        }
    }

    fn input<T: Clone>(&mut self, input: &str, record: &Record<T>, now: Now, good: bool, words: impl Fn(&T) -> String) {
        let newest = record.newest();
        self.inputs.push(InputState {
            limits: Vec::new(),
            input: input.to_owned(),
            value: match newest.map(|entry| &entry.outcome) {
                None => record.nothing(),
                Some(Ok(value)) => words(value),
                Some(Err(reason)) => reason.clone(),
            },
            age_s: newest.map(|entry| now.machine.since(entry.at.machine).as_secs_f64()),
            good,
        });
    }

    fn close(self) -> Judgement {
        let verdict = if self.reasons.is_empty() { Verdict::Safe } else { Verdict::Unsafe };
        Judgement {
            verdict,
            time_to_safe_s: time_to_safe_s(&self.reasons),
            reasons: self.reasons,
            suspended: self.suspended,
            advisories: self.advisories,
            keeps_shut: Vec::new(),
            inputs: self.inputs,
            avoid: Vec::new(),
            speaks_against: self.speaks_against,
        }
    }
}

/// Sky seconds until all reasons are gone; `None` where nobody can know.
pub(crate) fn time_to_safe_s(reasons: &[Unsafe]) -> Option<f64> {
    let mut left_s = reasons.iter().map(|reason| reason.clears_in_s);
    left_s.try_fold(0.0, |longest: f64, left| left.map(|left| longest.max(left)))
}

fn minutes(duration: Duration) -> f64 {
    duration.as_secs_f64() / 60.0
}

fn evaluate_monitor(
    rule: &MonitorRule,
    record: &Record<MonitorReading>,
    allowed: Duration,
    now: Now,
    evaluation: &mut Evaluation,
) {
    let evidence = record.evidence(now, allowed, |reading| reading.is_safe);
    let good = matches!(evidence, Evidence::Good { .. });
    evaluation.input(&rule.input, record, now, good, |reading| {
        if reading.is_safe { "safe".to_owned() } else { "not safe".to_owned() }
    });
    match evidence {
        Evidence::Missing(reason) => evaluation.closing(&rule.input, reason, None),
        Evidence::Bad(_) => {
            evaluation.speaks_against = true;
            evaluation.closing(&rule.input, "says that it is not safe".to_owned(), None);
        }
        Evidence::Good { since, newest } => {
            let proven = now.sky.since(since).max(newest.gapless_safe);
            evaluation.unproven(Response::Close, &rule.input, proven, rule.dwell);
        }
    }
}

/// What a limit's record proves, noted among the inputs.
fn weigh(
    rule: &LimitRule,
    record: &Record<Measured>,
    allowed: Duration,
    now: Now,
    evaluation: &mut Evaluation,
) -> Evidence<Measured> {
    let evidence = record.evidence(now, allowed, |measured| !measured.tripped);
    let good = matches!(evidence, Evidence::Good { .. });
    evaluation.input(&rule.input, record, now, good, |measured| number(measured.value));
    let dwell_s = (rule.dwell != Duration::MAX).then_some(rule.dwell.as_secs_f64());
    let limit = InputLimit { upper: rule.bad.upper, lower: rule.bad.lower, dwell_s };
    evaluation.inputs.last_mut().into_iter().for_each(|input| input.limits = vec![limit.clone()]);
    if let Evidence::Good { newest, .. } = &evidence
        && !rule.reopen.contain(newest.value)
    {
        let why = format!("{} is near its limit", number(newest.value));
        evaluation.against(Response::Advise, &rule.input, why, None);
    }
    evidence
}

fn evaluate_required(
    rule: &LimitRule,
    record: &Record<Measured>,
    allowed: Duration,
    now: Now,
    evaluation: &mut Evaluation,
) {
    match weigh(rule, record, allowed, now, evaluation) {
        Evidence::Missing(reason) => evaluation.against(rule.response, &rule.input, reason, None),
        Evidence::Bad(measured) => evaluation.violated(rule, measured, ""),
        Evidence::Good { since, .. } => {
            evaluation.unproven(rule.response, &rule.input, now.sky.since(since), rule.dwell);
        }
    }
}

/// A limit that the site can do without, or that others vote with: a missing value is no violation, but a bad one stays
/// one until a good one has come, and the dwell counts from the last bad one or the start of the listening; a record of
/// the time before counts from the first value that it holds, since a bad one may have come before.
fn evaluate_optional(
    rule: &LimitRule,
    record: &Record<Measured>,
    history: &History,
    now: Now,
    evaluation: &mut Evaluation,
) {
    weigh(rule, record, history.allowed(rule), now, evaluation);
    if let Some(Ok(measured)) = record.last_known().map(|entry| &entry.outcome)
        && measured.tripped
    {
        return evaluation.violated(rule, *measured, " when last received");
    }
    let violations = record.entries().filter(|entry| entry.outcome.as_ref().is_ok_and(|measured| measured.tripped));
    let last_bad = violations.map(|entry| entry.at.sky).max();
    let received_since = record.known_since().map_or(history.since, |known| known.min(history.since));
    let proven = now.sky.since(last_bad.map_or(received_since, |bad| bad.max(received_since)));
    evaluation.unproven(rule.response, &rule.input, proven, rule.dwell);
}

/// Of those that vote, one must have a gapless good record over its dwell: when all are silent, nobody knows.
fn evaluate_votes(rules: &Rules, history: &History, now: Now, evaluation: &mut Evaluation) {
    let mut voted: Vec<(&str, Response)> = Vec::new();
    for rule in &rules.limits {
        let Some(vote) = rule.vote.as_deref().filter(|vote| !voted.contains(&(*vote, rule.response))) else {
            continue;
        };
        voted.push((vote, rule.response));
        let voters = limits(rules, history)
            .filter(|(other, _)| other.vote.as_deref() == Some(vote) && other.response == rule.response);
        let proven = voters.filter_map(|(other, record)| {
            match record.evidence(now, history.allowed(other), |measured| !measured.tripped) {
                Evidence::Good { since, .. } => Some((now.sky.since(since), other.dwell)),
                Evidence::Missing(_) | Evidence::Bad(_) => None,
            }
        });
        let input = format!("vote/{vote}");
        match proven.min_by_key(|(proven, dwell)| dwell.saturating_sub(*proven)) {
            Some((proven, dwell)) => evaluation.unproven(rule.response, &input, proven, dwell),
            None => evaluation.against(rule.response, &input, "no station has a good value".to_owned(), None),
        }
    }
}

fn evaluate_sun(most_deg: f64, history: &History, evaluation: &mut Evaluation) {
    let altitude_deg = &history.sun.altitude_deg;
    let (input, is_low) = ("sun", altitude_deg.as_ref().is_ok_and(|altitude_deg| *altitude_deg <= most_deg));
    let value = altitude_deg.as_ref().map_or_else(Clone::clone, |altitude_deg| format!("{altitude_deg:.1} deg"));
    if !is_low {
        evaluation.speaks_against |= altitude_deg.is_ok();
        let by = history.sun.by.as_ref().map(|by| format!(" if {by}")).unwrap_or_default();
        evaluation.closing(
            input,
            match altitude_deg {
                Ok(altitude_deg) if altitude_deg.is_finite() => {
                    format!(
                        "altitude {} deg{by}, allowed are {} deg",
                        beyond(*altitude_deg, most_deg, 1),
                        number(most_deg)
                    )
                }
                _ => format!("altitude {value}{by}, allowed are {} deg", number(most_deg)),
            },
            history.sun.low_in,
        );
    }
    let limits = vec![InputLimit { upper: Some(most_deg), lower: None, dwell_s: None }];
    evaluation.inputs.push(InputState { input: input.to_owned(), value, age_s: Some(0.0), good: is_low, limits });
}

/// A station of these limits whose values do not move any more.
fn evaluate_frozen(rules: &Rules, history: &History, now: Now, evaluation: &mut Evaluation) {
    for (station, still) in history.freeze.stand_still(now.machine) {
        if still < rules.frozen_after / 2 || !rules.limits.iter().any(|rule| rule.device == *station) {
            continue;
        }
        let frozen = still >= rules.frozen_after;
        let why = format!("all its values have been the same for {:.0} min", minutes(still));
        let response = if frozen { Response::Close } else { Response::Advise };
        evaluation.against(response, &format!("{}/frozen", station.name), why, None);
    }
}

fn number(value: f64) -> String {
    format!("{:.2}", value).trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// A value with so many decimals, or as many more as show that it is not its limit.
fn beyond(value: f64, limit: f64, decimals: usize) -> String {
    let shown = |decimals: usize| format!("{value:.decimals$}");
    let decimals =
        (decimals..=6).find(|decimals| shown(*decimals) != format!("{limit:.decimals$}")).unwrap_or(decimals);
    shown(decimals)
}

fn violation(rule: &LimitRule, value: f64) -> String {
    let words = |limit: f64| match number(value) {
        same if same == number(limit) => beyond(value, limit, 3),
        words => words,
    };
    match (rule.bad.upper, rule.bad.lower, rule.reopen.upper, rule.reopen.lower) {
        (Some(upper), ..) if value > upper => format!("{} is above {}", words(upper), number(upper)),
        (_, Some(lower), ..) if value < lower => format!("{} is below {}", words(lower), number(lower)),
        (_, _, Some(upper), _) if value > upper => format!("{} is not down to {} yet", words(upper), number(upper)),
        (_, _, _, Some(lower)) if value < lower => format!("{} is not up to {} yet", words(lower), number(lower)),
        // It is within both bounds.
        _ => format!("{} is not known to be good", number(value)),
    }
}

#[cfg(test)]
#[path = "judge_tests.rs"]
mod tests;

#[cfg(test)]
#[path = "judge_site_tests.rs"]
mod site_tests;

#[cfg(test)]
#[path = "judge_age_tests.rs"]
mod age_tests;

#[cfg(test)]
#[path = "judge_restart_tests.rs"]
mod restart_tests;
