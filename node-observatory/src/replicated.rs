//! What one node of a telescope learns and each other one goes on with: in memory, in a file, and on the bus.
//!
//! The commander writes it down and publishes it. A standby takes over what is published, so that its first row is as
//! good as the commander's next one; it writes it to its own folder once it commands.

use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bus::Latest;
use contract::observatory::AlertKind;
use contract::{Part, Payload};
use node::Node;
use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::sync::watch;

use crate::authority::Authority;
use crate::persisted::{self, Persisted};
use crate::publishing;
use crate::tasks::Tasks;

/// State that is learned, and of which nothing unsafe depends.
pub trait Replicate: Clone + Default + Serialize + DeserializeOwned + Send + Sync + 'static {
    /// The payload that holds it, alone or with the state of what learns it.
    type Payload: Payload;
    /// The payload's key.
    const PART: Part;
    /// The file in the data folder is `FILE-TELESCOPE.json`.
    const FILE: &'static str;
    /// What it is, for messages.
    const WHAT: &'static str;
    /// The alert while the disk does not take it.
    const NOT_SAVED: AlertKind;

    /// Puts it into the payload; false if it is there already.
    fn put_in(&self, payload: &mut Self::Payload) -> bool;

    /// Takes over the commander's; false if it is the same, or empty: a commander that has just been installed knows less
    /// than a standby that has commanded before.
    fn adopt(&mut self, payload: Self::Payload) -> bool;

    /// The file.
    fn path(config: &config::Observatory) -> PathBuf {
        config.folders.data.join(format!("{}-{}.json", Self::FILE, config.place.telescope))
    }

    /// What an earlier incarnation wrote; empty if there is no file, or none that can be read, which is reported.
    fn read(path: &Path) -> Self {
        persisted::read_or_anew(path, Self::WHAT)
    }
}

/// Learned state with its file.
pub struct Replicated<T>(Arc<Persisted<T>>);

impl<T> Deref for Replicated<T> {
    type Target = Persisted<T>;

    fn deref(&self) -> &Persisted<T> {
        &self.0
    }
}

impl<T: Replicate> Replicated<T> {
    /// Reads what was learned before.
    pub async fn load(node: &Node) -> anyhow::Result<Self> {
        Ok(Self(Persisted::load(T::path(&node.config), &node.id, T::read).await?))
    }

    /// Starts to write it, to publish it in `state`, and to take it over.
    pub fn start(&self, tasks: &mut Tasks, authority: &Arc<Authority>, state: watch::Sender<T::Payload>) {
        let (saved, authority) = (self.0.clone(), authority.clone());
        // No payload goes out without it, and no later change is passed over: a standby would take that over.
        let mut known = saved.subscribe();
        let value = known.borrow_and_update().clone();
        state.send_if_modified(|payload| value.put_in(payload));
        tasks.spawn(T::FILE, async move {
            let key = authority.key(T::PART);
            let payloads = authority.node.bus.latest::<T::Payload>(&key).await?;
            let on_disk =
                saved.clone().keep_on_disk(authority.node.alerts.clone(), authority.hold.clone(), T::NOT_SAVED, |_| {
                    T::WHAT.to_owned()
                });
            let in_payload = keep_in_payload(known, &state);
            let published = publishing::keep_publishing(authority.clone(), T::PART, state.subscribe());
            let received = follow_commander(&authority, payloads, |payload| saved.change(|known| known.adopt(payload)));
            tokio::try_join!(on_disk, in_payload, published, received)?;
            Ok(())
        });
    }
}

/// Keeps the payload up to date with what is known.
async fn keep_in_payload<T: Replicate>(
    mut known: watch::Receiver<T>,
    state: &watch::Sender<T::Payload>,
) -> anyhow::Result<()> {
    loop {
        known.changed().await?;
        let value = known.borrow_and_update().clone();
        state.send_if_modified(|payload| value.put_in(payload));
    }
}

/// Hands over each payload of another node or incarnation for as long as this node stands by.
pub async fn follow_commander<P: Payload>(
    authority: &Authority,
    mut payloads: Latest<P>,
    mut adopt: impl FnMut(P),
) -> anyhow::Result<()> {
    loop {
        payloads.changed().await;
        let foreign = payloads.get().filter(|received| received.sample.boot_id != *authority.node.bus.boot_id());
        if let Some(received) = foreign.filter(|_| !authority.is_publishing()) {
            adopt(received.sample.body);
        }
    }
}
