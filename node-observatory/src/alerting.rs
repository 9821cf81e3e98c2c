//! The alerts of all nodes of this telescope, merged into one list, with what people did about them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use bus::{Catch, MachineTime};
use contract::node::NodeState;
use contract::observatory::{AlertKind, Alerts};
use contract::{BootId, Key, Name, NodeTopic, Part, Role, Topic};
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

/// Nodes of one telescope whose alerts are merged, and alerts of each: what is more comes from no node of ours, and all
/// that is merged has to fit into one message.
const MOST_NODES: usize = 64;
const MOST_ALERTS_OF_NODE: usize = 100;

/// Starts the tasks about alerts.
pub fn start(tasks: &mut Tasks, authority: &Arc<Authority>, orders: &OrderState) {
    let annunciator = &orders.annunciator;
    let (node, hold) = (&authority.node, authority.hold.clone());
    let writing = annunciator.clone().keep_on_disk(node.alerts.clone(), hold, AlertKind::AlertsNotSaved, |_| {
        "what people did about alerts".to_owned()
    });
    tasks.spawn("alerts on disk", writing);
    // `None` while another node publishes for this telescope.
    let (merged, alerts) = watch::channel(None);
    tasks.spawn("alerts", keep_merging(authority.clone(), annunciator.clone(), merged));
    tasks.spawn("alerts out", notify::keep_sending(node.clone(), alerts));
    let pinging = authority.clone();
    let is_well = move || pinging.is_judging() && pinging.is_publishing();
    tasks.spawn("ping", notify::keep_pinging(node.clone(), is_well));
    tasks.spawn("silent nodes", notify::keep_noticing_silence(node.clone(), || true));
}

/// The lists of the other nodes. Silence takes none back, only an end in good order: until a node that died is started again,
/// or a person acknowledges them, its last alerts stand. Pure: time comes in.
#[derive(Default)]
struct OtherLists {
    lists: BTreeMap<(Role, Name), (Alerts, MachineTime, BootId)>,
    /// Incarnations that ended in good order: a list of one of these is older than its end.
    ended: BTreeMap<(Role, Name), BootId>,
}

impl OtherLists {
    fn take(&mut self, who: (Role, Name), boot_id: &BootId, mut list: Alerts, arrived: MachineTime) {
        let has_room = self.lists.len() < MOST_NODES || self.lists.contains_key(&who);
        if has_room && self.ended.get(&who) != Some(boot_id) {
            list.alerts.truncate(MOST_ALERTS_OF_NODE);
            self.lists.insert(who, (list, arrived, boot_id.clone()));
        }
    }

    fn observe(&mut self, who: (Role, Name), boot_id: &BootId, state: &NodeState) {
        if state.ended_well() && (self.ended.len() < MOST_NODES || self.ended.contains_key(&who)) {
            // A start after it may have published already.
            if self.lists.get(&who).is_some_and(|(_, _, of)| of == boot_id) {
                self.lists.remove(&who);
            }
            self.ended.insert(who, boot_id.clone());
        }
    }

    /// The lists that stand, without what a person has acknowledged of those of silent nodes.
    fn stand(&mut self, known: &Annunciator, now: MachineTime) -> impl Iterator<Item = Alerts> {
        for (alerts, ..) in self.lists.values_mut().filter(|(_, arrived, _)| now.since(*arrived) > SILENCE) {
            known.stand_on(alerts);
        }
        self.lists.values().map(|(alerts, ..)| alerts.clone())
    }
}

/// Publishes the merged alerts at each change and every 10 s.
async fn keep_merging(
    authority: Arc<Authority>,
    annunciator: Arc<Persisted<Annunciator>>,
    merged: watch::Sender<Option<Alerts>>,
) -> anyhow::Result<()> {
    let address = authority.node.config.address();
    let of_nodes = |topic| Topic::Node(topic).at(&address);
    let others = authority.node.bus.subscribe::<Alerts>(of_nodes(NodeTopic::Alerts), Catch::Newest, 256).await?;
    let states = authority.node.bus.subscribe::<NodeState>(of_nodes(NodeTopic::State), Catch::Newest, 256).await?;
    let line = authority.node.bus.publisher::<Alerts>(&authority.key(Part::Alerts)).await?;
    let clock = authority.node.bus.clock().clone();
    let mut own = authority.node.alerts.watch();
    let mut orders = annunciator.subscribe();
    let mut received = OtherLists::default();
    let mut published: Option<(Alerts, MachineTime)> = None;
    let mut speaks_since: Option<MachineTime> = None;
    loop {
        let now = clock.machine();
        let nodes = std::iter::once(own.borrow_and_update().clone());
        let active = contract::observatory::merge(nodes.chain(received.stand(&annunciator.get(), now)));
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
                {
                    received.take((role, id), &alerts.sample.boot_id, alerts.sample.body, alerts.arrived);
                }
            }
            state = states.recv() => {
                if let Key::Node(_, role, id, NodeTopic::State) = state.key {
                    received.observe((role, id), &state.sample.boot_id, &state.sample.body);
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

#[cfg(test)]
mod tests {
    use contract::node::Stopped;

    use super::*;

    fn state(stopped: Option<Option<bool>>) -> NodeState {
        let role = Role::Device;
        let stopped = stopped.map(|closed| Stopped { by: "a signal on pc".to_owned(), closed });
        let (version, host, figures) = Default::default();
        NodeState { role, version, host, pid: 1, uptime_s: 1.0, speed: 1.0, figures, stopped }
    }

    #[test]
    fn the_alerts_of_a_node_end_with_its_end_in_good_order_and_not_with_its_silence() {
        let at = |second| MachineTime::from_boot(Duration::from_secs(second));
        let guest = || (Role::Device, "guest".parse::<Name>().unwrap());
        let boot_id = |text: &str| serde_json::from_value::<BootId>(text.into()).unwrap();
        let list = || {
            let alerts = vec![AlertKind::DomeNotClosed.alert("dome", Utc::EPOCH, "c")];
            Alerts { alerts, ..Alerts::default() }
        };
        for (last, stands) in [(None, 1), (Some(None), 0), (Some(Some(true)), 0), (Some(Some(false)), 1)] {
            let (first, second) = (boot_id("first"), boot_id("second"));
            let mut lists = OtherLists::default();
            let count = |lists: &mut OtherLists, second| {
                lists.stand(&Annunciator::default(), at(second)).map(|list| list.alerts.len()).sum::<usize>()
            };
            lists.take(guest(), &first, list(), at(100));
            assert_eq!(count(&mut lists, 101), 1);
            lists.observe(guest(), &first, &state(last));
            assert_eq!(count(&mut lists, 9000), stands, "{last:?}");
            lists.take(guest(), &first, list(), at(101));
            assert_eq!(count(&mut lists, 9000), stands, "{last:?}: what it sent before its end arrives after it");
            lists.take(guest(), &second, list(), at(9000));
            assert_eq!(count(&mut lists, 9001), 1, "{last:?}: it was started again");
            lists.observe(guest(), &first, &state(last));
            assert_eq!(count(&mut lists, 9001), 1, "{last:?}: the end of its start before arrives late");
        }
    }
}
