//! Sends in the place of an observatory node that fell silent.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use bus::{Catch, MachineTime};
use contract::node::NodeState;
use contract::observatory::{AlertKind, Alerts, merge};
use contract::{Address, Key, Name, NodeTopic, Part, Role, Scalar, Topic};
use node::Node;
use tokio::sync::watch;
use units::Utc;

use crate::push::Subscriptions;
use crate::sending::{keep_pushing, keep_sending};
use crate::silent_nodes::{LOST, keep_noticing_silence};

/// Alerts are published every 10 s; a node that is silent for longer than this is away.
const SILENCE: Duration = Duration::from_secs(60);

/// The observatory node that returns must receive the alert that it was missed, so that it can report the end to
/// people.
const HOLD: Duration = Duration::from_secs(30);
/// An observatory node that never published since this node began has so long to start, on a busy machine and with its first
/// look at the devices.
const START: Duration = Duration::from_secs(60);
/// The mailboxes of this node begin before the alert about the silence is raised: for alerts from before their time they wait
/// for what others have sent.
const FIRST_BEGIN: Duration = Duration::from_secs(1);
/// The field in this node's state that shows others that it stands in.
const FIGURE: &str = "stands_in_after_s";

/// Sends in its place while it is silent, for ever; does nothing where the configuration gives this task to nobody.
///
/// The last alerts of another node that falls silent meanwhile hold until it is back, and its silence is an alert, too.
/// Events that the silent node has sent are not sent again, and the node that returns receives the report of what this
/// one sent. Of several nodes that stand in, those of the configured role come first, then those of the other one, since what
/// ends the observatory node may end one role with it; of one role the node with the first name sends. Shared devices have no
/// observatory node: for them a node that stands in always sends.
///
/// The browsers that have subscribed at this node are known to it alone: it sends to them all the time, what the observatory node publishes, and
/// while that is silent what is published in its place.
///
/// # Errors
///
/// The bus cannot be listened to.
pub async fn keep_substituting(node: Node, subscriptions: Option<Arc<Subscriptions>>) -> anyhow::Result<()> {
    let timeout_s = node.config.alerts.send_when_observatory_silent_s;
    let stands_in = timeout_s > 0.0 && matches!(node.role, Role::Archive | Role::Web);
    if !stands_in && subscriptions.is_none() {
        return std::future::pending().await;
    }
    if stands_in {
        node.figure(FIGURE, Scalar::Float(timeout_s));
    }
    let (shown, alerts) = watch::channel(None);
    let (followed, pushed) = watch::channel(None);
    let (silent, is_silent) = watch::channel(false);
    let pushing = async {
        match subscriptions {
            Some(subscriptions) => keep_pushing(node.clone(), subscriptions, pushed).await,
            None => std::future::pending().await,
        }
    };
    let timeout = stands_in.then(|| Duration::from_secs_f64(timeout_s));
    tokio::select! {
        result = keep_sending(node.clone(), alerts) => result,
        result = pushing => result,
        result = keep_noticing_silence(node.clone(), || *is_silent.borrow()) => result,
        result = keep_watching(&node, timeout, &shown, &followed, &silent) => result,
    }
}

/// Whether the observatory nodes of a telescope send alerts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Presence {
    /// One does.
    Sends,
    /// None does, and that is no fault: they were stopped in good order, or the devices are shared and have none.
    Absent,
    /// None has published for too long.
    Silent,
}

/// What is known of the observatory nodes of a telescope. Pure: time comes in.
struct Observatories {
    /// They are silent after this; never where nobody stands in.
    timeout: Option<Duration>,
    began: MachineTime,
    /// When none sent last.
    last_away: Option<MachineTime>,
    /// Shared devices have none.
    is_shared: bool,
    /// Those that have published their state, and whether it was the last one of an end in good order.
    stopped: BTreeMap<Name, bool>,
}

impl Observatories {
    fn take(&mut self, id: Name, state: &NodeState) {
        if self.stopped.len() < MOST_NODES || self.stopped.contains_key(&id) {
            self.stopped.insert(id, state.ended_well());
        }
    }

