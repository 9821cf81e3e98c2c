//! Sends in the place of an observatory node that fell silent.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use bus::{Catch, MachineTime, Received};
use contract::node::NodeState;
use contract::observatory::{AlertKind, Alerts, merge};
use contract::{Key, Name, NodeTopic, Part, Role, Scalar, Topic};
use node::Node;
use tokio::sync::watch;
use units::Utc;

use crate::sending::keep_sending;

/// Alerts are published every 10 s; a node that is silent for longer than this no longer sends.
const SILENCE: Duration = Duration::from_secs(60);

/// The observatory node that returns must receive the alert that it was missed, so that it can report the end to
/// people.
const HOLD: Duration = Duration::from_secs(30);
/// A node publishes its state every 5 s.
const LOST: Duration = Duration::from_secs(15);
/// The field in this node's state that shows others that it stands in.
const FIGURE: &str = "stands_in_after_s";

/// Sends in its place while it is silent, for ever; does nothing where the configuration gives this task to another
/// role.
///
/// Events that the silent node has sent are not sent again, and the node that returns receives the report of what this
/// one sent. Of several nodes that stand in, the one with the first name sends.
///
/// # Errors
///
/// The bus cannot be listened to.
pub async fn keep_substituting(node: Node) -> anyhow::Result<()> {
    let alerting = &node.config.alerts;
    let Some(timeout_s) = alerting.send_when_observatory_silent_s.filter(|_| alerting.stand_in == node.role) else {
        return std::future::pending().await;
    };
    node.figure(FIGURE, Scalar::Float(timeout_s));
    let (shown, alerts) = watch::channel(None);
    tokio::select! {
        result = keep_sending(node.clone(), alerts) => result,
        result = keep_watching(&node, Duration::from_secs_f64(timeout_s), &shown) => result,
    }
}

/// Others of this role that stand in, and send before this one.
struct Elders {
    states: bus::Subscriber<NodeState>,
    received: BTreeMap<Name, MachineTime>,
}

impl Elders {
    async fn listen(node: &Node) -> anyhow::Result<Self> {
        let (address, role) = (node.config.address(), node.role);
        let keys = Topic::Node(NodeTopic::State).at(&address).of_role(role);
        Ok(Self { states: node.bus.subscribe(keys, Catch::Newest, 64).await?, received: BTreeMap::new() })
    }

    fn observe(&mut self, node: &Node, state: Received<NodeState>) {
        if let Key::Node(_, _, id, NodeTopic::State) = state.key
            && id < node.id
            && state.sample.body.figures.contains_key(FIGURE)
        {
            self.received.insert(id, state.arrived);
        }
    }

    fn are_there(&mut self, now: MachineTime) -> bool {
        self.received.retain(|_, arrived| now.since(*arrived) <= LOST);
        !self.received.is_empty()
    }
}

/// Nodes of one telescope; more are the invention of a faulty program.
const MOST_NODES: usize = 64;

