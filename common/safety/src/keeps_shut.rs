//! A dome that is shut stays shut over states that were missed and are not known; one that is open stays open.
//!
//! They may have been bad. While their device node is asked, the answer is waited for. Where it says something against
//! what was received, the dwell of a shut dome begins anew. Where nobody answers, a device without a record is silent like
//! any other, and its allowed age decides.

use std::collections::BTreeMap;
use std::time::Duration;

use config::Response;
use contract::Device;
use contract::observatory::Unsafe;

use super::history::Now;
use super::missed::{Hole, Refusal};
use super::received::History;
use super::rules::Rules;

impl History {
    /// Why a dome that is shut stays shut although all that is known is good: one reason for each device in which
    /// something was missed that its dwell needs.
    pub fn keeps_shut(&self, rules: &Rules, now: Now) -> Vec<Unsafe> {
        let mut dwells: BTreeMap<&Device, Dwell> = BTreeMap::new();
        for (rule, record) in rules.monitors.iter().zip(&self.monitors) {
            let newest = record.newest().and_then(|newest| newest.outcome.as_ref().ok());
            // Its own word for the time before is enough where it is as long as the dwell.
            let is_vouched = newest.is_some_and(|reading| reading.gapless_safe >= rule.dwell);
            dwells.entry(&rule.device).or_default().add(rule.dwell, is_vouched, true);
        }
        for rule in rules.limits.iter().filter(|rule| rule.response == Response::Close) {
            dwells.entry(&rule.device).or_default().add(rule.dwell, false, rule.needs_each());
        }
        dwells.into_iter().filter_map(|(device, dwell)| self.unknown(device, dwell, now)).collect()
    }

    fn unknown(&self, device: &Device, dwell: Dwell, now: Now) -> Option<Unsafe> {
        let input = format!("{}/{}", device.kind, device.name);
        if dwell.is_needed {
            let asks = |hole: &Hole| format!("asks its device node what it published {hole}");
            let asked = self.asked.get(device).map(asks);
            let is_awaited = dwell.needs_each && self.awaited.contains(device);
            let why = asked.or_else(|| is_awaited.then(|| "nothing of it was received since the start".to_owned()));
            if let Some(why) = why {
                return Some(Unsafe { input, why, clears_in_s: None });
            }
        }
        let Refusal { hole, why, at } = self.refused.get(device)?;
        let passed = now.sky.since(at.sky);
        let left = dwell.longest.checked_sub(passed).filter(|left| !left.is_zero())?;
        let minutes = |duration: Duration| duration.as_secs_f64() / 60.0;
        let why = format!(
            "what its device node published {hole} is not known, since {why}: {:.1} of {:.1} min have passed",
            minutes(passed),
            minutes(dwell.longest)
        );
        let clears_in_s = (dwell.longest != Duration::MAX).then_some(left.as_secs_f64());
        Some(Unsafe { input, why, clears_in_s })
    }
}

/// What the rules want of a device's past.
#[derive(Debug, Clone, Copy, Default)]
struct Dwell {
    /// Sky time.
    longest: Duration,
    /// Some of it rests on what was received.
    is_needed: bool,
    /// The dome cannot do without the device.
    needs_each: bool,
}

impl Dwell {
    fn add(&mut self, dwell: Duration, is_vouched: bool, needs_each: bool) {
        self.longest = self.longest.max(dwell);
        self.needs_each |= needs_each;
        self.is_needed |= !is_vouched && !dwell.is_zero();
    }
}

#[cfg(test)]
#[path = "keeps_shut_tests.rs"]
mod tests;
