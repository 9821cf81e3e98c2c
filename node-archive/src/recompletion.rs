//! The order to complete the headers of a night again. It is in the state of the night, which is published each second, so
//! that it is not lost when this node or the bus is away. Files on a disk that is away are not taken for removed ones: the
//! order waits for it, whatever is ordered meanwhile, and an alert says so.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use bus::Catch;
use config::Observatory;
use contract::observatory::{AlertKind, NightState, OrderTaken};
use contract::{CommandId, Part, Topic};
use node::Node;
use sky::NightDate;
use tokio::sync::Notify;

use crate::database::{Database, Write};
use crate::folder::is_stored;
use crate::night::Night;
use crate::reader::Reader;

/// The verb of the order.
const VERB: &str = "complete_headers";
/// States that wait; more than one at a time is rare.
const WAITING: usize = 64;
/// A night whose files cannot be looked for is tried again after this, machine time.
const AGAIN: Duration = Duration::from_secs(5);
/// The key of the configuration that the alert is about.
const KEY: &str = "folders.images";

/// Marks the headers of ordered nights as incomplete, until the node ends; the completion does the rest.
pub async fn keep(node: Node, database: Database, incomplete: Arc<Notify>) -> anyhow::Result<()> {
    let telescope = node.config.address();
    let topic = Topic::Observatory(Part::Night).at(&telescope);
    let states = node.bus.subscribe::<NightState>(topic, Catch::All, WAITING).await?;
    let mut again = tokio::time::interval(AGAIN);
    let (mut newest, mut waiting) = (None, BTreeMap::new());
    loop {
        tokio::select! {
            received = states.recv() => {
                let Some(order) = received.sample.body.last_order else { continue };
                let Some(night) = ordered_night(&order, &node.config.place) else { continue };
                // The same order is published until there is another one.
                if newest.as_ref() == Some(&order.id) {
                    continue;
                }
                tracing::info!(from = order.from, night = %night.date, "the headers of a night are ordered again");
                newest = Some(order.id);
                waiting.insert(night.date, night);
            }
            _ = again.tick(), if !waiting.is_empty() => {}
        }
        let (mut marked, mut fault) = (Vec::new(), None);
        for night in waiting.values().copied() {
            let (config, file) = (node.config.clone(), database.path().to_owned());
            match tokio::task::spawn_blocking(move || frames_here(&config, &file, &night)).await? {
                Ok(frames) => {
                    tracing::info!(night = %night.date, frames = frames.len(), "headers are completed again");
                    database.commit(frames.into_iter().map(Write::Recomplete).collect()).await?;
                    marked.push(night.date);
                }
                Err(error) => {
                    let what = format!("the headers of night {} wait to be completed again", night.date);
                    fault = Some(format!("{KEY}: {error:#}. {what}, which is tried each {} s", AGAIN.as_secs()));
                }
            }
        }
        waiting.retain(|date, _| !marked.contains(date));
        if !marked.is_empty() {
            incomplete.notify_one();
        }
        match fault {
            Some(cause) => node.alerts.raise(AlertKind::Configuration, KEY, &cause),
            None => node.alerts.clear(AlertKind::Configuration, KEY),
        }
        again.reset();
    }
}

/// The frames of a night whose files are there: files that were delivered and removed are complete for ever. Blocks.
///
/// # Errors
/// The disk of the files is away, or the database cannot be read.
fn frames_here(config: &Observatory, database: &Path, night: &Night) -> anyhow::Result<Vec<CommandId>> {
    let frames = Reader::open(database, config.place.telescope.as_str())?.frames(night.from, night.to)?;
    let mut here = Vec::new();
    for image in frames.into_iter().map(|frame| frame.image) {
        if is_stored(&config.folders.images, &image.path(&config.folders.images))? {
            here.push(image.frame.id);
        }
    }
    Ok(here)
}

/// The night that an order is about, if it is about headers.
fn ordered_night(order: &OrderTaken, place: &config::Place) -> Option<Night> {
    let night = order.night.as_ref().filter(|_| order.verb == VERB)?;
    Some(Night::new(night.parse::<NightDate>().ok()?, place))
}
