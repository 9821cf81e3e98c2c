//! A node's own alerts: raised and cleared by cause, published as state.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bus::Clock;
use contract::observatory::{AlertKind, Alerts, Notification, Priority};
use contract::{Address, printable};
use tokio::sync::{Notify, watch};

use crate::alert_states::{AlertStates, seconds};

/// Where a node raises what needs a person. Cheap to clone.
#[derive(Clone)]
pub struct NodeAlerts {
    states: Arc<Mutex<AlertStates>>,
    /// By receiver.
    notifications: Arc<Mutex<BTreeMap<String, Vec<Notification>>>>,
    published: Arc<watch::Sender<Alerts>>,
    changed: Arc<Notify>,
    clock: Clock,
    /// The telescope that the texts name.
    address: Option<Address>,
}

impl NodeAlerts {
    /// No alerts.
    pub fn new(clock: Clock) -> Self {
        let shown = Arc::new(watch::channel(Alerts::default()).0);
        let (states, notifications, changed) = Default::default();
        Self { states, notifications, published: shown, changed, clock, address: None }
    }

    /// With the telescope in the texts about what a person should do.
    pub fn of(self, address: Address) -> Self {
        Self { address: Some(address), ..self }
    }

    /// Raises an alert; one that is active already keeps its time and takes the new cause. `instance` distinguishes
    /// alerts of one kind; it is empty where there is only one.
    pub fn raise(&self, kind: AlertKind, instance: impl Display, cause: &str) {
        self.raise_after(seconds(kind.entry().on_delay_s), kind, instance, cause);
    }

    /// Raises an alert without the on-delay of its kind: who raises it has waited already.
    pub fn raise_at_once(&self, kind: AlertKind, instance: impl Display, cause: &str) {
        self.raise_after(Duration::ZERO, kind, instance, cause);
    }

    fn raise_after(&self, on_delay: Duration, kind: AlertKind, instance: impl Display, cause: &str) {
        // A cause holds what servers answered and schedules say.
        let cause = &*printable(cause);
        let alert = kind.alert(instance, self.clock.utc(), cause);
        let alert = if let Some(address) = &self.address { alert.at(address) } else { alert };
        let mut states = self.states();
        let (id, priority) = (alert.id.clone(), alert.priority);
        if states.raise(on_delay, alert, self.clock.machine()) {
            match priority {
                Priority::Advisory => tracing::info!(id, ?priority, cause, "alert raised"),
                _ => tracing::warn!(id, ?priority, cause, "alert raised"),
            }
        }
        self.show(&mut states);
        self.changed.notify_one();
    }

    /// The cause of an alert is gone; it clears after the hold of its kind.
    pub fn clear(&self, kind: AlertKind, instance: impl Display) {
        let id = kind.id(instance);
        let mut states = self.states();
        if states.clear(kind, &id, self.clock.machine()) {
            tracing::info!(id, "the cause of an alert is gone");
            self.show(&mut states);
            self.changed.notify_one();
        }
    }

    /// The notifications that this node sent to one receiver, of alerts that are active. They are published with its
    /// alerts, so that a node which sends in its place does not send them again.
    pub fn set_notifications(&self, receiver: &str, notifications: Vec<Notification>) {
        self.notifications.lock().unwrap_or_else(PoisonError::into_inner).insert(receiver.to_owned(), notifications);
        self.show(&mut self.states());
    }

    /// The active alerts, the most urgent first, as a value that can be followed.
    pub fn watch(&self) -> watch::Receiver<Alerts> {
        self.published.subscribe()
    }

