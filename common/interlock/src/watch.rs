//! Which process guards: the device node, or the guard process itself. A pure state machine.
//!
//! ```text
//!   the node reports, and sees its shutter (or asks the same server) ──> the node guards
//!   it does not, and the last permit still lasts                     ──> nobody needs to
//!   it does not, and the last permit has run out, or an end is asked ──> this process closes
//! ```
//!
//! The countdown of a dome that may have been open before this process started goes on from its last value: a crash
//! loop gains no time.

use std::collections::BTreeMap;
use std::time::Duration;

use units::MachineTime;

use crate::deadlines::{Before, Deadlines};
use crate::report::{DomeReport, Report};

/// How often [`Watch::tick`] is called.
pub const TICK: Duration = Duration::from_millis(250);
/// A node that was silent for so many ticks does not guard. Ticks, not time: when this process itself was stopped, the
/// node's reports are unread.
const SILENT: u32 = 12;
/// A node that was silent for so many ticks hangs, and is started again.
const HANGS: u32 = 60;
/// A node that has reported nothing for so many ticks after its start will not.
const NEVER: u32 = 240;
/// The first start after an end comes so soon; then the pause doubles from 1 s to the longest.
const AT_ONCE: Duration = Duration::from_millis(200);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);
/// More failures make no pause longer.
const MOST_FAILURES: u32 = 6;
/// A node that ran for this time is healthy again.
const HEALTHY: Duration = Duration::from_secs(60);

/// What must be done about the node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Effect {
    /// Start it.
    Start,
    /// Kill it, for this reason.
    Kill(&'static str),
}

/// Which process guards a dome now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Who {
    /// The device node.
    Node,
    /// The device node, which waits for mounts, and this process, which asks the mounts themselves.
    Both,
    /// Nobody needs to: the last permit lasts.
    Permit,
    /// This process: close it.
    This,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Node {
    Away { start_at: MachineTime },
    Runs { since: MachineTime, silent: u32, has_spoken: bool },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
struct Seen {
    sees: bool,
    is_closed: bool,
    waits_for_mounts: bool,
}

/// The watch over one device node and its domes.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Watch {
    node: Node,
    failures: u32,
    open_until: Deadlines,
    seen: BTreeMap<String, Seen>,
    /// Domes that the node reaches by the very server that the last-good copy names.
    same_server: Vec<String>,
    ending: bool,
    shares_clock: bool,
}

impl Watch {
    /// A watch that begins now, over domes with their permit validity. Only where nothing was ever written is there a
    /// time of grace, for a commander's first permit. `shares_clock`: the node has the same boot-time clock.
    pub fn new(now: MachineTime, domes: &[(String, Duration)], before: &Before, shares_clock: bool) -> Self {
        let never = MachineTime::from_boot(Duration::ZERO);
        let each = domes.iter().map(|(dome, permit_valid)| {
            let latest = now.plus(*permit_valid);
            let until = match before {
                Before::Nothing => latest,
                Before::OtherBoot => never,
                Before::Deadlines(known) => known.get(dome).copied().unwrap_or(latest).min(latest),
            };
            (dome.clone(), until)
        });
        Self {
            node: Node::Away { start_at: now },
            failures: 0,
            open_until: each.collect(),
            seen: BTreeMap::new(),
            same_server: Vec::new(),
            ending: false,
            shares_clock,
        }
    }

    /// Until when each dome may be open.
    pub fn deadlines(&self) -> &Deadlines {
        &self.open_until
    }

    /// A dome that was not known when the watch began.
    pub fn add(&mut self, dome: &str, until: MachineTime) {
        self.open_until.entry(dome.to_owned()).or_insert(until);
    }

    /// The node was started; it asks these domes by the same servers as the last-good copy.
    pub fn started(&mut self, now: MachineTime, same_server: Vec<String>) {
        self.node = Node::Runs { since: now, silent: 0, has_spoken: false };
        self.seen.clear();
        self.same_server = same_server;
    }

