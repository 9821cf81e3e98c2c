//! The alerts of all nodes of this telescope, merged into one list, with what people did about them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use bus::{Catch, MachineTime, Quality};
use contract::node::NodeState;
use contract::observatory::{AlertKind, Alerts};
use contract::{Key, Name, NodeTopic, Part, Role};

use crate::control_room::ControlRoom;

/// Each node publishes its alerts every 10 s; a node that is silent for longer than this is away. For as long after
/// this node began to publish, it takes nothing for gone: by then it has received from every node that is there.
const SILENCE: Duration = Duration::from_secs(60);
/// A node publishes its state every 5 s; the on-delay of the alert is added to this.
const LOST: Duration = Duration::from_secs(15);

/// Nodes of one telescope whose alerts are merged, and alerts of each: what is more comes from no node of ours, and all
/// that is merged has to fit into one message.
const MOST_NODES: usize = 64;
const MOST_ALERTS_OF_NODE: usize = 100;

/// Publishes the merged alerts at each change and every 10 s.
pub async fn keep_merging(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let address = room.node.config.address();
    let expression = format!("{}/{address}/node/*/*/{}", contract::key::ROOT, NodeTopic::Alerts.word());
    let others = room.node.bus.subscribe::<Alerts>(&expression, Catch::Newest, 256).await?;
    let line = room.node.bus.publisher::<Alerts>(&room.key(Part::Alerts), Quality::State { cache: 1 }).await?;
    let clock = room.node.bus.clock().clone();
    let mut own = room.node.alerts.watch();
    let mut orders = room.annunciator.subscribe();
    let mut heard: BTreeMap<(Role, Name), (Alerts, MachineTime)> = BTreeMap::new();
    let mut said: Option<(Alerts, MachineTime)> = None;
    let mut speaks_since: Option<MachineTime> = None;
    loop {
        let now = clock.machine();
        let known = room.annunciator.get();
        for (alerts, _) in heard.values_mut().filter(|(_, arrived)| now.since(*arrived) > SILENCE) {
            known.stand_on(alerts);
        }
        let nodes = std::iter::once(own.borrow_and_update().clone());
        let standing = contract::observatory::merge(nodes.chain(heard.values().map(|(alerts, _)| alerts.clone())));
        if room.may_speak() {
            let began = *speaks_since.get_or_insert(now);
            let _ = orders.borrow_and_update();
            let all = hear(&room, &standing, now.since(began) > SILENCE);
            if said.as_ref().is_none_or(|(was, at)| *was != all || now.since(*at) >= Duration::from_secs(10)) {
                line.put(all.clone()).await?;
                said = Some((all, now));
            }
        } else {
            speaks_since = None;
            room.alerts.send_if_modified(|shown| shown.take().is_some());
        }
        tokio::select! {
            alerts = others.hear() => {
                if let Key::Node(_, role, id, NodeTopic::Alerts) = alerts.key
                    && (role, &id) != (room.node.role, &room.node.id)
                    && (heard.len() < MOST_NODES || heard.contains_key(&(role, id.clone())))
                {
                    let mut said = alerts.said.body;
                    said.alerts.truncate(MOST_ALERTS_OF_NODE);
                    heard.insert((role, id), (said, alerts.arrived));
                }
            }
            changed = own.changed() => changed?,
            changed = orders.changed() => changed?,
            () = tokio::time::sleep(Duration::from_secs(5)) => {}
        }
    }
}

/// Takes the active alerts, and returns the ones to publish.
fn hear(room: &ControlRoom, standing: &Alerts, settled: bool) -> Alerts {
    let utc = room.node.bus.clock().utc();
    room.annunciator.change(|known| {
        let was = known.clone();
        known.hear(standing, settled, utc);
        *known != was
    });
    let all = room.annunciator.get().shown(utc);
    room.alerts.send_if_modified(|shown| {
        let is_new = shown.as_ref() != Some(&all);
        *shown = Some(all.clone());
        is_new
    });
    all
}

/// Raises an alert for each node of this telescope that this node received from and receives from no more.
pub async fn keep_noticing_silence(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let address = room.node.config.address();
    let expression = format!("{}/{address}/node/*/*/{}", contract::key::ROOT, NodeTopic::State.word());
    let states = room.node.bus.subscribe::<NodeState>(&expression, Catch::Newest, 256).await?;
    let clock = room.node.bus.clock().clone();
    let mut heard: BTreeMap<(Role, Name), (String, MachineTime)> = BTreeMap::new();
    loop {
        if let Ok(state) = tokio::time::timeout(Duration::from_secs(1), states.hear()).await
            && let Key::Node(_, role, id, NodeTopic::State) = state.key
            && (role, &id) != (room.node.role, &room.node.id)
        {
            room.node.alerts.clear(AlertKind::NodeSilent, format_args!("{role}/{id}"));
            if heard.len() < MOST_NODES || heard.contains_key(&(role, id.clone())) {
                heard.insert((role, id), (state.said.body.host, state.arrived));
            }
        }
        let now = clock.machine();
        for ((role, id), (host, _)) in heard.iter().filter(|(_, (_, arrived))| now.since(*arrived) > LOST) {
            let cause = format!("the {role} node {id} on host \"{host}\" has fallen silent");
            room.node.alerts.raise(AlertKind::NodeSilent, format_args!("{role}/{id}"), &cause);
        }
    }
}
