//! What becomes of a device that does not answer, and how soon it is read when it answers again.
//!
//! An outage closes nothing as long as the newest reading of before it is young enough (decision 0129). A question waits 2 s
//! for its answer, a new connection has questions of its own, and the pauses between its tries grow: each would make the
//! reading older than the outage was long. So what decides is asked beside all of that, until it is answered.

use std::time::Duration;

use alpaca::{AlpacaError, STATUS_DEADLINE};
use contract::Link;
use contract::observatory::AlertKind;
use tokio::time::Instant;

use super::unread::ReadingAgain;
use super::{LONGEST_BACK_OFF_S, Loop};
use crate::driver::Driver;
use crate::polling::{Poll, Questions};

/// A reading may be no older than this, so that haste is of no more use (`common/safety`).
const IN_HASTE: Duration = Duration::from_secs(60);
/// A usual device answers long before this.
const ANSWERS_WITHIN: Duration = Duration::from_millis(250);

impl<D: Driver> Loop<D> {
    /// Looks whether a property that decides, and was answered until now, was not answered in this poll: then it is asked
    /// again and again. Before the answers of the poll are kept.
    pub(super) fn note_silence(&mut self, poll: &Poll) {
        let deciding = self.deciding();
        let was_read = |name: &str| self.readings.asked(name).is_some() && self.readings.failure(name).is_none();
        let silent = poll.silent().filter(|name| deciding.contains(*name) && was_read(name.as_str())).cloned();
        let Some(silent) = silent else {
            if poll.silent().is_none() && poll.lost.is_none() {
                self.knocking = None;
            }
            return;
        };
        // What decides is asked again before the rest.
        (self.next_full, self.rest_is_due) = (Instant::now(), false);
        if self.knocking.is_none() {
            let clock = self.serve.node.bus.clock().clone();
            let questions = Questions { alpaca: self.serve.alpaca.clone(), clock };
            // Twice what an answer took, where several are under way at once.
            let usual = self.each.saturating_mul(u32::try_from(self.lanes * 2).unwrap_or(u32::MAX));
            let within = usual.clamp(ANSWERS_WITHIN, STATUS_DEADLINE);
            self.knocking = Some(Box::pin(async move {
                tokio::time::timeout(IN_HASTE, questions.until_answered(&silent, within)).await.is_ok()
            }));
        }
    }

    /// A device that was silent answers again: what was asked of it meanwhile may hang for its whole deadline, and is
    /// asked anew.
    pub(super) fn answers_again(&mut self) {
        self.polling = None;
        self.parts.clear();
        let now = Instant::now();
        (self.next_turn, self.next_full, self.rest_is_due) = (now, now, false);
    }

    /// The device is gone: everything is missing, for this reason, until it is back.
    pub(super) fn lose(&mut self, error: &AlpacaError) {
        let reason = error.no_data();
        if self.link == Link::Connected || self.failures == 0 {
            tracing::warn!(device = %self.serve.device, %error, "device lost; trying again");
        }
        self.link = Link::Lost { reason: reason.clone() };
        let instance = self.instance();
        let cause = format!("{instance} at {} does not answer: {}", self.serve.common.server, error.words());
        self.serve.node.alerts.raise(AlertKind::DeviceLost, &instance, &cause);
        // Also what was never read is missing for this reason.
        let clock = self.serve.node.bus.clock().clone();
        for property in self.wanted() {
            self.readings.keep(&property, Err(reason.clone()), clock.utc());
        }
        self.readings.lose(&reason, clock.utc());
        self.device_state = false;
        self.quiet_until = None;
        self.reading_again = ReadingAgain::default();
        self.observe_now();
        self.note_contradiction();
        self.note_unread();
        self.judge(None);
        let back_off = (0.5 * 2_f64.powi(self.failures)).min(LONGEST_BACK_OFF_S);
        self.failures = (self.failures + 1).min(10);
        // Several devices of one server come back one after another.
        let jitter = 1.0 + f64::from(self.serve.index % 8) * 0.03;
        self.next_turn = Instant::now() + Duration::from_secs_f64(back_off * jitter);
    }
}
