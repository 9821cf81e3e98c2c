//! The guide references on the bus: the commander publishes them, a standby takes them over.
//!
//! A reference, some ten kilobytes, is published once when it is made, and once more by each incarnation that commands:
//! a late subscriber asks its publisher for all of them.

use std::collections::HashSet;
use std::sync::Arc;

use bus::Catch;
use contract::observatory::{GUIDE_REFERENCES, GuideReference};
use contract::{CommandId, Key};

use super::GuidingData;
use crate::authority::Authority;

/// Bound of the queue of received references: more than one incarnation publishes at once.
const WAITING: usize = 4 * GUIDE_REFERENCES;

/// Publishes each learned reference as soon as it is there.
pub async fn keep_publishing(authority: Arc<Authority>, guiding: Arc<GuidingData>) -> anyhow::Result<()> {
    let key = Key::GuideReference(authority.node.config.address());
    let line = authority.node.bus.publisher::<GuideReference>(&key).await?;
    let (mut learned, mut hold) = (guiding.learned.subscribe(), authority.hold.clone());
    let mut published = HashSet::<CommandId>::new();
    loop {
        let references = learned.borrow_and_update().references.clone();
        published.retain(|frame| references.iter().any(|reference| reference.frame == *frame));
        // A standby has published nothing when it begins to command.
        for reference in references.into_iter().filter(|_| authority.is_publishing()) {
            if published.insert(reference.frame.clone()) {
                line.put(reference).await?;
            }
        }
        tokio::select! {
            changed = learned.changed() => changed?,
            changed = hold.changed() => changed?,
        }
    }
}

/// Takes over the commander's references for as long as this node stands by: it holds a field where the commander
/// held it.
pub async fn keep_receiving(authority: Arc<Authority>, guiding: Arc<GuidingData>) -> anyhow::Result<()> {
    let bus = &authority.node.bus;
    let key = Key::GuideReference(authority.node.config.address());
    let references = bus.subscribe::<GuideReference>(&key.to_string(), Catch::All, WAITING).await?;
    loop {
        let received = references.recv().await;
        if received.sample.boot_id != *bus.boot_id() && !authority.is_publishing() {
            guiding.learned.change(|learned| learned.observe_reference(&received.sample.body));
        }
    }
}