async fn keep_watching(node: &Node, timeout: Duration, shown: &watch::Sender<Option<Alerts>>) -> anyhow::Result<()> {
    let address = node.config.address();
    let merged = node.bus.latest::<Alerts>(&Key::Observatory(address.clone(), Part::Alerts)).await?;
    let nodes = node.bus.subscribe::<Alerts>(Topic::Node(NodeTopic::Alerts).at(&address), Catch::Newest, 256).await?;
    let mut elders = Elders::listen(node).await?;
    let clock = node.bus.clock().clone();
    let mut last_silent: Option<MachineTime> = None;
    let began = clock.machine();
    let mut own = node.alerts.watch();
    let mut received: BTreeMap<(Role, Name), (Alerts, MachineTime)> = BTreeMap::new();
    let instance = format!("{}/{}", Role::Observatory, address.telescope);
    loop {
        let now = clock.machine();
        let is_silent = merged.fresh(timeout).is_none() && now.since(began) >= timeout;
        if is_silent {
            let cause = format!("no observatory node of {address} has published for {} s", timeout.as_secs());
            node.alerts.raise(AlertKind::NodeSilent, &instance, &cause);
            last_silent = Some(now);
        } else if last_silent.is_none_or(|at| now.since(at) >= HOLD) {
            node.alerts.clear(AlertKind::NodeSilent, &instance);
        }
        received.retain(|_, (_, arrived)| now.since(*arrived) <= SILENCE);
        let lists = std::iter::once(own.borrow_and_update().clone());
        let active = merge(lists.chain(received.values().map(|(alerts, _)| alerts.clone())));
        let last = merged.get().map(|last| last.sample.body).unwrap_or_default();
        let all = in_its_place(active, last, clock.utc());
        let now_shown = (is_silent && !elders.are_there(now)).then_some(all);
        shown.send_if_modified(|shown| {
            let is_new = *shown != now_shown;
            *shown = now_shown;
            is_new
        });
        tokio::select! {
            alerts = nodes.recv() => {
                if let Key::Node(_, role, id, NodeTopic::Alerts) = alerts.key
                    && (role, &id) != (node.role, &node.id)
                    && (received.len() < MOST_NODES || received.contains_key(&(role, id.clone())))
                {
                    received.insert((role, id), (alerts.sample.body, alerts.arrived));
                }
            }
            state = elders.states.recv() => elders.observe(node, state),
            changed = own.changed() => changed?,
            () = tokio::time::sleep(Duration::from_secs(1)) => {}
        }
    }
}

/// The alerts that the silent node would publish: those of the other nodes now, and its own last ones, which nobody has
/// cleared; acknowledgements and shelving hold too.
fn in_its_place(active: Alerts, last: Alerts, now: Utc) -> Alerts {
    let stands: BTreeSet<String> = active.alerts.iter().map(|alert| alert.id.clone()).collect();
    let mut all = merge([active, last.clone()].into_iter());
    for alert in &mut all.alerts {
        if let Some(known) = last.alerts.iter().find(|known| known.id == alert.id) {
            *alert = known.clone();
        }
        if stands.contains(&alert.id) {
            alert.returned_utc = None;
        }
        if alert.shelved_until_utc.is_some_and(|until| until <= now) {
            (alert.shelved_by, alert.shelved_until_utc, alert.shelved_reason) = (None, None, None);
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use contract::observatory::Alert;

    use super::*;

    #[test]
    fn what_the_silent_node_published_last_holds_until_others_publish_otherwise() {
        let at = Utc::from_seconds;
        let alert = |name: &str| AlertKind::DomeHeld.alert(name, at(1.0), "c");
        let list = |alerts: Vec<Alert>| Alerts { alerts, notifications: Vec::new() };
        let shelved = |until_s| Alert { shelved_until_utc: Some(at(until_s)), ..alert("x") };
        let known = Alert { acknowledged_by: Some("ana".to_owned()), ..alert("x") };
        let gone = Alert { returned_utc: Some(at(2.0)), ..alert("x") };
        let scenarios = [
            ("it alone knew", vec![], alert("x"), alert("x")),
            ("others know it too", vec![alert("x")], alert("x"), alert("x")),
            ("somebody sees to it", vec![alert("x")], known.clone(), known),
            ("it was over", vec![], gone.clone(), gone.clone()),
            ("it was over and is back", vec![alert("x")], gone, alert("x")),
            ("it lies on the shelf", vec![alert("x")], shelved(11.0), shelved(11.0)),
            ("the shelf has ended", vec![alert("x")], shelved(10.0), alert("x")),
        ];
        for (name, active, last, wanted) in scenarios {
            let all = in_its_place(list(active), list(vec![last]), at(10.0));
            assert_eq!(all, list(vec![wanted]), "{name}");
        }
        let both = in_its_place(list(vec![alert("y")]), list(vec![alert("x")]), at(10.0));
        assert_eq!(both, list(vec![alert("x"), alert("y")]), "what only others know is added");
    }
}
