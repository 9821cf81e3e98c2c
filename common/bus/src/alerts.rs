//! A node's own alerts: raised and cleared by cause, published as state.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::sync::{Arc, Mutex, PoisonError};

use contract::observatory::{Alert, AlertKind, Alerts};
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

    /// Raises an alert; one that stands already keeps its time and takes the new cause. `instance` tells alerts of one
    /// kind apart; it is empty where there is only one.
    pub fn raise(&self, kind: AlertKind, instance: impl Display, cause: &str) {
        let mut alert = kind.alert(instance, self.clock.utc(), cause);
        let mut standing = self.standing.lock().unwrap_or_else(PoisonError::into_inner);
        match standing.get(&alert.id) {
            Some(known) => alert.raised_utc = known.raised_utc,
            None => tracing::warn!(id = alert.id, priority = ?alert.priority, cause, "alert raised"),
        }
        if standing.get(&alert.id) != Some(&alert) {
            standing.insert(alert.id.clone(), alert);
            self.show(&standing);
        }
    }

    /// Clears an alert, if it stands.
    pub fn clear(&self, kind: AlertKind, instance: impl Display) {
        let id = kind.id(instance);
        let mut standing = self.standing.lock().unwrap_or_else(PoisonError::into_inner);
        if standing.remove(&id).is_some() {
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
