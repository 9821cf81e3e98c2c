//! The alerts of all nodes of this telescope, merged into one list, with what people did about them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use bus::{Catch, MachineTime};
use contract::node::NodeState;
use contract::observatory::{AlertKind, Alerts};
use contract::{Key, Name, NodeTopic, Part, Role, Topic};
use node::Node;
use safety::annunciator::Annunciator;
use tokio::sync::watch;
use units::Utc;

use crate::active_orders::OrderState;
use crate::authority::Authority;
use crate::persisted::Persisted;
use crate::tasks::Tasks;

/// Each node publishes its alerts every 10 s; a node that is silent for longer than this is away. For as long after
/// this node began to publish, it takes nothing for gone: by then it has received from every node that is there.
const SILENCE: Duration = Duration::from_secs(60);
/// A node publishes its state every 5 s; the on-delay of the alert is added to this.
const LOST: Duration = Duration::from_secs(15);

/// Nodes of one telescope whose alerts are merged, and alerts of each: what is more comes from no node of ours, and all
/// that is merged has to fit into one message.
const MOST_NODES: usize = 64;
const MOST_ALERTS_OF_NODE: usize = 100;

/// Starts the tasks about alerts.
pub fn start(tasks: &mut Tasks, authority: &Arc<Authority>, orders: &OrderState) {
    let annunciator = &orders.annunciator;
    let (node, hold) = (&authority.node, authority.hold.clone());
    let (kind, what) = (AlertKind::AlertsNotSaved, "what people did about alerts");
    tasks.spawn("alerts on disk", annunciator.clone().keep_on_disk(node.alerts.clone(), hold, kind, what));
    // `None` while another node publishes for this telescope.
    let (merged, alerts) = watch::channel(None);
    tasks.spawn("alerts", keep_merging(authority.clone(), annunciator.clone(), merged));
    tasks.spawn("alerts out", notify::keep_sending(node.clone(), alerts));
    let pinging = authority.clone();
    let is_well = move || pinging.is_judging() && pinging.is_publishing();
    tasks.spawn("ping", notify::keep_pinging(node.clone(), is_well));
    tasks.spawn("silent nodes", keep_noticing_silence(node.clone()));
}

/// Publishes the merged alerts at each change and every 10 s.
async fn keep_merging(
    authority: Arc<Authority>,
    annunciator: Arc<Persisted<Annunciator>>,
    merged: watch::Sender<Option<Alerts>>,
) -> anyhow::Result<()> {
    let address = authority.node.config.address();
    let expression = Topic::Node(NodeTopic::Alerts).at(&address);
    let others = authority.node.bus.subscribe::<Alerts>(expression, Catch::Newest, 256).await?;
    let line = authority.node.bus.publisher::<Alerts>(&authority.key(Part::Alerts)).await?;
    let clock = authority.node.bus.clock().clone();
    let mut own = authority.node.alerts.watch();
    let mut orders = annunciator.subscribe();
    let mut received: BTreeMap<(Role, Name), (Alerts, MachineTime)> = BTreeMap::new();
    let mut published: Option<(Alerts, MachineTime)> = None;
    let mut speaks_since: Option<MachineTime> = None;
    loop {
        let now = clock.machine();
        let known = annunciator.get();
        for (alerts, _) in received.values_mut().filter(|(_, arrived)| now.since(*arrived) > SILENCE) {
            known.stand_on(alerts);
        }
        let nodes = std::iter::once(own.borrow_and_update().clone());
        let active = contract::observatory::merge(nodes.chain(received.values().map(|(alerts, _)| alerts.clone())));
        if authority.is_publishing() {
            let began = *speaks_since.get_or_insert(now);
            let _ = orders.borrow_and_update();
            let all = observe(&annunciator, &merged, &active, (now.since(began) > SILENCE, clock.utc()));
            if published.as_ref().is_none_or(|(was, at)| *was != all || now.since(*at) >= Duration::from_secs(10)) {
                line.put(all.clone()).await?;
                published = Some((all, now));
            }
        } else {
            speaks_since = None;
            merged.send_if_modified(|merged| merged.take().is_some());
        }
        tokio::select! {
            alerts = others.recv() => {
                if let Key::Node(_, role, id, NodeTopic::Alerts) = alerts.key
                    && (role, &id) != (authority.node.role, &authority.node.id)
                    && (received.len() < MOST_NODES || received.contains_key(&(role, id.clone())))
                {
                    let mut list = alerts.sample.body;
                    list.alerts.truncate(MOST_ALERTS_OF_NODE);
                    received.insert((role, id), (list, alerts.arrived));
                }
            }
            changed = own.changed() => changed?,
            changed = orders.changed() => changed?,
            () = tokio::time::sleep(Duration::from_secs(1)) => {}
        }
    }
}

