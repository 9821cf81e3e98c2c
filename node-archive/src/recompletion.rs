//! The order to complete the headers of a night again. It is in the state of the night, which is published each second, so
//! that it is not lost when this node or the bus is away.

use std::sync::Arc;

use bus::Catch;
use contract::observatory::{NightState, OrderTaken};
use contract::{Part, Topic};
use node::Node;
use sky::NightDate;
use tokio::sync::Notify;

use crate::database::{Database, Write};
use crate::night::Night;
use crate::reader::Reader;

/// The verb of the order.
const VERB: &str = "complete_headers";
/// States that wait; more than one at a time is rare.
const WAITING: usize = 64;

/// Marks the headers of ordered nights as incomplete, until the node ends; the completion does the rest.
pub async fn keep(node: Node, database: Database, incomplete: Arc<Notify>) -> anyhow::Result<()> {
    let telescope = node.config.address();
    let topic = Topic::Observatory(Part::Night).at(&telescope);
    let states = node.bus.subscribe::<NightState>(topic, Catch::All, WAITING).await?;
    let mut done = None;
    loop {
        let Some(order) = states.recv().await.sample.body.last_order else { continue };
        let Some(night) = ordered_night(&order, &node.config.place) else { continue };
        // The same order is published until there is another one.
        if done.as_ref() == Some(&order.id) {
            continue;
        }
        let file = database.path().to_owned();
        let telescope = node.config.place.telescope.clone();
        let look = move || Reader::open(&file, telescope.as_str())?.frames(night.from, night.to);
        let frames = tokio::task::spawn_blocking(look).await??;
        // Files that were delivered and removed are complete for ever.
        let images = &node.config.folders.images;
        let here = frames.into_iter().map(|frame| frame.image).filter(|image| image.path(images).exists());
        let writes: Vec<Write> = here.map(|image| Write::Recomplete(image.frame.id)).collect();
        tracing::info!(from = order.from, night = %night.date, frames = writes.len(), "headers are completed again");
        database.commit(writes).await?;
        done = Some(order.id);
        incomplete.notify_one();
    }
}

/// The night that an order is about, if it is about headers.
fn ordered_night(order: &OrderTaken, place: &config::Place) -> Option<Night> {
    let night = order.night.as_ref().filter(|_| order.verb == VERB)?;
    Some(Night::new(night.parse::<NightDate>().ok()?, place))
}