    /// By the arrival of the newest alerts that one of them published.
    fn presence(&self, newest: Option<MachineTime>, now: MachineTime) -> Presence {
        let Some(timeout) = self.timeout else { return Presence::Sends };
        if self.is_shared || (!self.stopped.is_empty() && self.stopped.values().all(|is_stopped| *is_stopped)) {
            return Presence::Absent;
        }
        let is_silent = match newest {
            Some(arrived) => now.since(arrived) >= timeout,
            None => now.since(self.began) >= timeout.max(START),
        };
        if is_silent { Presence::Silent } else { Presence::Sends }
    }

    /// Has the one that sends received all that other nodes report? One that returns has to receive first what was raised meanwhile: to
    /// whoever follows at any time it would be over, and raised again.
    fn knows_all(&mut self, presence: Presence, now: MachineTime) -> bool {
        if presence != Presence::Sends {
            self.last_away = Some(now);
        }
        self.last_away.is_none_or(|at| now.since(at) >= HOLD)
    }
}

/// What the other nodes reported last. Pure: time comes in.
#[derive(Default)]
struct LastReports {
    lists: BTreeMap<(Role, Name), (Alerts, MachineTime)>,
    /// Those whose last state is that of an end in good order.
    ended_well: BTreeSet<(Role, Name)>,
}

impl LastReports {
    fn take(&mut self, who: (Role, Name), list: Alerts, arrived: MachineTime) {
        if self.lists.len() < MOST_NODES || self.lists.contains_key(&who) {
            self.lists.insert(who, (list, arrived));
        }
    }

    fn observe(&mut self, who: (Role, Name), state: &NodeState) {
        if !state.ended_well() {
            self.ended_well.remove(&who);
        } else if self.ended_well.len() < MOST_NODES {
            self.ended_well.insert(who);
        }
    }

    /// The alerts that hold. Silence takes nothing back: the shutter that a dead node could not close is still open. Only an end
    /// in good order does, and an observatory node that sends (`others_know`): what it holds active is in its own list.
    fn active(&mut self, others_know: bool, now: MachineTime) -> impl Iterator<Item = Alerts> {
        let is_over = |who: &(Role, Name)| others_know || self.ended_well.contains(who);
        self.lists.retain(|who, (_, arrived)| now.since(*arrived) <= SILENCE || !is_over(who));
        self.lists.values().map(|(list, _)| list.clone())
    }
}

/// Others that stand in, and send before this one.
#[derive(Default)]
struct Elders {
    received: BTreeMap<(Role, Name), MachineTime>,
}

/// Who sends first: nodes of the configured role, by their names, and then the others.
fn turn(first: Role, role: Role, id: &Name) -> (bool, &Name) {
    (role != first, id)
}

impl Elders {
    fn observe(&mut self, node: &Node, (role, id): (Role, Name), state: &NodeState, arrived: MachineTime) {
        let first = node.config.alerts.stand_in;
        let is_before = turn(first, role, &id) < turn(first, node.role, &node.id);
        if is_before && state.figures.contains_key(FIGURE) && state.stopped.is_none() {
            self.received.insert((role, id), arrived);
        } else {
            self.received.remove(&(role, id));
        }
    }

    fn are_there(&mut self, now: MachineTime) -> bool {
        self.received.retain(|_, arrived| now.since(*arrived) <= LOST);
        !self.received.is_empty()
    }
}

/// Nodes of one telescope; more are the invention of a faulty program.
const MOST_NODES: usize = 64;

