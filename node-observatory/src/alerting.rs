//! The alerts of all nodes of this telescope, merged into one list.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use bus::{Catch, MachineTime, Quality};
use contract::observatory::{Alert, Alerts};
use contract::{Key, Name, NodeTopic, Part, Role};

use crate::control_room::ControlRoom;

/// Alerts are said every 10 s; a node that is silent for longer than this has no say any more.
const SILENCE: Duration = Duration::from_secs(60);

/// Publishes the merged alerts at each change and every 10 s.
pub async fn keep_merging(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let address = room.node.config.address();
    let expression = format!("{}/{address}/node/*/*/{}", contract::key::ROOT, NodeTopic::Alerts.word());
    let others = room.node.bus.subscribe::<Alerts>(&expression, Catch::Newest, 256).await?;
    let line = room.node.bus.publisher::<Alerts>(&room.key(Part::Alerts), Quality::State { cache: 1 }).await?;
    let clock = room.node.bus.clock().clone();
    let mut own = room.node.alerts.watch();
    let mut heard: BTreeMap<(Role, Name), (Alerts, MachineTime)> = BTreeMap::new();
    let mut said: Option<(Alerts, MachineTime)> = None;
    loop {
        let now = clock.machine();
        heard.retain(|_, (_, arrived)| now.since(*arrived) <= SILENCE);
        let all = merge(std::iter::once(own.borrow_and_update().clone()).chain(heard.values().map(|(a, _)| a.clone())));
        let due = said.as_ref().is_none_or(|(was, at)| *was != all || now.since(*at) >= Duration::from_secs(10));
        if due && room.may_speak() {
            line.put(all.clone()).await?;
            said = Some((all, now));
        }
        tokio::select! {
            alerts = others.hear() => {
                if let Key::Node(_, role, id, NodeTopic::Alerts) = alerts.key
                    && (role, &id) != (room.node.role, &room.node.id)
                {
                    heard.insert((role, id), (alerts.said.body, alerts.arrived));
                }
            }
            changed = own.changed() => changed?,
            () = tokio::time::sleep(Duration::from_secs(5)) => {}
        }
    }
}

/// One list, the most urgent first; of two with one id the more urgent, then the older.
fn merge(lists: impl Iterator<Item = Alerts>) -> Alerts {
    let mut all: Vec<Alert> = lists.flat_map(|list| list.alerts).collect();
    all.sort_by(|a, b| (a.priority, a.raised_utc, &a.id).cmp(&(b.priority, b.raised_utc, &b.id)));
    let mut seen = std::collections::BTreeSet::new();
    all.retain(|alert| seen.insert(alert.id.clone()));
    Alerts { alerts: all }
}

#[cfg(test)]
mod tests {
    use contract::observatory::Priority;

    use super::*;

    fn alert(id: &str, priority: Priority) -> Alert {
        let words = String::new();
        Alert {
            id: id.to_owned(),
            priority,
            raised_utc: units::Utc::EPOCH,
            cause: words.clone(),
            consequence: words.clone(),
            action: words,
        }
    }

    #[test]
    fn one_cause_is_one_alert_and_the_most_urgent_comes_first() {
        let ours = Alerts { alerts: vec![alert("a", Priority::Medium), alert("b", Priority::Critical)] };
        let theirs = Alerts { alerts: vec![alert("a", Priority::High)] };
        let merged = merge([ours, theirs].into_iter());
        let found: Vec<_> = merged.alerts.iter().map(|alert| (alert.id.as_str(), alert.priority)).collect();
        assert_eq!(found, [("b", Priority::Critical), ("a", Priority::High)]);
    }
}
