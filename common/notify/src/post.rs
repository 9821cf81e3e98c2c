//! One receiver's task: follows the alerts, sends what is due, tries again.

use std::path::Path;
use std::time::Duration;

use anyhow::Context as _;
use bus::Node;
use config::{Alerting, Email, Ping, Smtp, Webhook};
use contract::observatory::{AlertKind, Alerts, Priority};
use hyper::Method;
use tokio::sync::watch;

use crate::http::Http;
use crate::letter::Letter;
use crate::mail;
use crate::mailbox::{Mailbox, Wish};

/// What the ping is called in the alert about it.
pub const PING: &str = "ping";
/// One failure is the weather of the internet; so many in a row need a person.
const FAILURES_BEFORE_ALERT: u32 = 3;

/// Who is told.
#[derive(Clone)]
pub struct Receiver {
    /// Its name in alerts about it.
    pub name: String,
    wish: Wish,
    way: Way,
}

#[derive(Clone)]
enum Way {
    Webhook(Webhook),
    Email(Smtp, Email),
}

/// All who are configured.
pub fn receivers(alerting: &Alerting) -> Vec<Receiver> {
    let receiver = |name: &str, min_priority: Priority, after_min: f64, way: Way| {
        let wish = Wish {
            min_priority,
            after: Duration::from_secs_f64(after_min * 60.0),
            most: alerting.flood_messages as usize,
            window: Duration::from_secs_f64(alerting.flood_minutes * 60.0),
            own_alert: AlertKind::AlertNotSent.id(name),
        };
        Receiver { name: name.to_owned(), wish, way }
    };
    let hooks = alerting.webhook.iter();
    let hooks = hooks.map(|hook| receiver(&hook.name, hook.min_priority, hook.after_min, Way::Webhook(hook.clone())));
    let mails = alerting.email.iter().filter_map(|email| {
        let way = Way::Email(alerting.smtp.clone()?, email.clone());
        Some(receiver(&email.name, email.min_priority, email.after_min, way))
    });
    hooks.chain(mails).collect()
}

/// Delivers for ever. An alert that comes and goes during one delivery is not told, unless it stays as returned.
pub async fn keep_delivering(
    node: Node,
    receiver: Receiver,
    mut alerts: watch::Receiver<Option<Alerts>>,
) -> anyhow::Result<()> {
    let Receiver { name, wish, way } = receiver;
    let (clock, http) = (node.bus.clock().clone(), Http::new()?);
    let mut mailbox = Mailbox::new(wish.clone());
    loop {
        let now = clock.machine();
        let shown = alerts.borrow_and_update().clone();
        match shown {
            Some(shown) => mailbox.look(&shown, now),
            // whoever speaks now tells it anew
            None => mailbox = Mailbox::new(wish.clone()),
        }
        if let Some(letter) = mailbox.due(now) {
            match deliver(&node, &http, &way, &letter).await {
                Ok(()) => {
                    mailbox.sent(&letter, clock.machine());
                    node.alerts.clear(AlertKind::AlertNotSent, &name);
                }
                Err(error) => failed(&node, &name, mailbox.failed(clock.machine()), &error),
            }
            continue;
        }
        tokio::select! {
            changed = alerts.changed() => changed?,
            () = tokio::time::sleep(Duration::from_secs(1)) => {}
        }
    }
}

async fn deliver(node: &Node, http: &Http, way: &Way, letter: &Letter) -> anyhow::Result<()> {
    let address = node.config.address();
    match way {
        Way::Webhook(hook) => {
            let token = secret(hook.token_file.as_deref(), hook.token_env.as_deref()).await?;
            let body = letter.json(&address).to_string();
            http.ask(Method::POST, &hook.url, token.as_deref(), body).await
        }
        Way::Email(smtp, email) => mail::send(smtp, email, &letter.subject(&address), letter.text(&address)).await,
    }
}

fn failed(node: &Node, name: &str, failures: u32, error: &anyhow::Error) {
    tracing::debug!(name, failures, error = format!("{error:#}"), "a receiver of alerts was not reached");
    if failures >= FAILURES_BEFORE_ALERT {
        node.alerts.raise(AlertKind::AlertNotSent, name, &format!("\"{name}\" gets no alerts: {error:#}"));
    }
}

/// Pings for ever while all is well.
pub async fn keep_pinging(node: Node, ping: Ping, is_well: impl Fn() -> bool) -> anyhow::Result<()> {
    let (http, period) = (Http::new()?, Duration::from_secs_f64(ping.period_s));
    let mut failures = 0;
    loop {
        if is_well() {
            match http.ask(Method::GET, &ping.url, None, String::new()).await {
                Ok(()) => {
                    failures = 0;
                    node.alerts.clear(AlertKind::AlertNotSent, PING);
                }
                Err(error) => {
                    failures += 1;
                    failed(&node, PING, failures, &error);
                }
            }
        }
        tokio::time::sleep(period).await;
    }
}

/// A secret from its file or its environment variable, read anew each time: it may have been renewed.
pub async fn secret(file: Option<&Path>, variable: Option<&str>) -> anyhow::Result<Option<String>> {
    let text = match (file, variable) {
        (Some(file), _) => {
            let read = tokio::fs::read_to_string(file).await;
            read.with_context(|| format!("the secret file {} cannot be read", file.display()))?
        }
        (None, Some(variable)) => {
            std::env::var(variable).with_context(|| format!("the environment variable {variable} holds no secret"))?
        }
        (None, None) => return Ok(None),
    };
    Ok(Some(text.trim().to_owned()))
}
