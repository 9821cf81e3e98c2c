//! The archive node delivers each night when it is over, again and again until the destination has it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bus::MachineTime;
use config::{Delivery, Observatory};
use contract::Scalar;
use contract::observatory::AlertKind;
use node::Node;
use sky::{NightDate, Observer};
use tokio::task::JoinSet;
use units::Utc;

use super::record::{DueNights, Record, place_of, set_of};
use super::removal;
use super::run::{Delivered, Run};
use super::selection::Selected;
use crate::night::Night;
use crate::reader::Reader;

/// How often it is looked whether there is something to deliver, machine time.
const EVERY: Duration = Duration::from_secs(10);
/// How often it is looked whether a night is late while a try is under way.
const MEANWHILE: Duration = Duration::from_secs(60);
/// First and longest wait before a night that failed is tried again, machine time.
const FIRST_WAIT: Duration = Duration::from_secs(10);
const LONGEST_WAIT: Duration = Duration::from_secs(1800);
/// After so many failures in a row an alert is raised, also before the night's time is over.
const FAILURES_BEFORE_ALERT: u32 = 3;
/// A night is over when the Sun is up and no frame was stored for so long, sky s; or at noon.
const QUIET_S: f64 = 600.0;
/// How often it is looked whether files can be removed, machine time: each look reads nights at their destinations.
const REMOVAL_EVERY: Duration = Duration::from_secs(6 * 3600);
/// After a removal that failed it is looked again after twice this, then after twice as long each time.
const REMOVAL_RETRY: Duration = Duration::from_secs(10);
/// The alert of removals, in the place of a destination's name.
const REMOVAL: &str = "removal";

/// Delivers, and removes what is delivered, until the node ends.
pub async fn keep(node: Node, database: PathBuf) -> anyhow::Result<()> {
    let mut tasks = JoinSet::new();
    // A destination that is slow or silent delays no other.
    for delivery in node.config.delivery.iter().filter(|delivery| delivery.days > 0) {
        tasks.spawn(deliver(node.clone(), database.clone(), delivery.clone()));
    }
    if let Some(days) = node.config.archive.remove_delivered_after_days {
        tasks.spawn(remove(node.clone(), database, days));
    }
    match tasks.join_next().await {
        Some(ended) => ended?,
        None => std::future::pending().await,
    }
}

/// How many frames each night had when all of them were at the destination.
type Counts = BTreeMap<NightDate, u64>;

/// The state of a night that is not delivered.
#[derive(Debug, Clone)]
struct Undelivered {
    failures: u32,
    not_before: MachineTime,
    why: String,
}

async fn deliver(node: Node, database: PathBuf, delivery: Delivery) -> anyhow::Result<()> {
    let mut undelivered: BTreeMap<NightDate, Undelivered> = BTreeMap::new();
    let known = Arc::new(Mutex::new(Counts::new()));
    let figure = format!("nights_to_deliver_{}", delivery.name);
    let mut unknown = 0;
    loop {
        let now = node.bus.clock().utc();
        let nights = match due(&node, &database, &delivery, now, &known).await {
            Ok(nights) => nights,
            Err(error) => {
                // What was to be delivered still is, and so is its alert.
                let cause =
                    format!("the nights that are to be delivered to {} are not known: {error:#}", delivery.name);
                tracing::warn!(cause, "nights to deliver are not known");
                unknown += 1;
                if unknown >= FAILURES_BEFORE_ALERT {
                    node.alerts.raise(AlertKind::ArchiveDelivery, &delivery.name, &cause);
                }
                tokio::time::sleep(EVERY).await;
                continue;
            }
        };
        unknown = 0;
        undelivered.retain(|date, _| nights.iter().any(|night| night.date == *date));
        node.figure(&figure, Scalar::Int(nights.len() as i64));
        let mut waiting: BTreeSet<NightDate> = nights.iter().map(|night| night.date).collect();
        for night in &nights {
            let before = undelivered.get(&night.date);
            if before.is_some_and(|known| known.not_before > node.bus.clock().machine()) {
                continue;
            }
            let failures = before.map_or(0, |known| known.failures);
            let attempt = attempt(&node, &database, &delivery, night);
            tokio::pin!(attempt);
            // A try may take hours; that a night is late is reported meanwhile.
            let ended = loop {
                tokio::select! {
                    ended = &mut attempt => break ended,
                    () = tokio::time::sleep(MEANWHILE) => report(&node, &delivery, &waiting, &undelivered),
                }
            };
            match ended {
                None => {
                    undelivered.remove(&night.date);
                    waiting.remove(&night.date);
                }
                Some(why) => {
                    tracing::warn!(destination = %delivery.name, night = %night.date, why, "a night is not delivered yet");
                    let wait = FIRST_WAIT.saturating_mul(1 << failures.min(10)).min(LONGEST_WAIT);
                    let not_before = node.bus.clock().machine().plus(wait);
                    undelivered.insert(night.date, Undelivered { failures: failures + 1, not_before, why });
                }
            }
            report(&node, &delivery, &waiting, &undelivered);
        }
        report(&node, &delivery, &waiting, &undelivered);
        tokio::time::sleep(EVERY).await;
    }
}

