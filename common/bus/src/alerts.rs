//! A node's own alerts: raised and cleared by cause, published as state.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use contract::observatory::{Alert, Alerts, Priority};
use tokio::sync::watch;

use crate::Clock;

/// Where a node raises what needs a person. Cheap to clone.
#[derive(Clone)]
pub struct AlertBoard {
    standing: Arc<Mutex<BTreeMap<String, Alert>>>,
    shown: Arc<watch::Sender<Alerts>>,
    clock: Clock,
}

impl AlertBoard {
    /// An empty board.
    pub fn new(clock: Clock) -> Self {
        Self { standing: Arc::default(), shown: Arc::new(watch::channel(Alerts::default()).0), clock }
    }

    /// Raises an alert; one that stands already under this id keeps its time and takes the new words.
    pub fn raise(&self, id: &str, priority: Priority, cause: &str, consequence: &str, action: &str) {
        let mut standing = self.standing.lock().unwrap_or_else(PoisonError::into_inner);
        let raised_utc = match standing.get(id) {
            Some(alert) => alert.raised_utc,
            None => {
                tracing::warn!(id, ?priority, cause, "alert raised");
                self.clock.utc()
            }
        };
        let [cause, consequence, action] = [cause, consequence, action].map(str::to_owned);
        let alert = Alert { id: id.to_owned(), priority, raised_utc, cause, consequence, action };
        if standing.get(id) != Some(&alert) {
            standing.insert(id.to_owned(), alert);
            self.show(&standing);
        }
    }

    /// Clears an alert, if it stands.
    pub fn clear(&self, id: &str) {
        let mut standing = self.standing.lock().unwrap_or_else(PoisonError::into_inner);
        if standing.remove(id).is_some() {
            tracing::info!(id, "alert cleared");
            self.show(&standing);
        }
    }

    /// The standing alerts, the most urgent first, as a value that can be followed.
    pub fn watch(&self) -> watch::Receiver<Alerts> {
        self.shown.subscribe()
    }

    fn show(&self, standing: &BTreeMap<String, Alert>) {
        let mut alerts: Vec<Alert> = standing.values().cloned().collect();
        alerts.sort_by_key(|alert| (alert.priority, alert.raised_utc));
        self.shown.send_replace(Alerts { alerts });
    }
}
