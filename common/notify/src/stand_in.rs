//! Sends in the place of an observatory node that fell silent.

use std::collections::BTreeMap;
use std::time::Duration;

use bus::{Catch, MachineTime, Node};
use contract::observatory::{AlertKind, Alerts, merge};
use contract::{Key, Name, NodeTopic, Part, Role};
use tokio::sync::watch;

/// Alerts are said every 10 s; a node that is silent for longer than this has no say any more.
const SILENCE: Duration = Duration::from_secs(60);

/// Sends in its place while it is silent, for ever; does nothing where the configuration gives it to another role.
///
/// It does not know what was sent before: what stands then is told again.
///
/// # Errors
///
/// The bus cannot be listened to.
pub async fn keep_standing_in(node: Node) -> anyhow::Result<()> {
    let alerting = &node.config.alerts;
    let Some(patience_s) = alerting.send_when_observatory_silent_s.filter(|_| alerting.stand_in == node.role) else {
        return std::future::pending().await;
    };
    let (shown, alerts) = watch::channel(None);
    tokio::select! {
        result = crate::keep_sending(node.clone(), alerts) => result,
        result = keep_watching(&node, Duration::from_secs_f64(patience_s), &shown) => result,
    }
}

async fn keep_watching(node: &Node, patience: Duration, shown: &watch::Sender<Option<Alerts>>) -> anyhow::Result<()> {
    let address = node.config.address();
    let merged = node.bus.latest::<Alerts>(&Key::Observatory(address.clone(), Part::Alerts)).await?;
    let expression = format!("{}/{address}/node/*/*/{}", contract::key::ROOT, NodeTopic::Alerts.word());
    let nodes = node.bus.subscribe::<Alerts>(&expression, Catch::Newest, 256).await?;
    let clock = node.bus.clock().clone();
    let began = clock.machine();
    let mut own = node.alerts.watch();
    let mut heard: BTreeMap<(Role, Name), (Alerts, MachineTime)> = BTreeMap::new();
    let instance = format!("{}/{}", Role::Observatory, address.telescope);
    loop {
        let now = clock.machine();
        let is_silent = merged.fresh(patience).is_none() && now.since(began) >= patience;
        if is_silent {
            let cause = format!("no observatory node of {address} was heard for {} s", patience.as_secs());
            node.alerts.raise(AlertKind::NodeSilent, &instance, &cause);
        } else {
            node.alerts.clear(AlertKind::NodeSilent, &instance);
        }
        heard.retain(|_, (_, arrived)| now.since(*arrived) <= SILENCE);
        let lists = std::iter::once(own.borrow_and_update().clone());
        // what the observatory said last still holds what people acknowledged
        let last = merged.get().map(|last| last.said.body).unwrap_or_default();
        let mut all = merge(lists.chain(heard.values().map(|(alerts, _)| alerts.clone())));
        for alert in &mut all.alerts {
            if let Some(known) = last.alerts.iter().find(|known| known.id == alert.id) {
                *alert = known.clone();
            }
        }
        let now_shown = is_silent.then_some(all);
        shown.send_if_modified(|shown| {
            let is_new = *shown != now_shown;
            *shown = now_shown;
            is_new
        });
        tokio::select! {
            alerts = nodes.hear() => {
                if let Key::Node(_, role, id, NodeTopic::Alerts) = alerts.key
                    && (role, &id) != (node.role, &node.id)
                {
                    heard.insert((role, id), (alerts.said.body, alerts.arrived));
                }
            }
            changed = own.changed() => changed?,
            () = tokio::time::sleep(Duration::from_secs(1)) => {}
        }
    }
}
