//! The alerts of all nodes of this telescope, merged into one list, with what people did about them.

use std::collections::{BTreeMap, BTreeSet};
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

/// The alerts that a node published.
fn of(list: &Alerts, node: &str) -> Alerts {
    let mut list = list.clone();
    for alert in &mut list.alerts {
        (alert.node, alert.missed_since_utc) = (Some(node.to_owned()), None);
    }
    list
}

/// The lists of the other nodes. Silence takes none back, only an end in good order: until a node that died is started
/// again, its last alerts stand. Pure: time comes in.
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
            let list = of(&list, &contract::node::name(who.0, &who.1));
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

    /// The lists that stand.
    fn stand(&mut self, known: &Annunciator, (now, utc): (MachineTime, Utc)) -> impl Iterator<Item = Alerts> {
        for (alerts, ..) in self.lists.values_mut().filter(|(_, arrived, _)| now.since(*arrived) > SILENCE) {
            known.stand_on(alerts, utc);
        }
        self.lists.values().map(|(alerts, ..)| alerts.clone())
    }

    /// The nodes from which something was received.
    fn heard(&self) -> impl Iterator<Item = String> {
        self.lists.keys().chain(self.ended.keys()).map(|(role, id)| contract::node::name(*role, id))
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
    let name = contract::node::name(authority.node.role, &authority.node.id);
    loop {
        let (now, utc) = (clock.machine(), clock.utc());
        let nodes = std::iter::once(of(&own.borrow_and_update(), &name));
        let active = contract::observatory::merge(nodes.chain(received.stand(&annunciator.get(), (now, utc))));
        if authority.is_publishing() {
            let began = *speaks_since.get_or_insert(now);
            let _ = orders.borrow_and_update();
            let is_settled = now.since(began) > SILENCE;
            let heard: Option<BTreeSet<String>> = is_settled.then(|| received.heard().chain([name.clone()]).collect());
            let all = observe(&annunciator, &merged, &active, (heard.as_ref(), utc));
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

/// Takes the active alerts, and returns the ones to publish. `heard` as in [`Annunciator::observe`].
fn observe(
    annunciator: &Persisted<Annunciator>,
    merged: &watch::Sender<Option<Alerts>>,
    active: &Alerts,
    (heard, utc): (Option<&BTreeSet<String>>, Utc),
) -> Alerts {
    annunciator.change(|known| {
        let was = known.clone();
        known.observe(active, heard, utc);
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
    use contract::observatory::Alert;
    use safety::ordered_by::OrderedBy;

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
                let now = (at(second), Utc::EPOCH);
                lists.stand(&Annunciator::default(), now).map(|list| list.alerts.len()).sum::<usize>()
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

    #[test]
    fn a_person_ends_the_message_about_a_node_that_died_and_no_restart_of_this_one_brings_it_back() {
        let at = |second| MachineTime::from_boot(Duration::from_secs(second));
        let utc = |second: u32| Utc::from_seconds(f64::from(second));
        let x = || (Role::Device, "x".parse::<Name>().unwrap());
        let boot_id = serde_json::from_value::<BootId>("first".into()).unwrap();
        let alerts = vec![AlertKind::DomeNotClosed.alert("dome", utc(0), "c")];
        let mut lists = OtherLists::default();
        lists.take(x(), &boot_id, Alerts { alerts, ..Alerts::default() }, at(0));
        let mut known = Annunciator::default();
        let look = |known: &mut Annunciator, lists: &mut OtherLists, second: u32, is_settled: bool| {
            let now = (at(u64::from(second)), utc(second));
            let active = contract::observatory::merge(lists.stand(known, now));
            let heard: BTreeSet<String> = lists.heard().collect();
            known.observe(&active, is_settled.then_some(&heard), now.1);
            let words = |alert: Alert| (alert.node, alert.acknowledged_by, alert.missed_since_utc);
            known.published(now.1).alerts.into_iter().map(words).collect::<Vec<_>>()
        };
        let (node, by) = (Some("device/x".to_owned()), Some("web/ana".to_owned()));
        assert_eq!(look(&mut known, &mut lists, 60, true), [(node.clone(), None, None)]);
        let ordered_by = OrderedBy { from: "web/ana".to_owned(), reason: "known".to_owned(), at_utc: utc(60) };
        known.acknowledge("dome-not-closed/dome", &ordered_by).unwrap();
        let answered = [(node, by, Some(utc(61)))];
        assert_eq!(look(&mut known, &mut lists, 61, true), answered, "it is silent");

        let mut lists = OtherLists::default();
        let text = serde_json::to_vec(&known).unwrap();
        let mut known = serde_json::from_slice::<Annunciator>(&text).unwrap().of_the_boot_before();
        for (second, is_settled) in [(70, false), (131, true), (9000, true)] {
            assert_eq!(look(&mut known, &mut lists, second, is_settled), answered, "{second} s: after the restart");
        }
        lists.take(x(), &boot_id, Alerts::default(), at(9001));
        assert!(look(&mut known, &mut lists, 9001, true).is_empty(), "its node says that it is over");
    }
}
