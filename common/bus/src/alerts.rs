//! A node's own alerts: raised and cleared by cause, published as state.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use contract::observatory::{AlertKind, Alerts, Told};
use contract::printable;
use tokio::sync::{Notify, watch};

use crate::Clock;
use crate::alert_life::AlertLife;

/// Where a node raises what needs a person. Cheap to clone.
#[derive(Clone)]
pub struct AlertBoard {
    life: Arc<Mutex<AlertLife>>,
    /// By receiver.
    told: Arc<Mutex<BTreeMap<String, Vec<Told>>>>,
    shown: Arc<watch::Sender<Alerts>>,
    changed: Arc<Notify>,
    clock: Clock,
}

impl AlertBoard {
    /// No alerts.
    pub fn new(clock: Clock) -> Self {
        let shown = Arc::new(watch::channel(Alerts::default()).0);
        Self { life: Arc::default(), told: Arc::default(), shown, changed: Arc::default(), clock }
    }

    /// Raises an alert; one that is active already keeps its time and takes the new cause. `instance` distinguishes
    /// alerts of one kind; it is empty where there is only one.
    pub fn raise(&self, kind: AlertKind, instance: impl Display, cause: &str) {
        // A cause holds what servers answered and schedules say.
        let cause = &*printable(cause);
        let alert = kind.alert(instance, self.clock.utc(), cause);
        let mut life = self.life();
        let (id, priority) = (alert.id.clone(), alert.priority);
        if life.raise(kind, alert, self.clock.machine()) {
            tracing::warn!(id, ?priority, cause, "alert raised");
        }
        self.show(&mut life);
        self.changed.notify_one();
    }

    /// The cause of an alert is gone; it clears after the hold of its kind.
    pub fn clear(&self, kind: AlertKind, instance: impl Display) {
        let id = kind.id(instance);
        let mut life = self.life();
        if life.clear(kind, &id, self.clock.machine()) {
            tracing::info!(id, "the cause of an alert is gone");
            self.show(&mut life);
            self.changed.notify_one();
        }
    }

    /// The notifications that this node sent to one receiver, of alerts that are active. They are published with its
    /// alerts, so that a node which sends in its place does not send them again.
    pub fn told(&self, receiver: &str, told: Vec<Told>) {
        self.told.lock().unwrap_or_else(PoisonError::into_inner).insert(receiver.to_owned(), told);
        self.show(&mut self.life());
    }

    /// The active alerts, the most urgent first, as a value that can be followed.
    pub fn watch(&self) -> watch::Receiver<Alerts> {
        self.shown.subscribe()
    }

    /// Lets on-delays and holds end in time, for ever.
    pub async fn keep_time(&self) {
        loop {
            let next = {
                let mut life = self.life();
                self.show(&mut life);
                life.next_change(self.clock.machine())
            };
            let due = async {
                match next {
                    Some(wait) => tokio::time::sleep(wait).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                () = due => {}
                () = self.changed.notified() => {}
            }
        }
    }

    fn life(&self) -> MutexGuard<'_, AlertLife> {
        self.life.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Publishes the alerts that are active now.
    fn show(&self, life: &mut AlertLife) {
        let mut now = life.shown(self.clock.machine());
        now.told = self.told.lock().unwrap_or_else(PoisonError::into_inner).values().flatten().cloned().collect();
        self.shown.send_if_modified(|shown| {
            let is_new = *shown != now;
            *shown = now;
            is_new
        });
    }
}
