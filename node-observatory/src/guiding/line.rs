//! The learned state of guiding on the bus: the commander publishes it, a standby takes it over.
//!
//! The calibration is part of the state. A reference, some ten kilobytes, is published once when it is made, and once
//! more by each incarnation that commands: a late subscriber asks its publisher for all of them.

use std::collections::HashSet;
use std::sync::Arc;

use bus::{Catch, Quality};
use contract::observatory::{GuideReference, GuidingState};
use contract::{CommandId, Key, Part};

use super::learnt::REFERENCES;
use crate::control_room::ControlRoom;

/// Bound of the queue of received references: more than one incarnation publishes at once.
const WAITING: usize = 4 * REFERENCES;

/// Publishes each learned reference as soon as it is there.
pub async fn keep_telling(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let key = Key::GuideReference(room.node.config.address());
    let line = room.node.bus.publisher::<GuideReference>(&key, Quality::Event { cache: REFERENCES }).await?;
    let (mut learnt, mut hold) = (room.guide_learnt.subscribe(), room.hold.clone());
    let mut said = HashSet::<CommandId>::new();
    loop {
        let known = learnt.borrow_and_update().clone();
        room.guiding.send_if_modified(|state| {
            let is_new = state.calibrations != known.calibrations;
            state.calibrations = known.calibrations;
            is_new
        });
        said.retain(|frame| known.references.iter().any(|reference| reference.frame == *frame));
        // A standby has published nothing when it begins to command.
        for reference in known.references.into_iter().filter(|_| room.may_speak()) {
            if said.insert(reference.frame.clone()) {
                line.put(reference).await?;
            }
        }
        tokio::select! {
            changed = learnt.changed() => changed?,
            changed = hold.changed() => changed?,
        }
    }
}

/// Takes over what the commander learned for as long as this node stands by: it holds a field where the commander held
/// it, and knows what pulses do. The state is written to disk once this node commands.
pub async fn keep_hearing(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let bus = &room.node.bus;
    let mut state = bus.latest::<GuidingState>(&room.key(Part::Guiding)).await?;
    let key = Key::GuideReference(room.node.config.address());
    let references = bus.subscribe::<GuideReference>(&key.to_string(), Catch::All, WAITING).await?;
    let is_commanders = |life: &contract::BootId| *life != *bus.boot_id() && !room.may_speak();
    loop {
        tokio::select! {
            () = state.changed() => {
                let heard = state.get().filter(|heard| is_commanders(&heard.said.boot_id));
                // A node of an older version publishes none.
                let Some(heard) = heard.filter(|heard| !heard.said.body.calibrations.is_empty()) else { continue };
                room.guide_learnt.change(|learnt| {
                    let is_new = learnt.calibrations != heard.said.body.calibrations;
                    learnt.calibrations = heard.said.body.calibrations;
                    is_new
                });
            }
            heard = references.hear() => {
                if is_commanders(&heard.said.boot_id) {
                    room.guide_learnt.change(|learnt| learnt.hear_reference(&heard.said.body));
                }
            }
        }
    }
}
