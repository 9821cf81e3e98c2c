//! A person's operator orders ([`::safety::active_orders`]) as a file, and the alerts that remind
//! of them.
//!
//! The file is `operator-orders-TELESCOPE.json` in the data folder.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use contract::command::operator;
use contract::observatory::{AlertKind, OperatorOrders};
use node::{Node, StandingAlerts};
use safety::active_orders::ActiveOrders;
use safety::annunciator::Annunciator;
use safety::on_disk::OnDisk;
use safety::rules::Rules;
use tokio::sync::watch;

use crate::annunciator;
use crate::hold::Hold;
use crate::persisted::Persisted;
use crate::tasks::Tasks;

/// What people ordered of the verdict, and what they did about alerts.
pub struct OrderState {
    /// The orders.
    pub orders: Arc<Persisted<ActiveOrders>>,
    /// The orders as last published.
    pub published: watch::Sender<Option<OperatorOrders>>,
    /// What people did about alerts.
    pub annunciator: Arc<Persisted<Annunciator>>,
    /// The rules of the verdict, which orders change.
    pub rules: Arc<Rules>,
}

impl OrderState {
    /// Reads what was ordered before.
    pub async fn load(node: &Node) -> anyhow::Result<Self> {
        let now = node.bus.clock().utc();
        Ok(Self {
            orders: Persisted::load(path(&node.config), &node.id, move |path| read(path).orders(now)).await?,
            published: watch::channel(None).0,
            annunciator: Persisted::load(annunciator::path(&node.config), &node.id, annunciator::read).await?,
            rules: Arc::new(Rules::of(&node.config)),
        })
    }
}

/// Starts the tasks about what people ordered of the verdict.
pub fn start(tasks: &mut Tasks, node: &Node, hold: watch::Receiver<Hold>, orders: &OrderState) {
    let active_orders = orders.orders.clone();
    tasks.spawn("operator orders", keep_reminding(node.clone(), active_orders.clone()));
    let kind = AlertKind::OperatorOrders;
    tasks.spawn("operator orders on disk", active_orders.keep_on_disk(node.alerts.clone(), hold, kind, named));
}

/// The orders by their names, for the alert that they are not on disk.
fn named(orders: &ActiveOrders) -> String {
    let closed = orders.stay_closed.iter().map(|by| format!("stay-closed of {}", operator(&by.from)));
    let overrides = orders.overrides.iter();
    let overrides = overrides.map(|(input, by)| format!("override {input} of {}", operator(&by.ordered_by.from)));
    let all: Vec<String> = closed.chain(overrides).collect();
    let all = if all.is_empty() { "no stay-closed, no override".to_owned() } else { all.join(", ") };
    format!("what people ordered ({all})")
}

/// Reads the file; of one that cannot be read a copy is kept.
pub fn read(path: &Path) -> OnDisk {
    read_with(path, |why| node::aside::keep_copy(path, why, "The dome stays closed until a person decides anew."))
}

/// Reads the file, and leaves all as it is.
pub fn look(path: &Path) -> OnDisk {
    read_with(path, |_| {})
}

fn read_with(path: &Path, damaged: impl FnOnce(&str)) -> OnDisk {
    let unreadable = |why: String| {
        damaged(&why);
        OnDisk::Unreadable(format!("{} cannot be read: {why}", path.display()))
    };
    match std::fs::read(path) {
        Ok(bytes) => match serde_json::from_slice(&bytes) {
            Ok(orders) => OnDisk::Found(orders),
            Err(error) => unreadable(error.to_string()),
        },
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => OnDisk::Absent,
        Err(error) => unreadable(error.to_string()),
    }
}

/// The file of a telescope's operator orders.
pub fn path(config: &config::Observatory) -> PathBuf {
    config.folders.data.join(format!("operator-orders-{}.json", config.place.telescope))
}

/// Raises an alert for every operator order, so that none is forgotten.
async fn keep_reminding(node: Node, orders: Arc<Persisted<ActiveOrders>>) -> anyhow::Result<()> {
    let mut orders = orders.subscribe();
    let mut standing = StandingAlerts::default();
    loop {
        let reminders = orders.borrow_and_update().reminders(node.bus.clock().utc());
        standing.keep(reminders, &node.alerts);
        tokio::select! {
            changed = orders.changed() => changed?,
            () = tokio::time::sleep(Duration::from_secs(5)) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use safety::active_orders::Override;
    use safety::ordered_by::OrderedBy;
    use units::Utc;

    use super::*;

    #[test]
    fn orders_outlive_a_restart_and_a_broken_file_stays_closed() {
        let folder = tempfile::tempdir().unwrap();
        let (path, now) = (folder.path().join("operator-orders.json"), Utc::from_seconds(2000.0));
        assert_eq!(read(&path), OnDisk::Absent);
        assert_eq!(OnDisk::Absent.orders(now), ActiveOrders::default());
        let ordered_by = OrderedBy {
            from: "web/ana".to_owned(),
            reason: "people on the roof".to_owned(),
            at_utc: Utc::from_seconds(1000.0),
        };
        let order = Override { ordered_by: ordered_by.clone(), until_utc: Utc::from_seconds(1600.0) };
        let overrides = [("wx/Humidity".to_owned(), order)].into();
        let orders = ActiveOrders { stay_closed: Some(ordered_by), overrides, ..ActiveOrders::default() };
        crate::persisted::write_whole(&path, &folder.path().join("part"), &orders).unwrap();
        assert_eq!(read(&path), OnDisk::Found(orders));
        // What is cut, and what is another file.
        for other in [
            "{",
            "{}",
            "[]",
            "null",
            r#"{"device/main": {"words": "the device node main"}}"#,
            r#"{"overrides": {}, "nodes": 1}"#,
        ] {
            std::fs::write(&path, other).unwrap();
            assert!(read(&path).orders(now).stay_closed.is_some(), "{other}");
        }
        let names = std::fs::read_dir(folder.path()).unwrap().map(|file| file.unwrap().file_name());
        assert!(
            names
                .map(|name| name.to_string_lossy().into_owned())
                .any(|name| name.starts_with("operator-orders.json.bad-"))
        );
        assert!(path.exists(), "without it a restart would know of no order");
    }
}