/// `shown` are the alerts while this node sends them; `followed` at any time. `silent` while the observatory nodes are.
async fn keep_watching(
    node: &Node,
    timeout: Option<Duration>,
    shown: &watch::Sender<Option<Alerts>>,
    followed: &watch::Sender<Option<Alerts>>,
    silent: &watch::Sender<bool>,
) -> anyhow::Result<()> {
    let address = node.config.address();
    let merged = node.bus.latest::<Alerts>(&Key::Observatory(address.clone(), Part::Alerts)).await?;
    let nodes = node.bus.subscribe::<Alerts>(Topic::Node(NodeTopic::Alerts).at(&address), Catch::Newest, 256).await?;
    let states =
        node.bus.subscribe::<NodeState>(Topic::Node(NodeTopic::State).at(&address), Catch::Newest, 256).await?;
    let (mut elders, mut reports) = (Elders::default(), LastReports::default());
    let clock = node.bus.clock().clone();
    let mut last_silent: Option<MachineTime> = None;
    let mut silent_since: Option<MachineTime> = None;
    let mut observatories = Observatories {
        timeout,
        began: clock.machine(),
        last_away: None,
        is_shared: address.telescope.as_str() == Address::SHARED,
        stopped: BTreeMap::new(),
    };
    let mut own = node.alerts.watch();
    let instance = format!("{}/{}", Role::Observatory, address.telescope);
    loop {
        let now = clock.machine();
        let presence = observatories.presence(merged.get().map(|newest| newest.arrived), now);
        let others_know = observatories.knows_all(presence, now);
        silent.send_replace(presence == Presence::Silent);
        if presence == Presence::Silent {
            if now.since(*silent_since.get_or_insert(now)) >= FIRST_BEGIN {
                let cause = format!(
                    "no observatory node of {address} has published for {} s",
                    timeout.unwrap_or_default().as_secs()
                );
                // The time of the silence was its delay.
                node.alerts.raise_at_once(AlertKind::NodeSilent, &instance, &cause);
                last_silent = Some(now);
            }
        } else {
            silent_since = None;
        }
        if presence != Presence::Silent && last_silent.is_none_or(|at| now.since(at) >= HOLD) {
            node.alerts.clear(AlertKind::NodeSilent, &instance);
        }
        let lists = std::iter::once(own.borrow_and_update().clone());
        let active = merge(lists.chain(reports.active(others_know, now)));
        let last = merged.get().map(|last| last.sample.body);
        let in_its_place = in_its_place(active, last.clone().unwrap_or_default(), clock.utc());
        let others_send = presence == Presence::Sends || elders.are_there(now);
        show(followed, if others_know { last } else { Some(in_its_place.clone()) });
        show(shown, (!others_send).then_some(in_its_place));
        tokio::select! {
            alerts = nodes.recv() => {
                if let Key::Node(_, role, id, NodeTopic::Alerts) = alerts.key
                    && (role, &id) != (node.role, &node.id)
                {
                    reports.take((role, id), alerts.sample.body, alerts.arrived);
                }
            }
            state = states.recv() => {
                if let Key::Node(_, role, id, NodeTopic::State) = state.key {
                    let body = &state.sample.body;
                    if role == Role::Observatory {
                        observatories.take(id.clone(), body);
                    }
                    reports.observe((role, id.clone()), body);
                    elders.observe(node, (role, id), body, state.arrived);
                }
            }
            changed = own.changed() => changed?,
            () = tokio::time::sleep(Duration::from_secs(1)) => {}
        }
    }
}