/// Tries once; returns why the night is not delivered.
async fn attempt(node: &Node, database: &Path, delivery: &Delivery, night: &Night) -> Option<String> {
    let run = Run { config: &node.config, delivery, night: *night, database, now: node.bus.clock().utc() };
    let done = run.deliver().await;
    for line in done.iter().flat_map(Delivered::warning_lines) {
        tracing::warn!(destination = %delivery.name, night = %night.date, "{line}");
    }
    match done {
        Ok(done) if done.manifest.is_some() => {
            let (destination, night) = (&delivery.name, night.date);
            tracing::info!(%destination, %night, frames = done.frames, sent = done.sent, "a night was delivered");
            None
        }
        Ok(done) => Some(done.fault().unwrap_or_else(|| format!("{} headers are not complete", done.incomplete))),
        Err(error) => Some(format!("{error:#}")),
    }
}

/// One alert for all nights of a destination.
fn report(
    node: &Node,
    delivery: &Delivery,
    waiting: &BTreeSet<NightDate>,
    undelivered: &BTreeMap<NightDate, Undelivered>,
) {
    let now = node.bus.clock().utc();
    let place = &node.config.place;
    let is_late = |date: &NightDate| deadline(&Night::new(*date, place), delivery).is_some_and(|by| now >= by);
    let has_failed =
        |date: &NightDate| undelivered.get(date).is_some_and(|known| known.failures >= FAILURES_BEFORE_ALERT);
    let worth: Vec<_> = waiting
        .iter()
        .filter(|date| has_failed(date) || is_late(date))
        .map(|date| {
            (date, undelivered.get(date).map_or("it is under way, or waits for a night before it", |known| &known.why))
        })
        .collect();
    // What failed says more than what waits for it.
    let Some((date, why)) = worth.iter().find(|(date, _)| undelivered.contains_key(date)).or(worth.first()) else {
        return node.alerts.clear(AlertKind::ArchiveDelivery, &delivery.name);
    };
    let others = if worth.len() > 1 { format!(" ({} nights in all)", worth.len()) } else { String::new() };
    let by = if is_late(date) { format!(" by {}", delivery.by) } else { String::new() };
    let cause = format!("night {date} was not delivered to {}{by}{others}: {why}", delivery.name);
    node.alerts.raise(AlertKind::ArchiveDelivery, &delivery.name, &cause);
}

/// When a night must have been delivered.
pub(super) fn deadline(night: &Night, delivery: &Delivery) -> Option<Utc> {
    delivery.by_hours_after_noon().map(|hours| night.to.plus_seconds(hours * 3600.0))
}

