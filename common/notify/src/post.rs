//! One receiver's task: follows the alerts, sends what is due, tries again.

use std::sync::Arc;
use std::time::Duration;

use anyhow::anyhow;
use bus::MachineTime;
use config::{Alerting, Format, Ping, Smtp, Webhook};
use contract::observatory::{AlertKind, Alerts, Priority};
use futures_util::future::join_all;
use internet::Method;
use node::Node;
use tokio::sync::watch;
use units::Utc;

use crate::http::{Ask, Http};
use crate::letter::Letter;
use crate::mail::{self, Mail};
use crate::mailbox::{Mailbox, ReceiverSettings};
use crate::push::{Subscription, Subscriptions};
use crate::secret::secret;

/// Somebody waits for the first message of a browser, machine time.
const FIRST: Duration = Duration::from_secs(10);
/// The name of the ping in the alert about it.
pub const PING: &str = "ping";
/// One failure is usual on the internet; so many in a row need a person.
const FAILURES_BEFORE_ALERT: u32 = 3;
/// Three failures of the slowest kind (a server that takes the connection and sends nothing) take so long.
const LAST_WORD: Duration = Duration::from_secs(200);
/// A ping that failed is tried again after twice this, then twice as long, up to its period.
const FIRST_PING_AGAIN: Duration = Duration::from_secs(5);

/// One receiver of alerts.
#[derive(Clone)]
pub struct Receiver {
    /// Its name in alerts about it.
    pub name: String,
    settings: ReceiverSettings,
    way: Way,
}

/// What came of a message that tests whether it arrives.
#[derive(Debug, Clone)]
pub struct TestSent {
    /// The receiver's name.
    pub receiver: String,
    /// `webhook`, `ntfy`, `e-mail` or `push`.
    pub way: &'static str,
    /// Why it was not taken; its server took it where this is absent.
    pub error: Option<String>,
}

#[derive(Clone)]
enum Way {
    Webhook(Webhook),
    Email {
        smtp: Smtp,
        to: String,
        /// All addresses of this `[[alerts.email]]`.
        all: Vec<String>,
    },
    Push {
        subscriptions: Arc<Subscriptions>,
        to: Subscription,
    },
}

impl Way {
    /// The alert that nothing arrives there.
    fn not_sent(&self) -> AlertKind {
        match self {
            Self::Webhook(_) | Self::Email { .. } => AlertKind::AlertNotSent,
            Self::Push { .. } => AlertKind::PushNotSent,
        }
    }
}

impl Way {
    fn word(&self) -> &'static str {
        match self {
            Self::Webhook(hook) if hook.format == Format::Ntfy => "ntfy",
            Self::Webhook(_) => "webhook",
            Self::Email { .. } => "e-mail",
            Self::Push { .. } => "push",
        }
    }
}

/// Sends all receivers of a configuration, and all browsers that have subscribed, a message that tests whether it arrives, at the same
/// time; `by` is who asks for it.
pub async fn send_test(
    config: &config::Observatory,
    subscriptions: Option<&Arc<Subscriptions>>,
    by: &str,
    now: Utc,
) -> Vec<TestSent> {
    let letter = &Letter::test(by, now);
    let subscribed = subscriptions.map(|all| (all, all.watch().borrow().clone()));
    let browsers = subscribed.into_iter().flat_map(|(all, known)| {
        known.into_values().map(|to| browser(&config.alerts, all.clone(), to)).collect::<Vec<_>>()
    });
    let sent = receivers(&config.alerts).into_iter().chain(browsers).map(async |receiver| {
        let error = deliver(config, &mut Http::default(), &receiver.way, letter).await.err();
        let error = error.map(|error| format!("{error:#}"));
        TestSent { way: receiver.way.word(), receiver: receiver.name, error }
    });
    join_all(sent).await
}

/// Sends a browser that is about to subscribe a message that says so.
///
/// # Errors
/// Why its push service has not taken it; [`Refused`](crate::push::Refused) where it never will.
pub async fn send_first(
    config: &config::Observatory,
    subscriptions: &Arc<Subscriptions>,
    to: &Subscription,
    now: Utc,
) -> anyhow::Result<()> {
    let letter = Letter::trial(&format!("Alerts of {} reach this device.", config.address()), now);
    let way = Way::Push { subscriptions: subscriptions.clone(), to: to.clone() };
    let mut http = Http::default();
    let sent = tokio::time::timeout(FIRST, deliver(config, &mut http, &way, &letter)).await;
    sent.map_err(|_| anyhow!("it did not answer within {} s", FIRST.as_secs()))?
}

/// All receivers that are configured.
pub fn receivers(alerting: &Alerting) -> Vec<Receiver> {
    let hooks = alerting.webhook.iter().map(|hook| {
        let (name, way) = (hook.name.clone(), Way::Webhook(hook.clone()));
        receiver(alerting, name, hook.min_priority, hook.after_min, way)
    });
    let mails = alerting.email.iter().flat_map(|email| email.to.iter().enumerate().map(move |at| (email, at)));
    let mails = mails.filter_map(|(email, (index, to))| {
        // Each address is a receiver of its own: `night` where it is alone, else `night/1` and so on.
        let name = if email.to.len() == 1 { email.name.clone() } else { format!("{}/{}", email.name, index + 1) };
        let way = Way::Email { smtp: alerting.smtp.clone()?, to: to.clone(), all: email.to.clone() };
        Some(receiver(alerting, name, email.min_priority, email.after_min, way))
    });
    hooks.chain(mails).collect()
}

