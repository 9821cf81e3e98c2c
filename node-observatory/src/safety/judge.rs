//! The verdict: a pure function of the rules, of what was heard, and of now.
//!
//! Unknown, stale, NaN and missing are unsafe with a reason; any unsafe input makes the whole unsafe. Nothing is
//! safe from the start: the dwell window of every input must be filled with good readings without a gap. A safety
//! monitor's device node may vouch for the time before this node was started.

use std::time::Duration;

use contract::observatory::{InputState, Unsafe, Verdict};

use super::history::{Evidence, Now, Record};
use super::rules::{History, LimitRule, MonitorReading, MonitorRule, Rules};

/// The verdict and what it rests on.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// The verdict.
    pub verdict: Verdict,
    /// Why it is unsafe; empty when safe.
    pub reasons: Vec<Unsafe>,
    /// Sky seconds until all known dwell times have run out; `None` where nobody can know.
    pub time_to_safe_s: Option<f64>,
    /// Every input with its newest value and age.
    pub inputs: Vec<InputState>,
    /// Some input says something bad now, as opposed to saying nothing.
    pub speaks_against: bool,
}

/// Judges.
pub fn judge(rules: &Rules, history: &History, now: Now) -> Judgement {
    let mut hearing = Hearing::default();
    if rules.monitors.is_empty() && rules.limits.is_empty() {
        hearing.against("configuration", "no safety monitor and no weather limit is configured".to_owned(), None);
    }
    for (index, rule) in rules.monitors.iter().enumerate() {
        match history.monitors.get(index) {
            Some(record) => hear_monitor(rule, record, now, &mut hearing),
            None => hearing.against(&rule.input, "nothing heard yet".to_owned(), None),
        }
    }
    for (index, rule) in rules.limits.iter().enumerate() {
        match history.limits.get(index) {
            Some(record) if rule.required => hear_required(rule, record, now, &mut hearing),
            Some(record) => hear_optional(rule, record, history, now, &mut hearing),
            None => hearing.against(&rule.input, "nothing heard yet".to_owned(), None),
        }
    }
    hearing.close()
}

#[derive(Default)]
struct Hearing {
    reasons: Vec<Unsafe>,
    inputs: Vec<InputState>,
    speaks_against: bool,
}

impl Hearing {
    fn against(&mut self, input: &str, why: String, clears_in: Option<Duration>) {
        let clears_in_s = clears_in.map(|left| left.as_secs_f64());
        self.reasons.push(Unsafe { input: input.to_owned(), why, clears_in_s });
    }

    fn input<T: Clone>(&mut self, input: &str, record: &Record<T>, now: Now, good: bool, words: impl Fn(&T) -> String) {
        let newest = record.newest();
        self.inputs.push(InputState {
            input: input.to_owned(),
            value: match newest.map(|entry| &entry.outcome) {
                None => "nothing heard yet".to_owned(),
                Some(Ok(value)) => words(value),
                Some(Err(reason)) => reason.clone(),
            },
            age_s: newest.map(|entry| now.machine.since(entry.at.machine).as_secs_f64()),
            good,
        });
    }

    fn close(self) -> Judgement {
        let verdict = if self.reasons.is_empty() { Verdict::Safe } else { Verdict::Unsafe };
        let longest = self
            .reasons
            .iter()
            .map(|reason| reason.clears_in_s)
            .try_fold(0.0, |longest: f64, left| left.map(|left| longest.max(left)));
        Judgement {
            verdict,
            time_to_safe_s: longest,
            reasons: self.reasons,
            inputs: self.inputs,
            speaks_against: self.speaks_against,
        }
    }
}

/// Words for a window that is not filled yet.
fn not_filled(proven: Duration, dwell: Duration) -> (String, Option<Duration>) {
    let left = dwell.saturating_sub(proven);
    let why = format!("good for {:.1} of {:.1} min", minutes(proven), minutes(dwell));
    // a dwell that never ends has no end to tell
    (why, (dwell != Duration::MAX).then_some(left))
}

fn minutes(duration: Duration) -> f64 {
    duration.as_secs_f64() / 60.0
}

fn hear_monitor(rule: &MonitorRule, record: &Record<MonitorReading>, now: Now, hearing: &mut Hearing) {
    let evidence = record.evidence(now, rule.max_age, |reading| reading.is_safe);
    let good = matches!(evidence, Evidence::Good { .. });
    hearing.input(&rule.input, record, now, good, |reading| {
        if reading.is_safe { "safe".to_owned() } else { "not safe".to_owned() }
    });
    match evidence {
        Evidence::Missing(reason) => hearing.against(&rule.input, reason, None),
        Evidence::Bad(_) => {
            hearing.speaks_against = true;
            hearing.against(&rule.input, "says that it is not safe".to_owned(), None);
        }
        Evidence::Good { since, newest } => {
            let proven = now.sky.since(since).max(newest.gapless_safe);
            if proven < rule.dwell {
                let (why, left) = not_filled(proven, rule.dwell);
                hearing.against(&rule.input, why, left);
            }
        }
    }
}

fn hear_required(rule: &LimitRule, record: &Record<f64>, now: Now, hearing: &mut Hearing) {
    let evidence = record.evidence(now, rule.max_age, |value| rule.allows(*value));
    let good = matches!(evidence, Evidence::Good { .. });
    hearing.input(&rule.input, record, now, good, |value| number(*value));
    match evidence {
        Evidence::Missing(reason) => hearing.against(&rule.input, reason, None),
        Evidence::Bad(value) => {
            hearing.speaks_against = true;
            hearing.against(&rule.input, violation(rule, value), None);
        }
        Evidence::Good { since, .. } => {
            let proven = now.sky.since(since);
            if proven < rule.dwell {
                let (why, left) = not_filled(proven, rule.dwell);
                hearing.against(&rule.input, why, left);
            }
        }
    }
}

/// A limit that the site can do without: a missing value is no violation, but a bad one stays one until a good one
/// has come, and the dwell counts from the last bad one or the start of the listening.
fn hear_optional(rule: &LimitRule, record: &Record<f64>, history: &History, now: Now, hearing: &mut Hearing) {
    let evidence = record.evidence(now, rule.max_age, |value| rule.allows(*value));
    hearing.input(&rule.input, record, now, matches!(evidence, Evidence::Good { .. }), |value| number(*value));
    if let Some(Ok(value)) = record.last_known().map(|entry| &entry.outcome)
        && !rule.allows(*value)
    {
        hearing.speaks_against = true;
        return hearing.against(&rule.input, format!("{} when last heard", violation(rule, *value)), None);
    }
    let violations = record.entries().filter(|entry| entry.outcome.as_ref().is_ok_and(|value| !rule.allows(*value)));
    let last_bad = violations.map(|entry| entry.at.sky).max();
    let proven = now.sky.since(last_bad.map_or(history.since, |bad| bad.max(history.since)));
    if proven < rule.dwell {
        let (why, left) = not_filled(proven, rule.dwell);
        hearing.against(&rule.input, why, left);
    }
}

fn number(value: f64) -> String {
    format!("{:.2}", value).trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn violation(rule: &LimitRule, value: f64) -> String {
    let value_words = number(value);
    match (rule.upper, rule.lower) {
        (Some(upper), _) if value > upper => format!("{value_words} is above {}", number(upper)),
        (_, Some(lower)) if value < lower => format!("{value_words} is below {}", number(lower)),
        _ => format!("{value_words} is not allowed"),
    }
}

#[cfg(test)]
#[path = "judge_tests.rs"]
mod tests;