/// Takes the active alerts, and returns the ones to publish.
fn observe(
    annunciator: &Persisted<Annunciator>,
    merged: &watch::Sender<Option<Alerts>>,
    active: &Alerts,
    (settled, utc): (bool, Utc),
) -> Alerts {
    annunciator.change(|known| {
        let was = known.clone();
        known.observe(active, settled, utc);
        *known != was
    });
    let all = annunciator.get().published(utc);
    merged.send_if_modified(|published| {
        let is_new = published.as_ref() != Some(&all);
        *published = Some(all.clone());
        is_new
    });
    all
}

/// Raises an alert for each node of this telescope that has published and is silent now.
async fn keep_noticing_silence(node: Node) -> anyhow::Result<()> {
    let address = node.config.address();
    let expression = Topic::Node(NodeTopic::State).at(&address);
    let states = node.bus.subscribe::<NodeState>(expression, Catch::Newest, 256).await?;
    let clock = node.bus.clock().clone();
    let mut nodes = OtherNodes::default();
    loop {
        if let Ok(state) = tokio::time::timeout(Duration::from_secs(1), states.recv()).await
            && let Key::Node(_, role, id, NodeTopic::State) = state.key
            && (role, &id) != (node.role, &node.id)
        {
            node.alerts.clear(AlertKind::NodeSilent, format_args!("{role}/{id}"));
            nodes.take(role, id, &state.sample.body, state.arrived);
        }
        for (role, id, host) in nodes.silent(clock.machine()) {
            let cause = format!("the {role} node {id} on host \"{host}\" has fallen silent");
            node.alerts.raise(AlertKind::NodeSilent, format_args!("{role}/{id}"), &cause);
        }
    }
}

/// The other nodes of a telescope that have published, with their hosts. Pure: time comes in.
#[derive(Default)]
struct OtherNodes(BTreeMap<(Role, Name), (String, MachineTime)>);

impl OtherNodes {
    fn take(&mut self, role: Role, id: Name, state: &NodeState, arrived: MachineTime) {
        if state.ended_well() {
            // It has reported that it will be silent.
            self.0.remove(&(role, id));
        } else if self.0.len() < MOST_NODES || self.0.contains_key(&(role, id.clone())) {
            self.0.insert((role, id), (state.host.clone(), arrived));
        }
    }

    /// Those that have been silent for too long.
    fn silent(&self, now: MachineTime) -> impl Iterator<Item = (Role, &Name, &str)> {
        let is_silent = move |arrived: MachineTime| now.since(arrived) > LOST;
        let each = self.0.iter().filter(move |(_, (_, arrived))| is_silent(*arrived));
        each.map(|((role, id), (host, _))| (*role, id, host.as_str()))
    }
}

#[cfg(test)]
mod tests {
    use contract::node::Stopped;

    use super::*;

    #[test]
    fn a_node_that_ended_in_good_order_is_not_silent_and_one_that_left_a_dome_open_is() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let state = |stopped: Option<Option<bool>>| NodeState {
            role: Role::Device,
            version: String::new(),
            host: "dome-pc".to_owned(),
            pid: 1,
            uptime_s: 1.0,
            speed: 1.0,
            figures: BTreeMap::new(),
            stopped: stopped.map(|closed| Stopped { by: "starmesh up on dome-pc".to_owned(), closed }),
        };
        for (last, is_silent) in
            [(None, true), (Some(None), false), (Some(Some(true)), false), (Some(Some(false)), true)]
        {
            let mut nodes = OtherNodes::default();
            nodes.take(Role::Device, "enclosure".parse().unwrap(), &state(None), at(100));
            nodes.take(Role::Device, "enclosure".parse().unwrap(), &state(last), at(105));
            assert_eq!(nodes.silent(at(119)).count(), 0, "{last:?}: too soon");
            let silent: Vec<_> = nodes.silent(at(121)).map(|(role, id, host)| format!("{role}/{id} {host}")).collect();
            assert_eq!(silent, if is_silent { vec!["device/enclosure dome-pc"] } else { Vec::new() }, "{last:?}");
            nodes.take(Role::Device, "enclosure".parse().unwrap(), &state(None), at(130));
            assert_eq!(nodes.silent(at(146)).count(), 1, "{last:?}: it runs again, and falls silent then");
        }
    }
}
