//! One task per receiver, and one for the ping; a task that ends is started anew.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::Arc;
use std::time::Duration;

use contract::observatory::{AlertKind, Alerts};
use futures_util::future::join_all;
use tokio::sync::watch;
use tokio::task::{AbortHandle, JoinSet};

use crate::post;
use crate::push::{Subscription, Subscriptions};

/// A task that ended is started anew after this.
const PAUSE: Duration = Duration::from_secs(10);

/// Sends the `alerts` to all configured receivers, for ever; `None` while another node does.
pub async fn keep_sending(node: node::Node, alerts: watch::Receiver<Option<Alerts>>) -> anyhow::Result<()> {
    let deliver = |receiver: post::Receiver| {
        let (node, alerts) = (node.clone(), alerts.clone());
        let name = receiver.name.clone();
        let task = move |node| post::keep_delivering(node, receiver.clone(), alerts.clone());
        async move { again_and_again(&node, &name, task).await }
    };
    join_all(post::receivers(&node.config.alerts).into_iter().map(deliver)).await;
    std::future::pending().await
}

/// Sends the `alerts` to the browsers that have subscribed, for ever; `None` while nothing is known of them.
pub async fn keep_pushing(
    node: node::Node,
    subscriptions: Arc<Subscriptions>,
    alerts: watch::Receiver<Option<Alerts>>,
) -> anyhow::Result<()> {
    let mut known = subscriptions.watch();
    let mut tasks = JoinSet::new();
    let mut running: BTreeMap<String, (Subscription, AbortHandle)> = BTreeMap::new();
    loop {
        let wanted = known.borrow_and_update().clone();
        for (id, (subscription, task)) in &running {
            if wanted.get(id) != Some(subscription) {
                task.abort();
            }
        }
        for (id, to) in &wanted {
            if let Entry::Vacant(place) = running.entry(id.clone()) {
                let receiver = post::browser(&node.config.alerts, subscriptions.clone(), to.clone());
                let task = tasks.spawn(post::keep_delivering(node.clone(), receiver, alerts.clone()));
                place.insert((to.clone(), task));
            }
        }
        tokio::select! {
            changed = known.changed() => changed?,
            Some(ended) = tasks.join_next_with_id() => {
                let task = ended.as_ref().map_or_else(tokio::task::JoinError::id, |(task, _)| *task);
                let Some(id) = running.iter().find(|(_, (_, of))| of.id() == task).map(|(id, _)| id.clone()) else { continue };
                let Some((was, _)) = running.remove(&id) else { continue };
                let name = was.receiver();
                match known.borrow().get(&id) {
                    Some(now) if *now == was => {
                        node.alerts.raise(AlertKind::PushNotSent, &name, &format!("\"{name}\" gets no alerts: its task ended"));
                    }
                    // With other settings it goes on where it was.
                    Some(now) if now.receiver() == name => continue,
                    _ => {
                        node.alerts.clear(AlertKind::PushNotSent, &name);
                        node.alerts.set_notifications(&name, Vec::new());
                        continue;
                    }
                }
                tokio::time::sleep(PAUSE).await;
            }
        }
    }
}

/// Asks the configured URL in every period in which `is_well`, for ever.
pub async fn keep_pinging(node: node::Node, is_well: impl Fn() -> bool + Clone + Send + 'static) -> anyhow::Result<()> {
    if let Some(ping) = node.config.alerts.ping.clone() {
        let task = move |node| post::keep_pinging(node, ping.clone(), is_well.clone());
        again_and_again(&node, post::PING, task).await;
    }
    std::future::pending().await
}

/// Runs a task anew when it ends, for whatever reason: no one's safety may depend on a mail server.
async fn again_and_again<F>(node: &node::Node, name: &str, task: impl Fn(node::Node) -> F)
where
    F: Future<Output = anyhow::Result<()>> + Send + 'static,
{
    loop {
        let mut alone = JoinSet::new();
        alone.spawn(task(node.clone()));
        let why = match alone.join_next().await {
            Some(Ok(Err(error))) => format!("{error:#}"),
            Some(Err(error)) => error.to_string(),
            Some(Ok(Ok(()))) | None => "it ended".to_owned(),
        };
        node.alerts.raise(AlertKind::AlertNotSent, name, &format!("\"{name}\" gets no alerts: {why}"));
        tokio::time::sleep(PAUSE).await;
    }
}
