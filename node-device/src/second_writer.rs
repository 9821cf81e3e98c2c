//! Notices when another node serves the same device: one key has one writer.

use std::time::Duration;

use bus::Catch;
use contract::device::DeviceDescription;
use contract::observatory::AlertKind;
use contract::{Device, Key};
use node::Node;
use serde_json::Value;

/// Capabilities are published every 10 s; a second writer that was silent for three of them is gone.
const GONE: Duration = Duration::from_secs(30);

/// Watches a device's capabilities until the node is stopped.
pub async fn watch(node: Node, device: Device) -> anyhow::Result<()> {
    let key = Key::Capabilities(device.clone()).to_string();
    let descriptions = node.bus.subscribe::<DeviceDescription<Value>>(&key, Catch::Newest, 8).await?;
    let instance = format!("{}/{}", device.kind, device.name);
    let clock = node.bus.clock().clone();
    let mut foreign = None;
    loop {
        let Some(received) = node.stop.or(tokio::time::timeout(GONE, descriptions.recv())).await else { return Ok(()) };
        let now = clock.machine();
        if let Ok(received) = received
            && received.sample.boot_id != *node.bus.boot_id()
        {
            foreign = Some(now);
            let cause = format!("{device} is also served by the node with boot id {}", received.sample.boot_id);
            node.alerts.raise(AlertKind::SecondWriter, &instance, &cause);
        }
        if foreign.is_some_and(|at| now.since(at) > GONE) {
            foreign = None;
            node.alerts.clear(AlertKind::SecondWriter, &instance);
        }
    }
}
