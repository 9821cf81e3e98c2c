//! Notices nodes that have published and are silent now.

use std::collections::BTreeMap;
use std::time::Duration;

use bus::{Catch, MachineTime};
use contract::node::NodeState;
use contract::observatory::AlertKind;
use contract::{Key, NodeTopic, Role, Topic};
use node::{Node, NodeAlerts};

/// A node publishes its state every 5 s. The silence is itself the on-delay of the alert, and nothing is added to it.
pub(crate) const LOST: Duration = Duration::from_secs(AlertKind::NodeSilent.entry().on_delay_s as u64);
/// Nodes of a telescope and of its site's shared devices; more are the invention of a faulty program.
const MOST_NODES: usize = 128;

/// Raises, while `raises` says so, an alert for each other node of this telescope and of its site's shared devices that has
/// published and is silent now, for ever. The alert ends when that node publishes again.
///
/// # Errors
///
/// The bus cannot be listened to.
pub async fn keep_noticing_silence(node: Node, raises: impl Fn() -> bool) -> anyhow::Result<()> {
    let own = node.key(NodeTopic::State);
    let keys = Topic::Node(NodeTopic::State).on_site(&node.config.place.site);
    let states = node.bus.subscribe::<NodeState>(keys, Catch::Newest, 256).await?;
    let clock = node.bus.clock().clone();
    let mut nodes = OtherNodes::default();
    loop {
        if let Ok(state) = tokio::time::timeout(Duration::from_secs(1), states.recv()).await
            && let Some((instance, words)) = name(&state.key, &own)
        {
            node.alerts.clear(AlertKind::NodeSilent, &instance);
            nodes.take(instance, &words, &state.sample.body, state.arrived);
        }
        if raises() {
            nodes.raise_silent(clock.machine(), &node.alerts);
        }
    }
}

/// The instance of an alert about the node of this key, and that node in words; `None` where the node `own` raises none: about
/// itself, and about nodes of other telescopes.
fn name(key: &Key, own: &Key) -> Option<(String, String)> {
    let (Key::Node(home, watcher, ..), Key::Node(address, role, id, _)) = (own, key) else { return None };
    // A node that stands in reports the observatory nodes of its telescope as one.
    let are_one = *role == Role::Observatory && *watcher != Role::Observatory;
    if key == own || are_one {
        return None;
    }
    if address == home {
        return Some((format!("{role}/{id}"), format!("the {role} node {id}")));
    }
    let is_shared = *address == home.shared();
    // It may have the name of a node of the telescope.
    let of_the_site = || {
        let words = format!("the {role} node {id} of the site's shared devices");
        (format!("{}/{role}/{id}", address.telescope), words)
    };
    is_shared.then(of_the_site)
}

/// The other nodes that have published, each by the instance of its alert, with the cause of it. Pure: time comes in.
#[derive(Default)]
struct OtherNodes(BTreeMap<String, (String, MachineTime)>);

impl OtherNodes {
    fn take(&mut self, instance: String, words: &str, state: &NodeState, arrived: MachineTime) {
        if state.ended_well() {
            // It has reported that it will be silent.
            self.0.remove(&instance);
        } else if self.0.len() < MOST_NODES || self.0.contains_key(&instance) {
            let cause = format!("{words} on host \"{}\" has fallen silent", state.host);
            self.0.insert(instance, (cause, arrived));
        }
    }

    /// Raises an alert for each that has been silent for too long.
    fn raise_silent(&self, now: MachineTime, alerts: &NodeAlerts) {
        for (instance, cause) in self.silent(now) {
            alerts.raise_at_once(AlertKind::NodeSilent, instance, cause);
        }
    }

    /// Those that have been silent for too long: instances and causes.
    fn silent(&self, now: MachineTime) -> impl Iterator<Item = (&str, &str)> {
        let silent = self.0.iter().filter(move |(_, (_, arrived))| now.since(*arrived) > LOST);
        silent.map(|(instance, (cause, _))| (instance.as_str(), cause.as_str()))
    }
}

#[cfg(test)]
mod tests {
    use contract::node::Stopped;
    use contract::{Address, Name};

    use super::*;

