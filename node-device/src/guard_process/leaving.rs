//! A dome that the configuration does not name any more: another address is there, or none. It may be open, and
//! nobody else closes it, so this process does, until it is verified closed.

use std::collections::BTreeSet;
use std::time::Duration;

use bus::MachineTime;
use contract::observatory::AlertKind;

use super::closer::{Closer, Word, alert};
use super::copy::{Copy, DomeCopy};

/// An address at which nobody has answered for so long has no dome any more.
const NOBODY: Duration = Duration::from_secs(3600);

/// Closes all such domes, and lets go those that are closed; `tell` publishes an alert of a dome, or that it is over.
pub fn close_all(domes: &mut Vec<Leaving>, now: MachineTime, mut tell: impl FnMut(AlertKind, &str, Option<String>)) {
    for dome in domes.iter_mut() {
        for word in dome.close(now) {
            word.report(&dome.name, |kind, cause| tell(kind, &dome.name, cause));
        }
    }
    domes.retain(|dome| {
        let Some(why) = dome.is_let_go(now) else { return true };
        tracing::warn!(dome = dome.name, why, "the dome that the configuration named before is let go");
        dome.told.iter().for_each(|kind| tell(*kind, &dome.name, None));
        false
    });
}

/// One such dome.
pub struct Leaving {
    /// Its name with its old address: `dome at 10.0.0.5:11111 number 0`.
    pub name: String,
    closer: Closer,
    since: Option<MachineTime>,
    has_answered: bool,
    told: BTreeSet<AlertKind>,
}

impl Leaving {
    /// The domes of a copy that were not let go when it was stored.
    pub fn of(copy: &mut Copy, now: MachineTime) -> Vec<Self> {
        let domes = std::mem::take(&mut copy.leaving);
        let closers = domes.into_iter().filter_map(|dome| match Closer::new(&dome, &copy.telescope, now) {
            Ok(closer) => Some(Self::new(dome.name.as_str(), closer)),
            Err(error) => {
                tracing::error!(dome = %dome.name, %error, "no HTTP client");
                None
            }
        });
        closers.collect()
    }

    /// What is needed to close it.
    pub fn dome(&self) -> &DomeCopy {
        &self.closer.dome
    }

    /// A dome by its closer.
    pub fn new(name: &str, closer: Closer) -> Self {
        let target = &closer.dome.target;
        let name = format!("{name} at {} number {}", target.server, target.number);
        tracing::warn!(
            dome = name,
            "the configuration does not name this dome any more; it is closed there, and looked after until then"
        );
        Self { name, closer, since: None, has_answered: false, told: BTreeSet::new() }
    }

    /// Closes it, and closes it again.
    fn close(&mut self, now: MachineTime) -> Vec<Word> {
        self.since.get_or_insert(now);
        let mut words = Vec::new();
        self.closer.take_answers(now, &mut words);
        self.closer.close(now, &mut words);
        self.has_answered |= self.closer.has_answered();
        for word in &words {
            if let Word::Alarm(alarm, true) = word {
                self.told.insert(alert(*alarm, &self.name).0);
            }
        }
        words
    }

    /// Why it need not be looked after any more, if so.
    fn is_let_go(&self, now: MachineTime) -> Option<&'static str> {
        if self.closer.is_verified_closed(now) {
            return Some("it is verified closed");
        }
        let nobody = !self.has_answered && self.since.is_some_and(|since| now.since(since) >= NOBODY);
        nobody.then_some("nobody has answered at its old address for an hour")
    }
}
