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
use crate::polling::{LOST_AFTER, Poll, Questions};

/// A reading may be no older than this, so that haste is of no more use (`common/safety`).
const IN_HASTE: Duration = Duration::from_secs(60);
/// A usual device answers long before this.
const ANSWERS_WITHIN: Duration = Duration::from_millis(250);

/// How many polls of what decides brought no whole answer, one after the other.
#[derive(Debug, Default)]
pub(super) struct SilentPolls(usize);

impl SilentPolls {
    /// Takes in a poll; true once the device is gone. Any answer shows that it is there, and the silence of what does not
    /// decide shows nothing.
    pub(super) fn take(&mut self, poll: &Poll, deciding: &[String]) -> bool {
        let mut asked = poll.answers.iter().map(|answer| &answer.property).chain(&poll.unasked);
        if !poll.lost.as_ref().is_some_and(AlpacaError::is_transport) {
            self.0 = 0;
        } else if asked.any(|property| deciding.contains(property)) {
            self.0 += 1;
        }
        self.0 >= LOST_AFTER
    }
}

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
        self.silent_polls = SilentPolls::default();
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

#[cfg(test)]
mod tests {
    use bus::Clock;

    use super::*;
    use crate::now::Now;
    use crate::polling::PropertyAnswer;

    /// A poll that ended with its first property: the others were left unasked.
    fn poll(asked: &[&str], answers: bool) -> Poll {
        let clock = Clock::machine_clock();
        let began = Now { machine: clock.machine(), sky: clock.sky() };
        let result = if answers { Ok(true.into()) } else { Err(AlpacaError::timeout(2.0)) };
        let lost = result.as_ref().err().cloned();
        let property = asked[0].to_owned();
        Poll {
            began,
            began_at: Instant::now(),
            answers: vec![PropertyAnswer { property, result, at_utc: clock.utc(), asked: began }],
            lost,
            full: false,
            device_state: false,
            crowded: false,
            unasked: asked[1..].iter().map(|name| (*name).to_owned()).collect(),
        }
    }

    #[test]
    fn two_properties_that_hang_by_themselves_are_no_device_that_is_gone() {
        let deciding = ["RainRate", "WindSpeed"].map(str::to_owned);
        let is_gone = |polls: &[(&[&str], bool)]| {
            let mut silent = SilentPolls::default();
            polls.iter().map(|(asked, answers)| silent.take(&poll(asked, *answers), &deciding)).collect::<Vec<_>>()
        };
        let (rain, both, rest) = (&["RainRate"][..], &["RainRate", "WindSpeed"][..], &["Pressure"][..]);
        assert_eq!(is_gone(&[(both, false), (both, false)]), [false, true], "what decides is silent twice");
        assert_eq!(is_gone(&[(rest, false), (rain, false)]), [false, false], "one that decides and one that does not");
        assert_eq!(is_gone(&[(rest, false), (rest, false)]), [false, false], "none decides");
        assert_eq!(is_gone(&[(rain, false), (rest, true), (rain, false)]), [false; 3], "the device answers meanwhile");
        assert_eq!(is_gone(&[(rain, false), (rest, false), (rain, false)]), [false, false, true]);
    }
}