    /// The node has ended, or could not be started.
    pub fn ended(&mut self, now: MachineTime) {
        let was_healthy =
            matches!(self.node, Node::Runs { since, has_spoken: true, .. } if now.since(since) >= HEALTHY);
        self.failures = if was_healthy { 0 } else { (self.failures + 1).min(MOST_FAILURES) };
        let pause = match self.failures {
            0 | 1 => AT_ONCE,
            many => Duration::from_secs(1 << (many - 2).min(4)).min(LONGEST_PAUSE),
        };
        self.node = Node::Away { start_at: now.plus(pause) };
        self.seen.clear();
    }

    /// The node that was asked to end has ended well, which it does only when every dome is verified closed.
    pub fn ended_closed(&mut self, now: MachineTime) {
        let domes: Vec<String> = self.seen.keys().cloned().collect();
        self.ended(now);
        self.seen.extend(domes.into_iter().map(|dome| (dome, Seen { is_closed: true, ..Seen::default() })));
    }

    /// The node could not be started yet and will be tried again, which is no failure.
    pub fn not_yet(&mut self, now: MachineTime) {
        self.node = Node::Away { start_at: now.plus(AT_ONCE) };
    }

    /// The node has reported.
    pub fn observe(&mut self, now: MachineTime, report: &Report) {
        let Node::Runs { silent, has_spoken, .. } = &mut self.node else { return };
        (*silent, *has_spoken) = (0, true);
        for (dome, dome_report) in &report.domes {
            self.open_until.insert(dome.clone(), dome_report.open_until(now, self.shares_clock));
            let DomeReport { sees, is_closed, waits_for_mounts, .. } = *dome_report;
            self.seen.insert(dome.clone(), Seen { sees, is_closed, waits_for_mounts });
        }
    }

    /// An end was asked for: what is open must be closed now.
    pub fn end(&mut self) {
        self.ending = true;
    }

    /// Time passes.
    pub fn tick(&mut self, now: MachineTime) -> Option<Effect> {
        match &mut self.node {
            Node::Away { start_at } if now >= *start_at && !self.ending => Some(Effect::Start),
            Node::Away { .. } => None,
            Node::Runs { silent, has_spoken, .. } => {
                // Beyond the longest time more silence changes nothing.
                *silent = silent.saturating_add(1).min(NEVER);
                match (*has_spoken, *silent) {
                    (true, HANGS..) => Some(Effect::Kill("it has reported nothing for 15 s")),
                    (false, NEVER..) => Some(Effect::Kill("it has reported nothing for 60 s since its start")),
                    _ => None,
                }
            }
        }
    }

    /// Which process guards a dome?
    pub fn who(&self, dome: &str, now: MachineTime) -> Who {
        let speaks = matches!(self.node, Node::Runs { silent, has_spoken: true, .. } if silent < SILENT);
        let same_server = self.same_server.iter().any(|one| one == dome);
        if let Some(seen) = self.seen.get(dome).filter(|seen| speaks && (seen.sees || same_server)) {
            return if seen.waits_for_mounts { Who::Both } else { Who::Node };
        }
        let lasts = self.open_until.get(dome).is_some_and(|until| now < *until);
        if lasts && !self.ending { Who::Permit } else { Who::This }
    }

    /// Every one of these domes' shutters is seen by the node, so that its configuration works.
    pub fn works<'a>(&self, mut domes: impl Iterator<Item = &'a str>) -> bool {
        domes.all(|dome| self.seen.get(dome).is_some_and(|seen| seen.sees))
    }

    /// Only these domes are this watch's from now on.
    pub fn keep_only(&mut self, domes: &[&str]) {
        self.open_until.retain(|dome, _| domes.contains(&dome.as_str()));
    }

    /// The node reports that a dome is closed.
    pub fn node_reports_closed(&self, dome: &str) -> bool {
        self.seen.get(dome).is_some_and(|seen| seen.is_closed)
    }

    /// How often the node has ended without having been healthy.
    pub fn failures(&self) -> u32 {
        self.failures
    }
}

#[cfg(test)]
#[path = "watch_tests.rs"]
mod tests;
