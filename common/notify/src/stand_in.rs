//! Sends in the place of an observatory node that fell silent.

mod observatories;

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

use self::observatories::{Observatories, Presence};
use crate::push::Subscriptions;
use crate::sending::{keep_pushing, keep_sending};
use crate::silent_nodes::{LOST, keep_noticing_silence};

/// Alerts are published every 10 s; a node that is silent for longer than this is away.
const SILENCE: Duration = Duration::from_secs(60);

/// The observatory node that returns must receive the alert that it was missed, so that it can report the end to
/// people.
const HOLD: Duration = Duration::from_secs(30);
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
    /// in good order does, and an observatory node that sends and has received what arrived then (`others_know`): what it holds
    /// active is in its own list.
    fn active(&mut self, others_know: impl Fn(MachineTime) -> bool, now: MachineTime) -> impl Iterator<Item = Alerts> {
        let is_over = |who: &(Role, Name), arrived| self.ended_well.contains(who) || others_know(arrived);
        self.lists.retain(|who, (_, arrived)| now.since(*arrived) <= SILENCE || !is_over(who, *arrived));
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
        seen: BTreeMap::new(),
    };
    let mut own = node.alerts.watch();
    let mut raised = BTreeMap::new();
    loop {
        let now = clock.machine();
        let newest = merged.get();
        let sender = newest.as_ref().map(|newest| &newest.sample.boot_id);
        let presence = observatories.presence(newest.as_ref().map(|newest| newest.arrived), now);
        let others_know = observatories.knows_all(presence, now);
        silent.send_replace(presence == Presence::Silent);
        if presence == Presence::Silent {
            if now.since(*silent_since.get_or_insert(now)) >= FIRST_BEGIN {
                let found = observatories.silent(&raised, sender, now);
                for instance in raised.keys().filter(|instance| !found.contains_key(*instance)) {
                    node.alerts.clear(AlertKind::NodeSilent, instance);
                }
                raised = found;
                for (instance, cause) in &raised {
                    // The time of the silence was its delay.
                    node.alerts.raise_at_once(AlertKind::NodeSilent, instance, cause);
                }
                last_silent = Some(now);
            }
        } else {
            silent_since = None;
        }
        if presence != Presence::Silent && last_silent.is_none_or(|at| now.since(at) >= HOLD) {
            for instance in std::mem::take(&mut raised).into_keys() {
                node.alerts.clear(AlertKind::NodeSilent, &instance);
            }
        }
        let lists = std::iter::once(own.borrow_and_update().clone());
        let has_heard = |arrived| others_know && observatories.has_heard(sender, arrived, now);
        let active = merge(lists.chain(reports.active(has_heard, now)));
        let last = newest.map(|newest| newest.sample.body);
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
                        observatories.take(id.clone(), &state.sample, state.arrived);
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
    use contract::observatory::{Alert, LAST_WORD};
    use contract::{BootId, Stamped};

    use super::*;

    fn state(stopped: Option<bool>) -> NodeState {
        NodeState {
            role: Role::Observatory,
            version: String::new(),
            host: "pc".to_owned(),
            pid: 1,
            uptime_s: 50.0,
            speed: 1.0,
            figures: BTreeMap::new(),
            stopped: stopped.map(|closed| Stopped { by: String::new(), closed: Some(closed) }),
        }
    }

    fn stamped(boot_id: &str, stopped: Option<bool>) -> Stamped<NodeState> {
        let boot_id = boot(boot_id);
        Stamped { boot_id, seq: 0, at_utc: Utc::EPOCH, sent_s: None, held_s: None, body: state(stopped) }
    }

    fn boot(text: &str) -> BootId {
        serde_json::from_value(text.into()).unwrap()
    }

    fn observatories(began: MachineTime) -> Observatories {
        let timeout = Some(Duration::from_secs(20));
        Observatories { timeout, began, last_away: None, is_shared: false, seen: BTreeMap::new() }
    }

    #[test]
    fn a_silent_observatory_node_is_named_as_any_other_node_is() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let follow = |before: &BTreeMap<_, _>, seen: &[(&str, u64, Option<bool>)], last: Option<&str>| {
            let mut known = observatories(at(0));
            for (id, arrived_s, stopped) in seen {
                known.take(id.parse().unwrap(), &stamped(&format!("boot of {id}"), *stopped), at(*arrived_s));
            }
            known.silent(before, last.map(boot).as_ref(), at(120))
        };
        let silent = |seen: &[_], last| follow(&BTreeMap::new(), seen, last);
        let ids = |seen: &[_], last| silent(seen, last).into_keys().collect::<Vec<_>>();
        let (main, second) = ("observatory/main", "observatory/second");
        let one = silent(&[("main", 119, None)], Some("boot of main"));
        let cause = "the observatory node main on host \"pc\" has fallen silent";
        assert_eq!(one, BTreeMap::from([(main.to_owned(), cause.to_owned())]));
        let both = [("main", 104, None), ("second", 119, None)];
        assert_eq!(ids(&both, None), [main], "the standby goes on, and does not take over");
        assert_eq!(ids(&both, Some("boot of second")), [main, second], "it had taken over, and hangs");
        let stopped = [("main", 119, Some(true)), ("second", 104, None)];
        assert_eq!(ids(&stopped, Some("boot of main")), [second], "main was stopped");
        assert_eq!(ids(&[], None), [main], "none was ever received");

        let go_on = [("main", 119, None), ("second", 119, None)];
        let nobody = silent(&go_on, None);
        let cause = "no observatory node publishes alerts, although there are states of main, second";
        assert_eq!(nobody, BTreeMap::from([("observatory".to_owned(), cause.to_owned())]), "whose state is fresh");
        assert_eq!(ids(&[("main", 119, None)], Some("the one before")), ["observatory"], "it was started again");
        let later = |before, seen: &[_], last| follow(before, seen, last).into_keys().collect::<Vec<_>>();
        assert_eq!(later(&one, &go_on, Some("the one before")), [main], "it is on its way back");
        let lost = [("main", 119, None), ("second", 104, None)];
        assert_eq!(later(&one, &lost, None), [second], "the newest answer holds");
        assert_eq!(later(&nobody, &lost, None), [second], "also where none was named");
    }

    #[test]
    fn an_observatory_node_that_began_after_another_node_fell_silent_has_not_received_its_last_alerts() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let mut known = observatories(at(0));
        // It has run for 50 s: since second 50.
        known.take("main".parse().unwrap(), &stamped("own", None), at(100));
        let heard = |sender, last_s| known.has_heard(Some(&boot(sender)), at(last_s), at(200));
        assert_eq!([40, 59, 61, 150].map(|last_s| heard("own", last_s)), [false, false, true, true]);
        assert!(!heard("another incarnation", 150), "nothing is known of the one that publishes the alerts");
        let long = LAST_WORD.as_secs();
        let heard = [long, long + 1].map(|now_s| known.has_heard(Some(&boot("own")), at(0), at(now_s)));
        assert_eq!(heard, [false, true], "what everybody has forgotten is over");
    }

    #[test]
    fn a_silent_observatory_node_is_noticed_and_one_that_was_stopped_is_no_fault_while_another_node_sends_at_once() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let of = |is_shared, states: &[(&str, Option<bool>)]| {
            let mut known = Observatories { is_shared, ..observatories(at(0)) };
            states.iter().for_each(|(id, stopped)| known.take(id.parse().unwrap(), &stamped("own", *stopped), at(0)));
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
            assert_eq!(reports.active(|_| others_know, at(60)).count(), 1, "{name}: too soon");
            assert_eq!(reports.active(|_| others_know, at(61)).count(), usize::from(is_kept), "{name}");
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
