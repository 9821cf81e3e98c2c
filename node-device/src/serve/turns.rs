//! Whose turn it is to be asked, and what becomes of a loop that was stalled.

use std::time::Duration;

use contract::{Link, NoData};
use tokio::time::Instant;

use super::{Loop, Turn};
use crate::deciding;
use crate::driver::Driver;
use crate::polling::{LANES, Poll, Wanted};

/// A loop turns at least so often, also while it waits for an answer ...
pub(super) const LOOK: Duration = Duration::from_secs(1);
/// ... and one that has not for so long was stalled: its process was stopped, its runtime was blocked, or its host slept. A busy
/// machine alone is not so late.
pub(super) const STALL: Duration = Duration::from_millis(2750);
/// A reading from before a stall is not published again; the device has so long to answer anew.
const READ_ANEW: Duration = Duration::from_millis(2500);

impl<D: Driver> Loop<D> {
    /// Properties that decide are read apart from the rest, unless there are no others. While a command runs, its
    /// progress is read instead.
    pub(super) fn splits(&self) -> bool {
        self.running.is_none() && self.serve.driver.moving().is_empty() && !self.deciding().is_empty()
    }

    pub(super) fn deciding(&self) -> Vec<String> {
        let polled = self.has.present(self.serve.driver.polled().into_iter());
        deciding::properties(&self.serve.node.config, &self.serve.device, &polled)
    }

    /// What is to be asked now.
    pub(super) fn next_wanted(&mut self, now: Instant) -> Wanted {
        let (device_state, lanes) = (self.device_state, self.lanes);
        let whole = |properties, full| Wanted { properties, full, device_state, lanes: 1, publish_after: None };
        if !self.splits() {
            let driver = self.serve.driver.clone();
            let full = now >= self.next_full || driver.moving().is_empty();
            if !full {
                return whole(self.has.present(driver.moving().iter().map(|&name| name.to_owned())), false);
            }
            self.next_full = now + self.period();
            return whole(self.wanted(), true);
        }
        let deciding = self.deciding();
        // Properties that are asked in one round are published at its end, so a long round is asked one by one.
        let round = self.each.saturating_mul(u32::try_from(deciding.len()).unwrap_or(u32::MAX));
        if self.lanes == 1 && (round * 4 > self.period() || !self.parts.is_empty()) {
            return self.next_part(now, deciding);
        }
        let publish_after = Some(self.period() / 2);
        if !self.parts.is_empty() {
            let properties = self.parts.drain(..).collect();
            return Wanted { properties, full: true, device_state: false, lanes, publish_after };
        }
        if self.rest_is_due && !self.rest.is_empty() {
            // A part of the rest that takes no longer than a quarter of a period, and what decides has its turn again.
            let room = (self.period() / 4).as_secs_f64() / self.each.as_secs_f64().max(1e-3);
            let count = (room as usize).clamp(lanes, self.rest.len().max(lanes)).min(self.rest.len());
            let properties = self.rest.drain(..count).collect();
            self.rest_is_due = false;
            // A device that becomes slow meanwhile does not keep what decides waiting for all of it.
            let publish_after = Some(self.period() / 4);
            return Wanted { properties, full: false, device_state: false, lanes, publish_after };
        }
        if self.rest.is_empty() {
            self.rest = self.wanted().into_iter().filter(|name| !deciding.contains(name)).collect();
        }
        self.rest_is_due = !self.rest.is_empty();
        self.next_full = now + self.serve.node.bus.clock().machine().to_tick(self.period());
        // A safety monitor is asked itself, whatever its server has cached.
        let device_state = device_state && deciding.len() > 1;
        Wanted { properties: deciding, full: true, device_state, lanes, publish_after }
    }

    /// A slow device that can answer one question at a time is asked one, and its answer is published, before the next:
    /// what decides in turn, and one property of the rest in each round.
    fn next_part(&mut self, now: Instant, deciding: Vec<String>) -> Wanted {
        self.rest_is_due = false;
        if self.parts.is_empty() {
            if self.rest.is_empty() {
                self.rest = self.wanted().into_iter().filter(|name| !deciding.contains(name)).collect();
            }
            self.parts = deciding.into_iter().chain(self.rest.pop_front()).collect();
            self.next_full = now + self.serve.node.bus.clock().machine().to_tick(self.period());
        }
        let properties = self.parts.pop_front().into_iter().collect();
        Wanted { properties, full: false, device_state: false, lanes: 1, publish_after: None }
    }

