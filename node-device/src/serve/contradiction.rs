//! Raises an alert for a device that says something of itself that cannot be, for a while.

use std::time::Duration;

use contract::Link;
use contract::observatory::AlertKind;
use tokio::time::Instant;

use super::Loop;
use crate::deadline::machine_limit;
use crate::driver::Driver;

/// What a device says for a shorter time, sky time, may be on its way.
const FOR_A_WHILE: Duration = Duration::from_secs(30);

/// Since when a device contradicts itself.
#[derive(Debug, Default)]
pub(super) struct Contradiction(Option<Instant>);

impl Contradiction {
    /// Is it seen, and has it been seen without a gap for so long?
    fn stands(&mut self, is_seen: bool, now: Instant, limit: Duration) -> bool {
        self.0 = is_seen.then(|| self.0.unwrap_or(now));
        self.0.is_some_and(|since| now.duration_since(since) >= limit)
    }
}

impl<D: Driver> Loop<D> {
    /// New readings came, or the link was lost.
    pub(super) fn note_contradiction(&mut self) {
        let driver = &self.serve.driver;
        let command = self.running.as_ref().map(|running| &running.order.command);
        let seen = Some(driver.fields(&self.readings)).filter(|_| self.link == Link::Connected);
        let seen = seen.and_then(|fields| driver.contradiction(command, &fields));
        let limit = machine_limit(self.serve.node.bus.clock(), FOR_A_WHILE);
        let stands = self.contradiction.stands(seen.is_some(), Instant::now(), limit);
        let instance = self.instance();
        let alerts = &self.serve.node.alerts;
        match seen {
            Some(seen) if stands => {
                alerts.raise(AlertKind::DeviceContradicts, &instance, &format!("{instance}: {seen}"))
            }
            Some(_) => {}
            None => alerts.clear(AlertKind::DeviceContradicts, &instance),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_contradiction_stands_when_it_was_seen_without_a_gap_for_a_while() {
        let (mut contradiction, start) = (Contradiction::default(), Instant::now());
        let mut at = |s: u64, is_seen| contradiction.stands(is_seen, start + Duration::from_secs(s), FOR_A_WHILE);
        assert!(!at(0, true) && !at(29, true) && at(30, true) && at(100, true));
        assert!(!at(101, false) && !at(102, true) && !at(131, true) && at(132, true));
    }
}
