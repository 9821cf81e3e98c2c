//! Reads again what of a device could not be read, with a growing pause, and raises an alert that names it meanwhile.

use std::collections::BTreeMap;
use std::time::Duration;

use alpaca::{Abilities, AlpacaError};
use contract::observatory::AlertKind;
use contract::{DeviceKind as _, Kind, Link, NoData};
use tokio::time::Instant;

use super::{Loop, ReadAgain, Task};
use crate::driver::{Capabilities, Driver};

/// The first pause before what a device can do is read again; each one after it is twice as long ...
const FIRST_PAUSE: Duration = Duration::from_secs(1);
/// ... up to this.
const LONGEST_PAUSE: Duration = Duration::from_secs(60);
/// A part of the state that was not read for so long is reported; a device may not answer everything at all times.
const MISSING_FOR: Duration = Duration::from_secs(60);

/// The abilities of a device, and when those that are unread are read again.
pub(super) struct ReadingAgain<D: Driver> {
    /// Reads them.
    pub(super) task: Task<ReadAgain<D>>,
    abilities: Option<Abilities>,
    next: Option<Instant>,
    pause: Duration,
    /// Since when parts of the state are missing.
    missing: BTreeMap<String, Instant>,
}

impl<D: Driver> Default for ReadingAgain<D> {
    fn default() -> Self {
        Self { task: None, abilities: None, next: None, pause: FIRST_PAUSE, missing: BTreeMap::new() }
    }
}

impl<D: Driver> ReadingAgain<D> {
    /// Those of a device that was just connected.
    pub(super) fn of(abilities: Abilities) -> Self {
        let mut again = Self::default();
        again.plan(abilities, Instant::now());
        again
    }

    /// When they are read next.
    pub(super) fn next(&self) -> Option<Instant> {
        self.next.filter(|_| self.task.is_none())
    }

    fn plan(&mut self, abilities: Abilities, now: Instant) {
        self.next = (!abilities.unread().is_empty()).then(|| now + self.pause);
        self.pause = (self.pause * 2).min(LONGEST_PAUSE);
        self.abilities = Some(abilities);
    }

    /// Parts of the state that are missing now for a while; `missing` are all that are missing.
    fn long_missing(&mut self, missing: Vec<(String, NoData)>, now: Instant) -> Vec<(String, NoData)> {
        self.missing.retain(|known, _| missing.iter().any(|(name, _)| name == known));
        let since = |name: &str, all: &mut BTreeMap<String, Instant>| *all.entry(name.to_owned()).or_insert(now);
        let all = &mut self.missing;
        missing.into_iter().filter(|(name, _)| now.duration_since(since(name, all)) >= MISSING_FOR).collect()
    }
}

impl<D: Driver> Loop<D> {
    /// Begins to read what is unread, when it is time.
    pub(super) fn begin_reading_again(&mut self, now: Instant) {
        if self.link != Link::Connected || self.reading_again.next().is_none_or(|next| now < next) {
            return;
        }
        let Some(mut abilities) = self.reading_again.abilities.take() else { return };
        let driver = self.serve.driver.clone();
        self.reading_again.task = Some(Box::pin(async move {
            let can = driver.capabilities(&mut abilities).await;
            (abilities, can)
        }));
    }

    /// What could not be read was asked for again.
    pub(super) fn read_again(&mut self, (abilities, can): ReadAgain<D>) {
        let now = Instant::now();
        let can: Result<Capabilities<D>, AlpacaError> = can;
        if let (Ok(can), Some(description)) = (can, &mut self.description) {
            for property in description.unread.keys().filter(|name| !abilities.unread().contains_key(*name)) {
                tracing::info!(device = %self.serve.device, property, "read at last");
            }
            (description.can, description.unread) = (can.clone(), abilities.unread().clone());
            self.next_description = now;
            self.status().can = Some(can);
        }
        self.reading_again.plan(abilities, now);
        self.note_unread();
    }

    /// Raises the alert that names what is unread, or clears it.
    pub(super) fn note_unread(&mut self) {
        let instance = self.instance();
        let mut unread: Vec<(String, NoData)> = Vec::new();
        if self.link == Link::Connected {
            unread.extend(self.description.iter().flat_map(|description| description.unread.clone()));
            // What is missing of these is an unsafe input, with its reason.
            if !matches!(D::Kind::KIND, Kind::SafetyMonitor | Kind::ObservingConditions | Kind::Switch) {
                let polled = self.serve.driver.polled().into_iter();
                let missing = polled.filter_map(|name| Some((self.readings.failure(&name)?.clone(), name)));
                let missing = missing.map(|(reason, name)| (name, reason)).collect();
                let long = self.reading_again.long_missing(missing, Instant::now());
                unread.extend(
                    long.into_iter()
                        .filter(|(name, _)| unread.iter().all(|(known, _)| known != name))
                        .collect::<Vec<_>>(),
                );
            }
        }
        let alerts = &self.serve.node.alerts;
        if unread.is_empty() {
            alerts.clear(AlertKind::DeviceUnread, &instance);
            return;
        }
        let named: Vec<String> = unread.iter().map(|(name, reason)| format!("{name} ({reason})")).collect();
        let cause = format!("{instance}: could not read {}; asked again", named.join(", "));
        alerts.raise(AlertKind::DeviceUnread, &instance, &cause);
    }
}