/// A browser that has subscribed.
pub fn browser(alerting: &Alerting, subscriptions: Arc<Subscriptions>, to: Subscription) -> Receiver {
    let (name, min_priority, after_min) = (to.receiver(), to.min_priority, to.after_min);
    receiver(alerting, name, min_priority, after_min, Way::Push { subscriptions, to })
}

fn receiver(alerting: &Alerting, name: String, min_priority: Priority, after_min: f64, way: Way) -> Receiver {
    let settings = ReceiverSettings {
        receiver: name.clone(),
        min_priority,
        after: Duration::from_secs_f64(after_min * 60.0),
        most: alerting.flood_messages as usize,
        window: Duration::from_secs_f64(alerting.flood_minutes * 60.0),
        own_alert: way.not_sent().id(&name),
    };
    Receiver { name, settings, way }
}

/// Delivers for ever. An alert that is raised and clears during one delivery is not sent, unless it stays as cleared.
pub async fn keep_delivering(
    node: Node,
    receiver: Receiver,
    mut alerts: watch::Receiver<Option<Alerts>>,
) -> anyhow::Result<()> {
    let Receiver { name, settings, way } = receiver;
    let not_sent = way.not_sent();
    let (clock, mut http) = (node.bus.clock().clone(), Http::default());
    let fresh = || Mailbox::new(settings.clone()).begins(clock.machine(), clock.utc());
    let mut mailbox = fresh();
    let mut silent_since = None;
    loop {
        let now = clock.machine();
        let shown = alerts.borrow_and_update().clone();
        match shown {
            Some(shown) => {
                silent_since = None;
                mailbox.look(&shown, now);
                node.alerts.set_notifications(&name, mailbox.notifications());
            }
            None => {
                mailbox = fresh();
                last_word(&node, not_sent, &name, *silent_since.get_or_insert(now), now);
            }
        }
        if let Some(letter) = mailbox.due(now) {
            match deliver(&node.config, &mut http, &way, &letter).await {
                Ok(()) => {
                    mailbox.sent(&letter, clock.machine(), clock.utc());
                    node.alerts.set_notifications(&name, mailbox.notifications());
                    node.alerts.clear(not_sent, &name);
                }
                Err(error) => failed(&node, not_sent, &name, mailbox.failed(clock.machine()), &error),
            }
            continue;
        }
        tokio::select! {
            changed = alerts.changed() => changed?,
            () = tokio::time::sleep(Duration::from_secs(1)) => {}
        }
    }
}

async fn deliver(config: &config::Observatory, http: &mut Http, way: &Way, letter: &Letter) -> anyhow::Result<()> {
    let alerting = &config.alerts;
    let (address, ca_file, page) = (config.address(), alerting.ca_file.as_deref(), alerting.page.as_deref());
    match way {
        Way::Webhook(hook) => {
            let token = secret(hook.token_file.as_deref(), hook.token_env.as_deref()).await?;
            let topic = hook.topic().filter(|_| hook.format == Format::Ntfy);
            let (url, body) = match topic {
                Some((server, topic)) => (server, letter.ntfy(&address, topic, page)),
                None => (hook.url.as_str(), letter.json(&address, page)),
            };
            http.ask(Ask::new(Method::POST, url, token.as_deref(), body.to_string()), ca_file).await
        }
        Way::Email { smtp, to, all } => {
            let mail = Mail { to, all, subject: &letter.subject(&address), text: letter.text(&address, page) };
            mail::send(smtp, ca_file, mail).await
        }
        Way::Push { subscriptions, to } => subscriptions.send(to, &letter.push(&address), http, ca_file).await,
    }
}

fn failed(node: &Node, not_sent: AlertKind, name: &str, failures: u32, error: &anyhow::Error) {
    tracing::debug!(name, failures, error = format!("{error:#}"), "a receiver of alerts was not reached");
    if failures >= FAILURES_BEFORE_ALERT {
        node.alerts.raise(not_sent, name, &format!("\"{name}\" gets no alerts: {error:#}"));
    }
}

/// A node that sends no more does not know whether it could. Its alert stays active until the node that sends now knows
/// better: without an attempt there is no news about a receiver.
fn last_word(node: &Node, not_sent: AlertKind, name: &str, silent_since: MachineTime, now: MachineTime) {
    if now.since(silent_since) >= LAST_WORD {
        node.alerts.clear(not_sent, name);
    }
}

/// Pings for ever while all is well: at once when this begins, and again after a period; sooner after a failure, so
/// that one lost packet raises no alarm at the other end.
pub async fn keep_pinging(node: Node, ping: Ping, is_well: impl Fn() -> bool) -> anyhow::Result<()> {
    let (mut http, period) = (Http::default(), Duration::from_secs_f64(ping.period_s));
    let clock = node.bus.clock().clone();
    let mut failures: u32 = 0;
    let (mut next, mut silent_since) = (clock.machine(), None);
    loop {
        let now = clock.machine();
        let is_well = is_well();
        if is_well {
            silent_since = None;
        } else {
            last_word(&node, AlertKind::AlertNotSent, PING, *silent_since.get_or_insert(now), now);
        }
        if is_well && now >= next {
            let ask = Ask::new(Method::GET, &ping.url, None, String::new());
            let wait = match http.ask(ask, node.config.alerts.ca_file.as_deref()).await {
                Ok(()) => {
                    failures = 0;
                    node.alerts.clear(AlertKind::AlertNotSent, PING);
                    period
                }
                Err(error) => {
                    failures += 1;
                    failed(&node, AlertKind::AlertNotSent, PING, failures, &error);
                    period.min(FIRST_PING_AGAIN.saturating_mul(1 << failures.min(10)))
                }
            };
            next = now.plus(wait);
        }
        tokio::time::sleep(period.min(Duration::from_secs(1))).await;
    }
}
