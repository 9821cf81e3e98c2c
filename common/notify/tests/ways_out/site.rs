//! A node with receivers, whose own alerts are sent too, and everything that it wrote into a log.

use std::io::Write;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use bus::Clock;
use contract::Role;
use contract::observatory::{Alert, AlertKind, Alerts, merge};
use node::Node;
use tempfile::TempDir;
use test_support::{ALPHA, LIMIT, private_bus, within};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

pub struct Site {
    pub node: Node,
    folder: TempDir,
    raised: watch::Sender<Alerts>,
    _tasks: JoinSet<()>,
}

impl Site {
    /// `more` of the configuration, and the files that it names.
    pub async fn open(more: &str, files: &[(&str, &str)]) -> Self {
        listen_to_logs();
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        let config = config::parse(&format!("{ALPHA}{more}"), folder.path()).unwrap();
        let bus = private_bus(Clock::machine_clock()).await;
        let node = Node::new(Role::Observatory, "main".parse().unwrap(), config, Default::default(), bus);
        let (raised, mut given) = watch::channel(Alerts::default());
        let (shown, alerts) = watch::channel(None);
        let (mut tasks, mut own) = (JoinSet::new(), node.alerts.watch());
        let (sending, pinging, published) = (node.clone(), node.clone(), node.alerts.clone());
        tasks.spawn(async move { drop(notify::keep_sending(sending, alerts).await) });
        tasks.spawn(async move { drop(notify::keep_pinging(pinging, || true).await) });
        tasks.spawn(async move { published.keep_time().await });
        tasks.spawn(async move {
            loop {
                let lists = [given.borrow_and_update().clone(), own.borrow_and_update().clone()];
                let _ = shown.send(Some(merge(lists.into_iter())));
                let changed = tokio::select! {
                    changed = given.changed() => changed,
                    changed = own.changed() => changed,
                };
                if changed.is_err() {
                    return;
                }
            }
        });
        Self { node, folder, raised, _tasks: tasks }
    }

    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Raises a critical alert; returns its id.
    pub fn raise(&self, name: &str) -> String {
        let alert = AlertKind::DomeNotClosed.alert(name, self.node.bus.clock().utc(), "it is half open");
        let id = alert.id.clone();
        self.raised.send_modify(|alerts| alerts.alerts.push(alert));
        id
    }

    /// The alert about a receiver.
    pub fn undelivered(&self, receiver: &str) -> Option<Alert> {
        let id = AlertKind::AlertNotSent.id(receiver);
        self.node.alerts.watch().borrow().alerts.iter().find(|alert| alert.id == id).cloned()
    }

    /// Waits until a receiver is reported as not reached, and returns why.
    pub async fn why_not(&self, receiver: &str) -> String {
        self.until(&format!("an alert about {receiver}"), || self.undelivered(receiver).is_some()).await;
        self.undelivered(receiver).unwrap().cause
    }

    pub async fn until(&self, what: &str, holds: impl Fn() -> bool) {
        let held = within(LIMIT, || holds().then_some(())).await;
        assert!(held.is_some(), "{what}: not within {LIMIT:?}; {:?}", *self.node.alerts.watch().borrow());
    }

    /// Neither log nor bus contains any of these words.
    pub fn hides(&self, secrets: &[&str]) {
        let log = LOG.lock().unwrap_or_else(PoisonError::into_inner);
        let log = String::from_utf8_lossy(&log);
        assert!(log.contains("a receiver of alerts was not reached"), "the log is read at all levels");
        let bus = serde_json::to_string(&*self.node.alerts.watch().borrow()).unwrap();
        for secret in secrets {
            assert!(!log.contains(secret), "{secret} is in the log");
            assert!(!bus.contains(secret), "{secret} is on the bus: {bus}");
        }
    }
}

static LOG: Mutex<Vec<u8>> = Mutex::new(Vec::new());

struct Receiver;

impl Write for Receiver {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        LOG.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Every line that any crate logs, except zenoh, which never sees a secret and logs a lot.
fn listen_to_logs() {
    let all = Targets::new().with_default(LevelFilter::TRACE).with_target("zenoh", LevelFilter::OFF);
    let layer = tracing_subscriber::fmt::layer().with_ansi(false).with_writer(|| Receiver);
    // The first test of the process installs it.
    let _ = tracing_subscriber::registry().with(all).with(layer).try_init();
}
