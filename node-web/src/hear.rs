//! The subscriptions on the bus: which keys, and how they are received.

use std::sync::Arc;

use bus::{Bus, BusError, Catch, Subscriber};
use contract::key::ROOT;
use contract::{Key, Stamped};
use serde::Deserialize as _;
use serde_json::Value;
use tokio::task::JoinSet;

use crate::edge;
use crate::network::Network;
use crate::preview::Previews;

/// The subscribed keys. Not `**`: the query for the newest values would then also go to commands and orders.
const HEARD: &[(&str, Catch)] = &[
    ("device/*/*/state", Catch::Newest),
    ("device/*/*/capabilities", Catch::Newest),
    ("device/dome/*/guard", Catch::Newest),
    ("observatory/*/state", Catch::Newest),
    ("node/*/*/state", Catch::Newest),
    ("node/*/*/alerts", Catch::Newest),
    // Events are not published again, so their history is queried.
    ("device/camera/*/frame", Catch::All),
    ("observatory/frame/*/facts", Catch::All),
    ("archive/stored", Catch::All),
    ("node/*/*/diary", Catch::All),
];

/// Receives everything of all sites, for ever; each task is one sort of key.
pub async fn everything(
    bus: &Bus,
    network: &Arc<Network>,
    previews: &Arc<Previews>,
    tasks: &mut JoinSet<anyhow::Result<()>>,
) -> Result<(), BusError> {
    for (keys, catch) in HEARD {
        let subscriber = bus.subscribe::<Value>(&format!("{ROOT}/*/*/{keys}"), *catch, 4096).await?;
        tasks.spawn(hear(subscriber, network.clone(), previews.clone()));
    }
    Ok(())
}

async fn hear(subscriber: Subscriber<Value>, network: Arc<Network>, previews: Arc<Previews>) -> anyhow::Result<()> {
    loop {
        let mut heard = subscriber.hear().await;
        let frame = match &heard.key {
            Key::Frame(device) => Some((device.clone(), heard.said.clone())),
            _ => None,
        };
        // The URL opens the spool to every person who has it: it is not for browsers.
        if let (Some(_), Value::Object(body)) = (&frame, &mut heard.said.body) {
            body.remove("url");
        }
        let arrived = heard.arrived;
        if let Err(why) = edge::check(&heard.key, &heard.said.body) {
            network.refuse(&heard.key, why, arrived);
            continue;
        }
        if network.accept(heard)
            && let Some((device, Stamped { body, .. })) = frame
        {
            match contract::device::camera::Frame::deserialize(&body) {
                Ok(frame) => previews.want(device, frame, arrived),
                Err(error) => tracing::warn!(%device, %error, "a frame that cannot be read was announced"),
            }
        }
    }
}