/// The nights that are over and that the destination does not have, the oldest first.
async fn due(
    node: &Node,
    database: &Path,
    delivery: &Delivery,
    now: Utc,
    known: &Arc<Mutex<Counts>>,
) -> anyhow::Result<Vec<Night>> {
    let (config, database, delivery, known) =
        (node.config.clone(), database.to_owned(), delivery.clone(), known.clone());
    let look = move || -> anyhow::Result<Vec<Night>> {
        let reader = Reader::open(&database, config.place.telescope.as_str())?;
        let due_nights = DueNights::of(&config, delivery.name.as_str());
        let (mut dates, mut night) = (BTreeSet::from_iter(due_nights.dates()), Night::at(now, &config.place));
        for _ in 0..=delivery.days {
            dates.insert(night.date);
            night = Night::new(night.date.previous(), &config.place);
        }
        let (mut found, place) = (Vec::new(), place_of(&delivery));
        let mut known = known.lock().unwrap_or_else(PoisonError::into_inner);
        for date in dates {
            let of = Night::new(date, &config.place);
            let count = reader.count_frames(of.from, of.to)?;
            // Most nights are delivered and get no more frames.
            if count == 0 || known.get(&of.date) == Some(&count) {
                continue;
            }
            let selected = Selected::of(&reader, &of, &config, &delivery)?;
            let record = Record::read(&config, delivery.name.as_str(), &of)?;
            if selected.images.is_empty() || record.is_delivered(&set_of(selected.ids()), &place) {
                known.insert(of.date, count);
                due_nights.remove(date)?;
            } else if is_over(&config, &of, &selected, &delivery, now) {
                due_nights.add(date)?;
                found.push(of);
            }
        }
        Ok(found)
    };
    tokio::task::spawn_blocking(look).await?
}

/// Is a night over, as far as it can be known: by noon, or in the morning, when the frames are whole and no new one comes?
fn is_over(config: &Observatory, night: &Night, selected: &Selected, delivery: &Delivery, now: Utc) -> bool {
    // What lacks is reported then.
    if now >= night.to || deadline(night, delivery).is_some_and(|by| now >= by) {
        return true;
    }
    let newest = selected.images.iter().map(|image| image.stored).max();
    let is_quiet = newest.is_none_or(|newest| now.seconds_since(newest) >= QUIET_S);
    let middle = night.from.plus_seconds(night.to.seconds_since(night.from) / 2.0);
    now > middle && is_quiet && selected.incomplete == 0 && is_sun_up(config, now)
}

fn is_sun_up(config: &Observatory, now: Utc) -> bool {
    let observer = config.place.on_earth().and_then(|(place, earth)| Observer::new(&place, &earth, now));
    observer.is_ok_and(|observer| observer.sun().altitude.degrees() > 0.0)
}

async fn remove(node: Node, database: PathBuf, days: u32) -> anyhow::Result<()> {
    let mut failures = 0;
    loop {
        match remove_old(&node, &database, days).await {
            Ok(()) => {
                failures = 0;
                node.alerts.clear(AlertKind::ArchiveDelivery, REMOVAL);
            }
            Err(error) => {
                let cause = format!("nothing more is removed from the archive: {error:#}");
                tracing::warn!(cause, "delivered files are not removed");
                failures += 1;
                // The first one may only have met a delivery that is under way.
                if failures > 1 {
                    node.alerts.raise(AlertKind::ArchiveDelivery, REMOVAL, &cause);
                }
            }
        }
        let again = if failures == 0 { REMOVAL_EVERY } else { REMOVAL_RETRY.saturating_mul(1 << failures.min(12)) };
        tokio::time::sleep(again.min(REMOVAL_EVERY)).await;
    }
}

/// Removes what is old enough, night by night, up to the first one that cannot be removed.
async fn remove_old(node: &Node, database: &Path, days: u32) -> anyhow::Result<()> {
    let now = node.bus.clock().utc();
    for night in removal::nights(&node.config, database, now, days).await? {
        let removed = removal::remove(&node.config, &night, database).await?;
        if removed.files > 0 {
            let (files, bytes) = (removed.files, removed.bytes);
            tracing::info!(night = %night.date, files, bytes, "delivered files were removed from the archive");
        }
    }
    Ok(())
}
