//! Publishes the focus while no run is under way, and the runs that have ended.

use std::sync::Arc;
use std::time::Duration;

use bus::Catch;
use contract::Key;
use contract::observatory::{FocusRun, FocuserFocus};
use node::Node;
use tokio::sync::mpsc;

use super::FocusData;
use crate::devices::Devices;
use crate::devices::focuser::Focuser;

/// The best positions are looked at again so often, machine time.
const PERIOD: Duration = Duration::from_secs(1);
/// Runs that wait to be looked at.
const WAITING: usize = 256;
/// Published temperatures are rounded to this, degrees: the readings jitter.
const TEMPERATURE_STEP_C: f64 = 0.1;

/// Keeps the published state of each focuser true.
pub async fn keep_showing(devices: Arc<Devices>, focus: Arc<FocusData>) -> anyhow::Result<()> {
    loop {
        let focusers: Vec<FocuserFocus> = devices.focusers.iter().map(|focuser| known(&focus, focuser)).collect();
        focus.state.send_if_modified(|published| {
            let best_position = focusers.first().and_then(|focuser| focuser.best_position);
            let is_new = published.focusers != focusers || published.best_position != best_position;
            if published.detail.is_empty() {
                published.detail = "no focus run since this node started".to_owned();
            }
            (published.focusers, published.best_position) = (focusers, best_position);
            is_new
        });
        tokio::time::sleep(PERIOD).await;
    }
}

fn known(focus: &FocusData, focuser: &Focuser) -> FocuserFocus {
    let learned = focus.learned.get();
    let model = learned.model(focuser.name());
    let temperature_c = focuser.temperature_c().map(|c| (c / TEMPERATURE_STEP_C).round() * TEMPERATURE_STEP_C);
    FocuserFocus {
        focuser: focuser.name().to_owned(),
        best_position: focuser.best(),
        // Without the digits of the multiplication.
        temperature_c: temperature_c.map(|c| (c * 1000.0).round() / 1000.0),
        runs: u32::try_from(learned.runs(focuser.name()).len()).unwrap_or(u32::MAX),
        steps_per_c: model.map(|model| model.steps_per_c.value),
        steps_per_c_error: model.map(|model| model.steps_per_c.error).filter(|error| error.is_finite()),
    }
}

/// Publishes each run once more when it has ended; a node that was away can recover them.
pub async fn keep_publishing_runs(node: Node, mut runs: mpsc::UnboundedReceiver<FocusRun>) -> anyhow::Result<()> {
    let key = Key::FocusRun(node.config.address());
    let line = node.bus.publisher::<FocusRun>(&key).await?;
    while let Some(run) = runs.recv().await {
        line.put(run).await?;
    }
    // The sender lives as long as the node.
    std::future::pending().await
}

/// Learns from the runs of another incarnation or node, so that a standby goes on with what the commander has found.
pub async fn keep_receiving_runs(node: Node, focus: Arc<FocusData>) -> anyhow::Result<()> {
    let key = Key::FocusRun(node.config.address());
    let runs = node.bus.subscribe::<FocusRun>(&key.to_string(), Catch::All, WAITING).await?;
    loop {
        let received = runs.recv().await;
        if received.sample.boot_id != *node.bus.boot_id() {
            focus.learned.change(|learned| learned.learn(&received.sample.body));
        }
    }
}
