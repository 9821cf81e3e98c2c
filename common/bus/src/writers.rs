//! Which program on the bus may answer for a key: the one that publishes the state next to it.
//!
//! A query reaches every queryable that matches its key, and a stranger's may be among them. Without keys nobody can
//! prove who it is. But each key has one writer, so the program that publishes the state of a device is the one that
//! takes its commands, and an answer from elsewhere does not count (docs/decisions/0049).

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use contract::{Key, NodeTopic, Part, Role, Topic};
use tokio::sync::mpsc;
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::session::ZenohId;

/// So many keys are remembered with their writers.
const REMEMBERED: usize = 512;
/// So many programs that claim one key are distinguished.
pub(crate) const MOST_WRITERS: usize = 16;
/// How long writers are waited for, once one is known.
const OTHERS: Duration = Duration::from_millis(200);

/// The writers of state keys, as they answered when they were asked last.
#[derive(Debug, Clone, Default)]
pub(crate) struct Writers {
    known: Arc<Mutex<HashMap<String, Vec<ZenohId>>>>,
}

/// The expression of the states whose writer answers for a key.
pub(crate) fn other_states(key: &Key) -> Option<String> {
    match key {
        Key::Command(device) | Key::Record(device) => Some(Key::State(device.clone()).to_string()),
        Key::Order(address)
        | Key::Actions(address)
        | Key::ScheduleCheck(address)
        | Key::ScheduleTexts(address)
        | Key::SchedulePlan(address) => Some(Key::Observatory(address.clone(), Part::Night).to_string()),
        Key::History(address) | Key::ArchivedFrame(address) | Key::NightReport(address) => {
            Some(Topic::Node(NodeTopic::State).at(address).of_role(Role::Archive).to_string())
        }
        Key::Node(address, role, id, NodeTopic::AuditSince) => {
            Some(Key::Node(address.clone(), *role, id.clone(), NodeTopic::State).to_string())
        }
        _ => None,
    }
}

impl Writers {
    /// The programs that publish `states`; asked for unless `who` is known to be one of them.
    pub async fn of(&self, session: &zenoh::Session, states: &str, who: ZenohId, limit: Duration) -> Vec<ZenohId> {
        let known = self.lock().get(states).cloned();
        if let Some(known) = known.filter(|known| known.contains(&who)) {
            return known;
        }
        let found = ask(session, states, limit).await;
        if !found.is_empty() {
            let mut known = self.lock();
            if known.len() >= REMEMBERED {
                known.clear();
            }
            known.insert(states.to_owned(), found.clone());
        }
        found
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, HashMap<String, Vec<ZenohId>>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

async fn ask(session: &zenoh::Session, states: &str, limit: Duration) -> Vec<ZenohId> {
    let (sender, mut receiver) = mpsc::channel(MOST_WRITERS);
    let asked =
        session.get(states).target(QueryTarget::All).consolidation(ConsolidationMode::None).timeout(limit).callback(
            move |reply| {
                if let (Some(who), Ok(_)) = (reply.replier_id(), reply.result()) {
                    // More answers than fit come from a flood.
                    let _ = sender.try_send(who.zid());
                }
            },
        );
    if let Err(error) = asked.await {
        tracing::debug!(%error, states, "the writers of a state could not be asked for");
    }
    let mut found = Vec::new();
    loop {
        // A program that hangs holds the question open until its timeout.
        let wait = if found.is_empty() { limit } else { OTHERS };
        match tokio::time::timeout(wait, receiver.recv()).await {
            Ok(Some(who)) if found.len() < MOST_WRITERS => {
                if !found.contains(&who) {
                    found.push(who);
                }
            }
            _ => return found,
        }
    }
}
