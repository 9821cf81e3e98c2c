//! The alerts of all nodes of this telescope, merged into one list, with what people did about them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use bus::{Catch, MachineTime};
use contract::observatory::{AlertKind, Alerts};
use contract::{Key, Name, NodeTopic, Part, Role, Topic};
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
    let (kind, what) = (AlertKind::AlertsNotSaved, "what people did about alerts");
    tasks.spawn("alerts on disk", annunciator.clone().keep_on_disk(node.alerts.clone(), hold, kind, what));
    // `None` while another node publishes for this telescope.
    let (merged, alerts) = watch::channel(None);
    tasks.spawn("alerts", keep_merging(authority.clone(), annunciator.clone(), merged));
    tasks.spawn("alerts out", notify::keep_sending(node.clone(), alerts));
    let pinging = authority.clone();
    let is_well = move || pinging.is_judging() && pinging.is_publishing();
    tasks.spawn("ping", notify::keep_pinging(node.clone(), is_well));
    tasks.spawn("silent nodes", notify::keep_noticing_silence(node.clone(), || true));
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
