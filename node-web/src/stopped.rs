//! Nodes and telescopes that were stopped in good order: that they are silent is no fault.

use contract::node::Stopped;
use contract::{Key, NodeTopic, Role};
use schemars::JsonSchema;
use serde::{Deserialize as _, Serialize};
use units::Utc;

use crate::model::{Entry, Telescope};

/// A telescope whose observatory nodes were stopped in good order.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize)]
pub struct StoppedTelescope {
    /// What stopped it, and whether it was closed then, in words.
    pub text: String,
    /// Everything that closes was verified closed; absent where nothing of it closes, or a node of it still runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub closed: Option<bool>,
    /// When the last of them ended.
    #[serde(skip)]
    pub ended_utc: Utc,
}

impl StoppedTelescope {
    /// Whether all observatory nodes of a telescope that are known have ended in good order, and what they left.
    pub fn of(telescope: &Telescope) -> Option<Self> {
        let of_role = |wanted: Role| {
            telescope
                .states
                .values()
                .filter(move |entry| matches!(&entry.key, Key::Node(_, role, _, NodeTopic::State) if *role == wanted))
        };
        let mut observatories = of_role(Role::Observatory).map(stopped).collect::<Option<Vec<_>>>()?;
        let last = observatories.pop()?;
        let ended_utc = of_role(Role::Observatory).map(|entry| entry.at_utc).max()?;
        // What an enclosure's own node reports last counts more than what the observatory node saw before.
        let enclosures = of_role(Role::Device).filter_map(stopped).filter_map(|stopped| stopped.closed);
        let all: Vec<bool> = observatories.iter().chain([&last]).filter_map(|stopped| stopped.closed).collect();
        let enclosures: Vec<bool> = enclosures.collect();
        let known = if enclosures.is_empty() { all } else { enclosures };
        let closed = (!known.is_empty()).then(|| known.iter().all(|closed| *closed));
        let text = Stopped { closed, ..last }.to_string();
        Some(Self { text, closed, ended_utc })
    }

    /// Everything that closes was verified closed, so that its silence is no fault.
    pub fn is_closed(&self) -> bool {
        self.closed == Some(true)
    }
}

/// How a node ended, where this is the last state of one that was asked to end.
pub fn stopped(state: &Entry) -> Option<Stopped> {
    Stopped::deserialize(state.body.get("stopped")?).ok()
}

/// Is this the last state of a node that ended in good order and left nothing open?
pub fn has_ended_well(state: &Entry) -> bool {
    stopped(state).is_some_and(|stopped| stopped.closed != Some(false))
}

/// Was it stopped in good order, and nothing stands open? What its nodes reported last is over then; a device node that goes
/// on may report that again.
pub fn is_over(telescope: &Telescope) -> bool {
    let is_state = |entry: &&Entry| matches!(entry.key, Key::Node(_, _, _, NodeTopic::State));
    StoppedTelescope::of(telescope).is_some_and(|stopped| stopped.is_closed())
        && telescope.states.values().filter(is_state).all(has_ended_well)
}