    /// Measures by a poll how fast the device is: a slow one is asked several things at once, as long as it can bear
    /// that.
    pub(super) fn pace(&mut self, poll: &Poll) {
        let took = poll.began_at.elapsed();
        // The time that was waited for an answer that did not come does not show how fast others come.
        let answers = poll.silent().is_none();
        if answers {
            self.each = took / u32::try_from(poll.answers.len().max(1)).unwrap_or(1);
        }
        self.one_lane |= poll.crowded;
        let slow = answers && (poll.answers.len() > 1 || !poll.unasked.is_empty()) && took > self.period() / 2;
        if poll.full {
            self.parts.extend(poll.unasked.iter().cloned());
        } else {
            // For the rest, properties that decide have their turn before.
            poll.unasked.iter().rev().for_each(|property| self.rest.push_front(property.clone()));
        }
        if self.one_lane {
            self.lanes = 1;
        } else if slow && self.lanes == 1 {
            tracing::info!(device = %self.serve.device, took_s = took.as_secs_f64(), "slow to answer; asked several things at once");
            self.lanes = LANES;
        }
    }

    /// Was the loop stalled? Then what it had read and asked before is dropped, and the device is asked at once.
    pub(super) fn stood_still(&mut self) -> bool {
        let clock = self.serve.node.bus.clock().clone();
        let now = clock.machine();
        let Some(since) = self.looks.stood_still_since(now) else { return false };
        let detail = format!("this node was stalled for {:.1} s", now.since(since).as_secs_f64());
        tracing::warn!(device = %self.serve.device, "{detail}; what was read before is dropped");
        self.polling = None;
        self.readings.drop_polled(&NoData::new("stale", detail), clock.utc());
        self.observe_now();
        let at_once = Instant::now();
        if self.link == Link::Connected {
            (self.next_full, self.rest_is_due) = (at_once, false);
            self.quiet_until = Some(at_once + READ_ANEW);
        }
        self.next_turn = at_once;
        true
    }
}

impl<D: Driver> Turn<D> {
    /// Whether a loop that `stood_still` goes by it: what was asked before a stall means nothing after it. Above all, a
    /// deadline that passed meanwhile shows no silent device.
    pub(super) fn counts(&self, stood_still: bool) -> bool {
        !(stood_still && matches!(self, Self::Polling(_)))
    }
}

#[cfg(test)]
mod tests {
    use alpaca::AlpacaError;
    use bus::{MachineTime, SkyTime};
    use node::Looks;

    use super::super::Polling;
    use super::*;
    use crate::driver::filter_wheel::FilterWheel;
    use crate::now::Now;

    fn at(ms: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_millis(ms))
    }

    /// A poll whose question was not answered before its deadline.
    fn unanswered() -> Turn<FilterWheel> {
        let began = Now { machine: at(0), sky: SkyTime::from_start(Duration::ZERO) };
        let (answers, unasked, lost) = (Vec::new(), Vec::new(), Some(AlpacaError::timeout(2.0)));
        let began_at = Instant::now();
        let poll = Poll { began, began_at, answers, lost, full: true, device_state: false, crowded: false, unasked };
        Turn::Polling(Polling::Polled(poll))
    }

    #[test]
    fn a_deadline_that_passed_while_the_node_stood_still_loses_no_device() {
        for (next_look_ms, is_lost) in [(1000, true), (2700, true), (2800, false), (4000, false)] {
            let stood_still = Looks::begin(at(0), STALL).stood_still_since(at(next_look_ms)).is_some();
            assert_eq!(unanswered().counts(stood_still), is_lost, "the next look after {next_look_ms} ms");
            assert!(Turn::<FilterWheel>::Due.counts(stood_still), "only answers are dropped");
        }
    }
}