    /// Lets on-delays and holds end in time, for ever.
    pub async fn keep_time(&self) {
        loop {
            let next = {
                let mut states = self.states();
                self.show(&mut states);
                states.next_change(self.clock.machine())
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

    fn states(&self) -> MutexGuard<'_, AlertStates> {
        self.states.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Publishes the alerts that are active now.
    fn show(&self, states: &mut AlertStates) {
        let mut now = states.published(self.clock.machine());
        now.notifications =
            self.notifications.lock().unwrap_or_else(PoisonError::into_inner).values().flatten().cloned().collect();
        self.published.send_if_modified(|shown| {
            let is_new = *shown != now;
            *shown = now;
            is_new
        });
    }
}

/// The alerts of a task that looks, again and again, at all that calls for one.
#[derive(Debug, Default)]
pub struct StandingAlerts {
    causes: BTreeMap<(AlertKind, String), String>,
}

impl StandingAlerts {
    /// These stand now, each with its kind, instance and cause: of one alert the first. Those that stood before and are not
    /// among them are gone.
    pub fn keep(&mut self, wanted: impl IntoIterator<Item = (AlertKind, String, String)>, alerts: &NodeAlerts) {
        let mut causes = BTreeMap::new();
        for (kind, instance, cause) in wanted {
            causes.entry((kind, instance)).or_insert(cause);
        }
        for ((kind, instance), cause) in causes.iter().filter(|(alert, cause)| self.causes.get(alert) != Some(cause)) {
            alerts.raise(*kind, instance, cause);
        }
        for (kind, instance) in self.causes.keys().filter(|alert| !causes.contains_key(alert)) {
            alerts.clear(*kind, instance);
        }
        self.causes = causes;
    }
}

#[cfg(test)]
mod tests {
    use contract::node::Level;
    use tracing_subscriber::layer::SubscriberExt as _;

    use super::*;
    use crate::diary::DiaryLayer;

    #[test]
    fn an_alert_that_needs_nobody_soon_and_the_end_of_one_are_usual_lines_of_the_log() {
        let (layer, mut lines) = DiaryLayer::new();
        let alerts = NodeAlerts::new(Clock::machine_clock());
        tracing::subscriber::with_default(tracing_subscriber::registry().with(layer), || {
            for kind in [AlertKind::StayClosed, AlertKind::DomeNotClosed] {
                alerts.raise(kind, "", "c");
                alerts.raise(kind, "", "another cause");
                alerts.clear(kind, "");
            }
        });
        let levels: Vec<Level> = std::iter::from_fn(|| lines.try_recv().ok()).map(|line| line.level).collect();
        assert_eq!(levels, [Level::Info, Level::Info, Level::Warn, Level::Info]);
    }

    #[tokio::test]
    async fn alerts_that_stand_take_their_new_causes_and_all_others_are_gone() {
        let alerts = NodeAlerts::new(Clock::machine_clock());
        let active = || -> Vec<(String, String)> {
            let published = alerts.watch().borrow().alerts.clone();
            let active = published.into_iter().filter(|alert| alert.returned_utc.is_none());
            active.map(|alert| (alert.id, alert.cause)).collect()
        };
        let wanted = |of: &[(&str, &str)]| -> Vec<(AlertKind, String, String)> {
            let owned = |(instance, cause): &(&str, &str)| {
                (AlertKind::StepOverdue, (*instance).to_owned(), (*cause).to_owned())
            };
            of.iter().map(owned).collect()
        };
        let told = |of: &[(&str, &str)]| -> Vec<(String, String)> {
            of.iter().map(|(instance, cause)| (format!("step-overdue/{instance}"), (*cause).to_owned())).collect()
        };
        let mut standing = StandingAlerts::default();
        for (now, stands) in [
            (
                &[("a", "slewing"), ("b", "cooling"), ("a", "a second row")][..],
                &[("a", "slewing"), ("b", "cooling")][..],
            ),
            (&[("a", "exposing"), ("b", "cooling")], &[("a", "exposing"), ("b", "cooling")]),
            (&[("b", "cooling")], &[("b", "cooling")]),
            (&[], &[]),
            (&[("a", "exposing")], &[("a", "exposing")]),
        ] {
            standing.keep(wanted(now), &alerts);
            let mut found = active();
            found.sort();
            assert_eq!(found, told(stands));
        }
    }
}