fn show(to: &watch::Sender<Option<Alerts>>, now: Option<Alerts>) {
    to.send_if_modified(|shown| {
        let is_new = *shown != now;
        *shown = now;
        is_new
    });
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
    use contract::node::Stopped;
    use contract::observatory::Alert;

    use super::*;

    fn state(stopped: Option<bool>) -> NodeState {
        NodeState {
            role: Role::Observatory,
            version: String::new(),
            host: String::new(),
            pid: 1,
            uptime_s: 1.0,
            speed: 1.0,
            figures: BTreeMap::new(),
            stopped: stopped.map(|closed| Stopped { by: String::new(), closed: Some(closed) }),
        }
    }

    #[test]
    fn a_silent_observatory_node_is_noticed_and_one_that_was_stopped_is_no_fault_while_another_node_sends_at_once() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let of = |is_shared, states: &[(&str, Option<bool>)]| {
            let timeout = Some(Duration::from_secs(20));
            let mut known =
                Observatories { timeout, began: at(0), last_away: None, is_shared, stopped: BTreeMap::new() };
            states.iter().for_each(|(id, stopped)| known.take(id.parse().unwrap(), &state(*stopped)));
            known
        };
        let main = [("main", None)];
        for (name, known, newest_s, now_s, wanted) in [
            ("it sends", of(false, &main), Some(100), 119, Presence::Sends),
            ("it is silent", of(false, &main), Some(100), 120, Presence::Silent),
            ("nobody has begun yet", of(false, &[]), None, 59, Presence::Sends),
            ("nobody ever began", of(false, &[]), None, 60, Presence::Silent),
            ("it was stopped", of(false, &[("main", Some(true))]), Some(100), 101, Presence::Absent),
            ("it has been stopped for long", of(false, &[("main", Some(true))]), Some(100), 9000, Presence::Absent),
            ("it left a dome open", of(false, &[("main", Some(false))]), Some(100), 120, Presence::Silent),
            (
                "the standby goes on",
                of(false, &[("main", Some(true)), ("second", None)]),
                Some(100),
                110,
                Presence::Sends,
            ),
            (
                "it was started again",
                of(false, &[("main", Some(true)), ("main", None)]),
                Some(100),
                120,
                Presence::Silent,
            ),
            ("shared devices have none", of(true, &[]), None, 1, Presence::Absent),
        ] {
            assert_eq!(known.presence(newest_s.map(at), at(now_s)), wanted, "{name}");
            let nobody_stands_in = Observatories { timeout: None, ..known };
            assert_eq!(nobody_stands_in.presence(newest_s.map(at), at(now_s)), Presence::Sends, "{name}");
        }
        let mut returns = of(false, &main);
        let seen = [(Presence::Sends, 1), (Presence::Silent, 100), (Presence::Sends, 129), (Presence::Sends, 130)];
        assert_eq!(seen.map(|(presence, s)| returns.knows_all(presence, at(s))), [true, false, false, true]);
    }

    #[test]
    fn what_a_dead_node_reported_holds_until_it_is_known_better() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let alerts = vec![AlertKind::DomeNotClosed.alert("dome", Utc::EPOCH, "c")];
        for (name, states, others_know, is_kept) in [
            ("its host lost power", &[None][..], false, true),
            ("it has no state, as a guard process", &[], false, true),
            ("it ended in good order", &[None, Some(true)], false, false),
            ("it left the dome open", &[None, Some(false)], false, true),
            ("it was started again", &[Some(true), None], false, true),
            ("the observatory node sends", &[None], true, false),
        ] {
            let who = || (Role::Device, "enclosure".parse::<Name>().unwrap());
            let mut reports = LastReports::default();
            reports.take(who(), Alerts { alerts: alerts.clone(), ..Alerts::default() }, at(0));
            states.iter().for_each(|stopped| reports.observe(who(), &state(*stopped)));
            assert_eq!(reports.active(others_know, at(60)).count(), 1, "{name}: too soon");
            assert_eq!(reports.active(others_know, at(61)).count(), usize::from(is_kept), "{name}");
        }
    }

    #[test]
    fn the_configured_role_sends_before_the_other_and_of_one_role_the_first_name() {
        let [a, b]: [Name; 2] = ["a", "b"].map(|id| id.parse().unwrap());
        let mut all = [(Role::Web, &a), (Role::Archive, &b), (Role::Web, &b), (Role::Archive, &a)];
        all.sort_by_key(|(role, id)| turn(Role::Archive, *role, id));
        assert_eq!(all, [(Role::Archive, &a), (Role::Archive, &b), (Role::Web, &a), (Role::Web, &b)]);
        all.sort_by_key(|(role, id)| turn(Role::Web, *role, id));
        assert_eq!(all, [(Role::Web, &a), (Role::Web, &b), (Role::Archive, &a), (Role::Archive, &b)]);
    }

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
