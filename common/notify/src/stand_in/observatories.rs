//! What is known of the observatory nodes of a telescope: whether they send alerts, and which of them is silent.

use std::collections::BTreeMap;
use std::time::Duration;

use bus::MachineTime;
use contract::node::{NodeState, fallen_silent};
use contract::observatory::LAST_WORD;
use contract::{BootId, Name, Role, Stamped};

use super::{HOLD, MOST_NODES};
use crate::silent_nodes::{LOST, of_telescope};

/// An observatory node that never published since this node began has so long to start, on a busy machine and with its first
/// look at the devices.
const START: Duration = Duration::from_secs(60);

/// Whether the observatory nodes of a telescope send alerts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Presence {
    /// One does.
    Sends,
    /// None does, and that is no fault: they were stopped in good order, or the devices are shared and have none.
    Absent,
    /// None has published for too long.
    Silent,
}

/// What is known of the observatory nodes of a telescope. Pure: time comes in.
pub(super) struct Observatories {
    /// They are silent after this; never where nobody stands in.
    pub(super) timeout: Option<Duration>,
    pub(super) began: MachineTime,
    /// When none sent last.
    pub(super) last_away: Option<MachineTime>,
    /// Shared devices have none.
    pub(super) is_shared: bool,
    /// The newest state of each that has published one.
    pub(super) seen: BTreeMap<Name, SeenObservatory>,
}

pub(super) struct SeenObservatory {
    pub(super) boot_id: BootId,
    pub(super) state: NodeState,
    pub(super) arrived: MachineTime,
}

impl Observatories {
    pub(super) fn take(&mut self, id: Name, Stamped { boot_id, body, .. }: &Stamped<NodeState>, arrived: MachineTime) {
        if self.seen.len() < MOST_NODES || self.seen.contains_key(&id) {
            self.seen.insert(id, SeenObservatory { boot_id: boot_id.clone(), state: body.clone(), arrived });
        }
    }

    /// Causes by instance. Of those that are to run, the ones that publish no more: the incarnation `last` that published
    /// alerts last, and those without a state for too long. Where that shows none, what was found `before` stands: a node
    /// that is started again publishes its state first. None is named only because others are not known.
    pub(super) fn silent(
        &self,
        before: &BTreeMap<String, String>,
        last: Option<&BootId>,
        now: MachineTime,
    ) -> BTreeMap<String, String> {
        let runs = || self.seen.iter().filter(|(_, seen)| !seen.state.ended_well());
        let is_silent = |seen: &SeenObservatory| Some(&seen.boot_id) == last || now.since(seen.arrived) > LOST;
        let alert = |id: &str, host: &str| {
            let (instance, words) = of_telescope(Role::Observatory, id);
            (instance, fallen_silent(&words, host))
        };
        let silent = runs().filter(|(_, seen)| is_silent(seen));
        let silent: BTreeMap<_, _> = silent.map(|(id, seen)| alert(id.as_str(), &seen.state.host)).collect();
        if !silent.is_empty() {
            return silent;
        }
        if !before.is_empty() {
            return before.clone();
        }
        let names: Vec<&str> = runs().map(|(id, _)| id.as_str()).collect();
        if names.is_empty() {
            return [alert(config::MAIN_NODE, "")].into();
        }
        let names = names.join(", ");
        let cause = format!("no observatory node publishes alerts, although there are states of {names}");
        [(Role::Observatory.to_string(), cause)].into()
    }

    /// Has the incarnation that publishes alerts received what another node published last, which arrived at `last`? What
    /// is older than [`LAST_WORD`] is kept by nobody.
    pub(super) fn has_heard(&self, sender: Option<&BootId>, last: MachineTime, now: MachineTime) -> bool {
        let its = self.seen.values().find(|seen| Some(&seen.boot_id) == sender);
        let has_received = |seen: &SeenObservatory| seen.state.has_heard(now.since(seen.arrived), now.since(last));
        now.since(last) > LAST_WORD || its.is_some_and(has_received)
    }

    /// By the arrival of the newest alerts that one of them published.
    pub(super) fn presence(&self, newest: Option<MachineTime>, now: MachineTime) -> Presence {
        let Some(timeout) = self.timeout else { return Presence::Sends };
        if self.is_shared || (!self.seen.is_empty() && self.seen.values().all(|seen| seen.state.ended_well())) {
            return Presence::Absent;
        }
        let is_silent = match newest {
            Some(arrived) => now.since(arrived) >= timeout,
            None => now.since(self.began) >= timeout.max(START),
        };
        if is_silent { Presence::Silent } else { Presence::Sends }
    }

    /// Has the one that sends received all that other nodes report? One that returns has to receive first what was raised meanwhile: to
    /// whoever follows at any time it would be over, and raised again.
    pub(super) fn knows_all(&mut self, presence: Presence, now: MachineTime) -> bool {
        if presence != Presence::Sends {
            self.last_away = Some(now);
        }
        self.last_away.is_none_or(|at| now.since(at) >= HOLD)
    }
}
