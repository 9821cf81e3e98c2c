//! One task per receiver, and one for the ping; a task that ends is started anew.

use std::time::Duration;

use contract::observatory::{AlertKind, Alerts};
use futures_util::future::join_all;
use tokio::sync::watch;
use tokio::task::JoinSet;

use crate::post;

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
        tokio::time::sleep(Duration::from_secs(10)).await;
    }
}