    fn at(seconds: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(seconds))
    }

    fn state(stopped: Option<Option<bool>>) -> NodeState {
        NodeState {
            role: Role::Device,
            version: String::new(),
            host: "dome-pc".to_owned(),
            pid: 1,
            uptime_s: 1.0,
            speed: 1.0,
            figures: BTreeMap::new(),
            stopped: stopped.map(|closed| Stopped { by: "starmesh up on dome-pc".to_owned(), closed }),
        }
    }

    fn key(telescope: &str, role: Role, id: &str) -> Key {
        let id: Name = id.parse().unwrap();
        Key::Node(Address::new("paranal", telescope).unwrap(), role, id, NodeTopic::State)
    }

    #[test]
    fn a_node_that_ended_in_good_order_is_not_silent_and_one_that_left_a_dome_open_is() {
        let (instance, words) = ("device/enclosure", "the device node enclosure");
        for (last, is_silent) in
            [(None, true), (Some(None), false), (Some(Some(true)), false), (Some(Some(false)), true)]
        {
            let mut nodes = OtherNodes::default();
            nodes.take(instance.to_owned(), words, &state(None), at(100));
            nodes.take(instance.to_owned(), words, &state(last), at(105));
            assert_eq!(nodes.silent(at(119)).count(), 0, "{last:?}: too soon");
            let alert = (instance, "the device node enclosure on host \"dome-pc\" has fallen silent");
            let wanted = if is_silent { vec![alert] } else { Vec::new() };
            assert_eq!(nodes.silent(at(121)).collect::<Vec<_>>(), wanted, "{last:?}");
            nodes.take(instance.to_owned(), words, &state(None), at(130));
            assert_eq!(nodes.silent(at(146)).count(), 1, "{last:?}: it runs again, and falls silent then");
        }
    }

    #[test]
    fn the_alert_about_a_silent_node_stands_after_the_time_that_the_catalogue_says_and_no_later() {
        let (mut nodes, alerts) = (OtherNodes::default(), NodeAlerts::new(bus::Clock::machine_clock()));
        nodes.take("device/main".to_owned(), "the device node main", &state(None), at(100));
        let delay_s = u64::from(AlertKind::NodeSilent.entry().on_delay_s);
        for (now_s, stands) in [(100 + delay_s, 0), (101 + delay_s, 1)] {
            nodes.raise_silent(at(now_s), &alerts);
            assert_eq!(alerts.watch().borrow().alerts.len(), stands, "{now_s}");
        }
    }

    #[test]
    fn the_nodes_of_the_telescope_and_of_the_shared_devices_are_told_apart_and_others_are_left_out() {
        let commander = key("callisto", Role::Observatory, "main");
        let archive = key("callisto", Role::Archive, "main");
        for (own, telescope, role, id, wanted) in [
            (&commander, "callisto", Role::Device, "main", Some("node-silent/device/main")),
            (&commander, "callisto", Role::Observatory, "second", Some("node-silent/observatory/second")),
            (&commander, "callisto", Role::Observatory, "main", None),
            (&commander, "shared", Role::Device, "main", Some("node-silent/shared/device/main")),
            (&commander, "shared", Role::Archive, "main", Some("node-silent/shared/archive/main")),
            (&commander, "europa", Role::Device, "main", None),
            (&archive, "callisto", Role::Web, "main", Some("node-silent/web/main")),
            (&archive, "callisto", Role::Archive, "main", None),
            (&archive, "callisto", Role::Observatory, "main", None),
            (&archive, "shared", Role::Device, "main", Some("node-silent/shared/device/main")),
        ] {
            let id_of = |(instance, _): (String, String)| AlertKind::NodeSilent.id(instance);
            let found = name(&key(telescope, role, id), own).map(id_of);
            assert_eq!(found.as_deref(), wanted, "{own}: {telescope}/{role}/{id}");
        }
    }

    #[test]
    fn a_node_of_the_shared_devices_whose_host_dies_is_named_with_its_host_until_it_is_back() {
        let (mast, own) = (key("shared", Role::Device, "main"), key("callisto", Role::Observatory, "main"));
        let (instance, words) = name(&mast, &own).unwrap();
        let mut nodes = OtherNodes::default();
        assert_eq!(nodes.silent(at(9000)).count(), 0, "a site without shared devices");
        nodes.take(instance.clone(), &words, &state(None), at(0));
        assert_eq!(nodes.silent(at(15)).count(), 0);
        let cause = "the device node main of the site's shared devices on host \"dome-pc\" has fallen silent";
        assert_eq!(nodes.silent(at(16)).collect::<Vec<_>>(), [("shared/device/main", cause)]);
        nodes.take(instance, &words, &state(None), at(17));
        assert_eq!(nodes.silent(at(18)).count(), 0);
    }
}
