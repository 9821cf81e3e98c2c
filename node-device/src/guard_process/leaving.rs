//! A dome that the configuration does not name any more: another address is there, or none. It may be open, and
//! nobody else closes it, so this process does, until it is verified closed.

use std::collections::BTreeSet;

use bus::MachineTime;
use contract::observatory::AlertKind;

use super::closer::{Closer, Word, alert};
use super::copy::{Copy, DomeCopy};

/// Closes all such domes, and lets go those that are closed; `set_alert` publishes an alert of a dome, or that it is
/// over.
pub fn close_all(
    domes: &mut Vec<Leaving>,
    now: MachineTime,
    mut set_alert: impl FnMut(AlertKind, &str, Option<String>),
) {
    for dome in domes.iter_mut() {
        for word in dome.closer.leave(now) {
            if let Word::Alarm(alarm, true) = &word {
                dome.reported.insert(alert(*alarm, &dome.name).0);
            }
            word.report(&dome.name, |kind, cause| set_alert(kind, &dome.name, cause));
        }
    }
    domes.retain(|dome| {
        let Some(why) = dome.closer.is_let_go(now) else { return true };
        tracing::warn!(dome = dome.name, why, "the dome that the configuration named before is let go");
        dome.reported.iter().for_each(|kind| set_alert(*kind, &dome.name, None));
        false
    });
}

/// One such dome.
pub struct Leaving {
    /// Its name with its old address: `dome at 10.0.0.5:11111 number 0`.
    pub name: String,
    closer: Closer,
    reported: BTreeSet<AlertKind>,
}

impl Leaving {
    /// The domes of a copy that were not let go when it was stored.
    pub fn of(copy: &mut Copy) -> Vec<Self> {
        let domes = std::mem::take(&mut copy.leaving);
        let closers = domes.iter().filter_map(|dome| Some((dome, Closer::new(dome, &copy.telescope)?)));
        closers.map(|(dome, closer)| Self::new(dome.name.as_str(), closer)).collect()
    }

    /// What is needed to close it.
    pub fn dome(&self) -> &DomeCopy {
        &self.closer.dome
    }

    /// Does the end of this process wait until it is closed?
    pub fn holds_up_the_end(&self, now: MachineTime) -> bool {
        self.closer.holds_up_the_end(now)
    }

    /// A dome by its closer.
    pub fn new(name: &str, closer: Closer) -> Self {
        let target = &closer.dome.target;
        let name = format!("{name} at {} number {}", target.server, target.number);
        tracing::warn!(
            dome = name,
            "the configuration does not name this dome any more; it is closed there, and looked after until then"
        );
        Self { name, closer, reported: BTreeSet::new() }
    }
}
