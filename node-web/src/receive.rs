//! The subscriptions on the bus: which keys, and how they are received.

use std::sync::Arc;

use bus::{Bus, BusError, Catch, Subscriber};
use contract::{Key, Keys, NodeTopic, Stamped, Topic};
use serde::Deserialize as _;
use serde_json::Value;
use tokio::task::JoinSet;

use crate::edge;
use crate::network::Network;
use crate::preview::Previews;

/// The subscribed keys. Not all: the query for the newest values would then also go to commands and orders.
fn subscribed() -> [(Keys<'static>, Catch); 10] {
    let all = |topic: Topic| topic.everywhere();
    [
        (all(Topic::State), Catch::Newest),
        (all(Topic::Capabilities), Catch::Newest),
        (all(Topic::Guard), Catch::Newest),
        (Topic::every_part(), Catch::Newest),
        (all(Topic::Node(NodeTopic::State)), Catch::Newest),
        (all(Topic::Node(NodeTopic::Alerts)), Catch::Newest),
        // Events are not published again, so their history is queried.
        (all(Topic::Frame), Catch::All),
        (all(Topic::Facts), Catch::All),
        (all(Topic::Stored), Catch::All),
        (all(Topic::Node(NodeTopic::Diary)), Catch::All),
    ]
}

/// Receives everything of all sites, for ever; each task is one sort of key.
pub async fn everything(
    bus: &Bus,
    network: &Arc<Network>,
    previews: &Arc<Previews>,
    tasks: &mut JoinSet<anyhow::Result<()>>,
) -> Result<(), BusError> {
    for (keys, catch) in subscribed() {
        let subscriber = bus.subscribe::<Value>(keys, catch, 4096).await?;
        tasks.spawn(receive(subscriber, network.clone(), previews.clone()));
    }
    Ok(())
}

async fn receive(subscriber: Subscriber<Value>, network: Arc<Network>, previews: Arc<Previews>) -> anyhow::Result<()> {
    loop {
        let mut received = subscriber.recv().await;
        let frame = match &received.key {
            Key::Frame(device) => Some((device.clone(), received.sample.clone())),
            _ => None,
        };
        // The URL opens the spool to every person who has it: it is not for browsers.
        if let (Some(_), Value::Object(body)) = (&frame, &mut received.sample.body) {
            body.remove("url");
        }
        let arrived = received.arrived;
        if let Err(why) = edge::check(&received.key, &received.sample.body) {
            network.refuse(&received.key, why, arrived);
            continue;
        }
        if network.accept(received)
            && let Some((device, Stamped { body, .. })) = frame
        {
            match contract::device::camera::Frame::deserialize(&body) {
                Ok(frame) => previews.want(device, frame, arrived),
                Err(error) => tracing::warn!(%device, %error, "a frame that cannot be read was announced"),
            }
        }
    }
}
