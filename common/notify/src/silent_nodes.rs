//! Notices nodes that are silent: those that have published and do so no more, and those that ought to be there.
//!
//! An observatory node that was started expects the nodes that its file names, however they ended, and those that it heard
//! before and that have not ended in good order: it writes them into its data folder (`nodes-TELESCOPE-ID.json`).

mod record;

use std::collections::BTreeMap;
use std::time::Duration;

use bus::{Catch, MachineTime};
use config::Observatory;
use contract::node::{NodeState, fallen_silent};
use contract::observatory::AlertKind;
use contract::{Key, NodeTopic, Role, Topic};
use node::{Looks, Node, NodeAlerts, now_s};
use tokio::task::{JoinHandle, spawn_blocking};

use self::record::{Noted, Record, path, ran_before, write};

/// A node publishes its state every 5 s. The silence is itself the on-delay of the alert, and nothing is added to it.
pub(crate) const LOST: Duration = Duration::from_secs(AlertKind::NodeSilent.entry().on_delay_s as u64);
/// A node that has not published since this one began is missed after this: after a power cut the other computers of a site
/// take minutes to start.
const STARTS_WITHIN: Duration = Duration::from_secs(120);
/// Nodes of a telescope and of its site's shared devices; more are the invention of a faulty program.
const MOST_NODES: usize = 128;
/// The time at which a node was heard is written so often.
const NOTED_EVERY_S: u64 = 3600;
/// This node looks each second. One that has not looked for so long stood still itself, and has heard nobody meanwhile.
const STOOD_STILL: Duration = Duration::from_secs(4);

/// Raises, while `raises` says so, an alert for each other node of this telescope and of its site's shared devices that has
/// published and is silent now, for ever. An observatory node raises it for those, too, that it expects and that have not
/// published since it began. The alert ends when that node publishes again.
///
/// # Errors
///
/// The bus cannot be listened to.
pub async fn keep_noticing_silence(node: Node, raises: impl Fn() -> bool) -> anyhow::Result<()> {
    notice_silence(node, STARTS_WITHIN, raises).await
}

/// As [`keep_noticing_silence`], with the time in which others start.
async fn notice_silence(node: Node, starts_within: Duration, raises: impl Fn() -> bool) -> anyhow::Result<()> {
    let own = node.key(NodeTopic::State);
    let keys = Topic::Node(NodeTopic::State).on_site(&node.config.place.site);
    let states = node.bus.subscribe::<NodeState>(keys, Catch::Newest, 256).await?;
    let clock = node.bus.clock().clone();
    // A node that stands in for an observatory node reports that this one is missed.
    let file = (node.role == Role::Observatory).then(|| path(&node));
    let (mut nodes, boot_id) = (OtherNodes::default(), node::kernel_boot_id());
    if let Some(file) = file.clone() {
        let config = node.config.clone();
        let known = spawn_blocking(move || ran_before(&config, &file, now_s())).await?;
        let named = named(&node.config, std::env::var_os(node::SUPERVISOR).is_some());
        let began = clock.machine();
        let missed_from = |noted: &Noted| noted.missed_from(began, starts_within, &boot_id);
        nodes = OtherNodes::expected(&named, known, missed_from, now_s());
    }
    let (mut is_due, mut writing) = (false, None::<JoinHandle<()>>);
    let mut looks = Looks::begin(clock.machine(), STOOD_STILL);
    loop {
        if let Ok(state) = tokio::time::timeout(Duration::from_secs(1), states.recv()).await
            && let Some((instance, words)) = name(&state.key, &own)
        {
            node.alerts.clear(AlertKind::NodeSilent, &instance);
            is_due |= nodes.take(instance, &words, &state.sample.body, state.arrived, now_s());
        }
        let now = clock.machine();
        if let Some(before) = looks.stood_still_since(now) {
            nodes.after_standstill(before, now);
        }
        is_due |= nodes.note_missed(now, &boot_id);
        if raises() {
            nodes.raise_silent(now, &node.alerts);
        }
        // A disk that hangs keeps nobody from noticing silence.
        if let Some(file) = file.as_ref().filter(|_| is_due && writing.as_ref().is_none_or(JoinHandle::is_finished)) {
            let (file, record) = (file.clone(), nodes.record());
            (is_due, writing) = (false, Some(spawn_blocking(move || write(&file, &record))));
        }
    }
}

/// The instance of an alert about the node of this key, and that node in words; `None` where the node `own` raises none: about
/// itself, and about nodes of other telescopes.
fn name(key: &Key, own: &Key) -> Option<(String, String)> {
    let (Key::Node(home, watcher, ..), Key::Node(address, role, id, _)) = (own, key) else { return None };
    // A node that stands in knows by the alerts that an observatory node publishes whether one is silent (`stand_in`).
    let is_followed = *role == Role::Observatory && *watcher != Role::Observatory;
    if key == own || is_followed {
        return None;
    }
    if address == home {
        return Some(of_telescope(*role, id.as_str()));
    }
    let is_shared = *address == home.shared();
    // It may have the name of a node of the telescope.
    let of_the_site = || {
        let words = format!("the {role} node {id} of the site's shared devices");
        (format!("{}/{role}/{id}", address.telescope), words)
    };
    is_shared.then(of_the_site)
}

/// The instance of an alert about a node of the own telescope, and that node in words.
pub(crate) fn of_telescope(role: Role, id: &str) -> (String, String) {
    (contract::node::name(role, id), format!("the {role} node {id}"))
}

/// The nodes of the own telescope that ought to run: those that its file names, and that `starmesh up` starts beside this
/// one. Instances of their alerts, and words.
fn named(config: &Observatory, is_under_up: bool) -> BTreeMap<String, String> {
    let devices = config.device_nodes().into_iter().map(|id| of_telescope(Role::Device, id));
    let archives = config.archive.nodes.iter().map(|id| of_telescope(Role::Archive, id.as_str()));
    let beside = is_under_up.then(|| of_telescope(Role::Archive, config::MAIN_NODE));
    devices.chain(archives).chain(beside).collect()
}

impl Noted {
    /// When it begins to be missed by a node that `began`. One that was missed before that, on a host that was not started
    /// again since, has had its time to start.
    fn missed_from(&self, began: MachineTime, starts_within: Duration, boot_id: &str) -> MachineTime {
        let was_missed = !self.missed_since.is_empty() && self.missed_since == boot_id;
        began.plus(if was_missed { LOST.min(starts_within) } else { starts_within })
    }
}

/// A node that has published, or is expected to.
struct OtherNode {
    noted: Noted,
    /// It has published since this node began.
    is_heard: bool,
    /// When it begins to be missed; never where it has ended in good order and is not expected.
    missed_from: Option<MachineTime>,
}

impl OtherNode {
    fn cause(&self) -> String {
        let Noted { words, host, .. } = &self.noted;
        match (self.is_heard, host.as_str()) {
            (true, host) => fallen_silent(words, host),
            (false, "") => format!("{words}, which ought to run, has not been heard since this node began"),
            (false, host) => format!("{words} on host \"{host}\" ran before this node began, and was not heard since"),
        }
    }
}

/// The other nodes that have published, or are expected to, each by the instance of its alert. Pure: time comes in.
#[derive(Default)]
struct OtherNodes(BTreeMap<String, OtherNode>);

impl OtherNodes {
    /// Those that a node expects that begins now: those that are `named`, and those that were `known` before.
    fn expected(
        named: &BTreeMap<String, String>,
        mut known: Record,
        missed_from: impl Fn(&Noted) -> MachineTime,
        now_s: u64,
    ) -> Self {
        // A device node that the file does not name any more was renamed.
        let (device, _) = of_telescope(Role::Device, "");
        known.retain(|instance, _| !instance.starts_with(&device) || named.contains_key(instance));
        for (instance, words) in named {
            let never = || Noted {
                words: words.clone(),
                host: String::new(),
                heard_s: now_s,
                ended_well: false,
                missed_since: String::new(),
            };
            known.entry(instance.clone()).or_insert_with(never);
        }
        let expected = |(instance, noted): (String, Noted)| {
            // Whoever starts the telescope again starts what is named, too, however that ended.
            let is_expected = !noted.ended_well || named.contains_key(&instance);
            let missed_from = is_expected.then(|| missed_from(&noted));
            (instance, OtherNode { noted, is_heard: false, missed_from })
        };
        Self(known.into_iter().map(expected).collect())
    }

    /// What is to be written of them.
    fn record(&self) -> Record {
        let heard = self.0.iter().filter(|(_, node)| !node.noted.host.is_empty());
        heard.map(|(instance, node)| (instance.clone(), node.noted.clone())).collect()
    }

    /// Takes a state; true where what is to be written of its node has changed.
    fn take(&mut self, instance: String, words: &str, state: &NodeState, arrived: MachineTime, now_s: u64) -> bool {
        let known = self.0.get(&instance);
        if known.is_none() && self.0.len() >= MOST_NODES {
            return false;
        }
        let before_s = known.map(|node| node.noted.heard_s).filter(|at_s| now_s.abs_diff(*at_s) < NOTED_EVERY_S);
        let noted = Noted {
            words: words.to_owned(),
            host: state.host.clone(),
            heard_s: before_s.unwrap_or(now_s),
            ended_well: state.ended_well(),
            missed_since: String::new(),
        };
        let has_changed = known.is_none_or(|node| node.noted != noted);
        let missed_from = (!noted.ended_well).then(|| arrived.plus(LOST));
        self.0.insert(instance, OtherNode { noted, is_heard: true, missed_from });
        has_changed
    }

    /// This node itself stood still from `before` to `now`: that time proves nobody's silence.
    fn after_standstill(&mut self, before: MachineTime, now: MachineTime) {
        for from in self.0.values_mut().filter_map(|node| node.missed_from.as_mut()).filter(|from| **from > before) {
            *from = (*from).max(now.plus(LOST));
        }
    }

    /// Notes those that have been silent for too long; true where what is to be written has changed.
    fn note_missed(&mut self, now: MachineTime, boot_id: &str) -> bool {
        let mut has_changed = false;
        let is_missed = |node: &&mut OtherNode| node.missed_from.is_some_and(|from| now > from);
        for node in self.0.values_mut().filter(is_missed).filter(|node| node.noted.missed_since != boot_id) {
            boot_id.clone_into(&mut node.noted.missed_since);
            has_changed = true;
        }
        has_changed
    }

    /// Raises an alert for each that has been silent for too long.
    fn raise_silent(&self, now: MachineTime, alerts: &NodeAlerts) {
        for (instance, cause) in self.silent(now) {
            alerts.raise_at_once(AlertKind::NodeSilent, instance, &cause);
        }
    }

    /// Those that have been silent for too long: instances and causes.
    fn silent(&self, now: MachineTime) -> impl Iterator<Item = (&str, String)> {
        let silent = self.0.iter().filter(move |(_, node)| node.missed_from.is_some_and(|from| now > from));
        silent.map(|(instance, node)| (instance.as_str(), node.cause()))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use contract::node::Stopped;
    use contract::{Address, Name};

    use super::record::EXPECTED_FOR_S;
    use super::*;

    /// The clock of this host.
    const NOW_S: u64 = 1_800_000_000;

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
    fn a_time_in_which_this_node_stood_still_is_no_silence_of_others() {
        let mut nodes = OtherNodes::default();
        for (instance, heard_s) in [("device/main", 100), ("device/dome", 60)] {
            nodes.take(instance.to_owned(), "a device node", &state(None), at(heard_s), NOW_S);
        }
        assert_eq!(nodes.silent(at(116)).count(), 2, "it looks, and hears neither");
        nodes.after_standstill(at(101), at(180));
        let silent =
            |nodes: &OtherNodes, now_s| nodes.silent(at(now_s)).map(|(id, _)| id.to_owned()).collect::<Vec<_>>();
        assert_eq!(silent(&nodes, 195), ["device/dome"], "this one was silent before");
        assert_eq!(silent(&nodes, 196), ["device/dome", "device/main"], "and this one has had its time since");
    }

    #[test]
    fn a_node_that_ended_in_good_order_is_not_silent_and_one_that_left_a_dome_open_is() {
        let (instance, words) = ("device/enclosure", "the device node enclosure");
        for (last, is_silent) in
            [(None, true), (Some(None), false), (Some(Some(true)), false), (Some(Some(false)), true)]
        {
            let mut nodes = OtherNodes::default();
            nodes.take(instance.to_owned(), words, &state(None), at(100), NOW_S);
            nodes.take(instance.to_owned(), words, &state(last), at(105), NOW_S);
            assert_eq!(nodes.silent(at(119)).count(), 0, "{last:?}: too soon");
            let alert = (instance, "the device node enclosure on host \"dome-pc\" has fallen silent".to_owned());
            let wanted = if is_silent { vec![alert] } else { Vec::new() };
            assert_eq!(nodes.silent(at(121)).collect::<Vec<_>>(), wanted, "{last:?}");
            nodes.take(instance.to_owned(), words, &state(None), at(130), NOW_S);
            assert_eq!(nodes.silent(at(146)).count(), 1, "{last:?}: it runs again, and falls silent then");
        }
    }

    #[test]
    fn the_alert_about_a_silent_node_stands_after_the_time_that_the_catalogue_says_and_no_later() {
        let (mut nodes, alerts) = (OtherNodes::default(), NodeAlerts::new(bus::Clock::machine_clock()));
        nodes.take("device/main".to_owned(), "the device node main", &state(None), at(100), NOW_S);
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
        nodes.take(instance.clone(), &words, &state(None), at(0), NOW_S);
        assert_eq!(nodes.silent(at(15)).count(), 0);
        let cause = "the device node main of the site's shared devices on host \"dome-pc\" has fallen silent";
        assert_eq!(nodes.silent(at(16)).collect::<Vec<_>>(), [("shared/device/main", cause.to_owned())]);
        nodes.take(instance, &words, &state(None), at(17), NOW_S);
        assert_eq!(nodes.silent(at(18)).count(), 0);
    }

    fn callisto(more: &str) -> Observatory {
        let text = test_support::ALPHA.replace("alpha", "callisto") + more;
        config::parse(&text, Path::new("/")).unwrap()
    }

    fn noted(host: &str, heard_s: u64, ended_well: bool) -> Noted {
        Noted { words: "it".to_owned(), host: host.to_owned(), heard_s, ended_well, missed_since: String::new() }
    }

    /// What a node that begins at 100 s expects.
    fn expected(named: &BTreeMap<String, String>, known: &[(&str, Noted)]) -> OtherNodes {
        let known = known.iter().map(|(instance, noted)| ((*instance).to_owned(), noted.clone())).collect();
        OtherNodes::expected(named, known, |noted| noted.missed_from(at(100), STARTS_WITHIN, "this boot"), NOW_S)
    }

    fn instances(nodes: &OtherNodes, now_s: u64) -> Vec<&str> {
        nodes.silent(at(now_s)).map(|(instance, _)| instance).collect()
    }

    /// Who is missed by a node that begins at 100 s and hears nobody.
    fn missed(config: &Observatory, known: &[(&str, Noted)]) -> Vec<String> {
        let nodes = expected(&named(config, false), known);
        assert_eq!(instances(&nodes, 220), [""; 0], "after a power cut the other computers start later");
        instances(&nodes, 221).into_iter().map(str::to_owned).collect()
    }

    #[test]
    fn a_node_that_fell_silent_before_this_one_began_or_is_named_is_missed_and_another_one_that_ended_well_is_not() {
        let dome = callisto(&test_support::block("dome", "dome", "h:1", ""));
        assert_eq!(missed(&callisto(""), &[]), [""; 0], "a telescope that has no such node");
        assert_eq!(missed(&dome, &[]), ["device/enclosure"], "the file names it");
        let ended = noted("dome-pc", NOW_S, true);
        let named_and_ended = [("device/enclosure", ended.clone())];
        assert_eq!(missed(&dome, &named_and_ended), ["device/enclosure"], "it was stopped, and is to be there again");
        let died = noted("archive-pc", NOW_S, false);
        let all = [
            ("archive/main", died.clone()),
            ("archive/second", ended.clone()),
            ("device/renamed", died.clone()),
            ("shared/device/main", died),
            ("web/main", ended.clone()),
        ];
        assert_eq!(missed(&dome, &all), ["archive/main", "device/enclosure", "shared/device/main"]);
        let two_archives = callisto("[archive]\nnodes = [\"main\", \"second\"]\n");
        assert_eq!(missed(&two_archives, &[]), ["archive/main", "archive/second"]);
        // `starmesh up` stopped all, and starts all again.
        let beside = expected(&named(&callisto(""), true), &[("archive/main", ended.clone()), ("web/main", ended)]);
        assert_eq!(instances(&beside, 221), ["archive/main"]);
    }

    #[test]
    fn a_node_that_was_missed_before_a_restart_is_missed_soon_after_it_unless_the_host_was_started_again() {
        let mut nodes = OtherNodes::default();
        let archive = || "archive/main".to_owned();
        nodes.take(archive(), "it", &state(None), at(10), NOW_S);
        assert!(!nodes.note_missed(at(25), "this boot"), "it is not missed yet");
        assert!(nodes.note_missed(at(26), "this boot") && !nodes.note_missed(at(27), "this boot"), "written once");
        let known = |nodes: &OtherNodes| nodes.record().into_iter().collect::<Vec<_>>();
        let after = |known: &[(String, Noted)], boot_id: &str, now_s: u64| {
            let from = |noted: &Noted| noted.missed_from(at(100), STARTS_WITHIN, boot_id);
            let nodes = OtherNodes::expected(&BTreeMap::new(), known.iter().cloned().collect(), from, NOW_S);
            instances(&nodes, now_s).len()
        };
        let missed = known(&nodes);
        assert_eq!((after(&missed, "this boot", 115), after(&missed, "this boot", 116)), (0, 1));
        assert_eq!((after(&missed, "the next boot", 220), after(&missed, "the next boot", 221)), (0, 1), "a power cut");
        assert!(nodes.take(archive(), "it", &state(None), at(30), NOW_S), "it is back, and that is written");
        let heard = known(&nodes);
        assert_eq!((after(&heard, "this boot", 220), after(&heard, "this boot", 221)), (0, 1));
    }

    #[test]
    fn a_node_that_is_missed_from_the_start_is_named_with_what_is_known_of_it_until_it_is_heard() {
        let dome = callisto(&test_support::block("dome", "dome", "h:1", ""));
        let mut nodes = expected(&named(&dome, false), &[("archive/main", noted("archive-pc", NOW_S, false))]);
        let causes: Vec<String> = nodes.silent(at(221)).map(|(_, cause)| cause).collect();
        assert_eq!(causes[0], "it on host \"archive-pc\" ran before this node began, and was not heard since");
        let enclosure = "the device node enclosure, which ought to run, has not been heard since this node began";
        assert_eq!(causes[1], enclosure);
        assert_eq!(nodes.record().into_keys().collect::<Vec<_>>(), ["archive/main"], "only what was heard is written");
        let mut take = |instance: &str, last, now_s| {
            nodes.take(instance.to_owned(), "it", &state(last), at(now_s), NOW_S);
            instances(&nodes, now_s + 16).into_iter().map(str::to_owned).collect::<Vec<_>>()
        };
        let silent = take("archive/main", None, 222);
        assert_eq!(silent, ["archive/main", "device/enclosure"], "it was heard, and falls silent");
        assert_eq!(take("archive/main", Some(None), 240), ["device/enclosure"], "it says that it ends");
        assert_eq!(take("device/enclosure", Some(Some(true)), 260), [""; 0], "so does one that is named");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn an_observatory_node_that_starts_misses_the_nodes_of_its_file_and_writes_down_those_that_it_hears() {
        let folder = tempfile::tempdir().unwrap();
        let text = test_support::ALPHA.to_owned() + &test_support::block("dome", "dome", "127.0.0.1:9", "");
        let config = config::parse(&text, folder.path()).unwrap();
        let (address, data) = (config.address(), config.folders.data.clone());
        std::fs::create_dir_all(&data).unwrap();
        let bus = test_support::private_bus(bus::Clock::machine_clock()).await;
        let node = Node::new(Role::Observatory, "main".parse().unwrap(), config, Default::default(), bus.clone());
        let raised = node.alerts.watch();
        let noticing = tokio::spawn(notice_silence(node, Duration::ZERO, || true));
        let is_missed = || raised.borrow().alerts.iter().any(|alert| alert.id == "node-silent/device/enclosure");
        test_support::until("the node of the dome is missed", is_missed).await;
        let archive = test_support::join(&bus).await;
        let key = Key::Node(address, Role::Archive, "main".parse().unwrap(), NodeTopic::State);
        let states = archive.publisher::<NodeState>(&key).await.unwrap();
        let (_state, shown) = tokio::sync::watch::channel(state(None));
        let file = data.join("nodes-alpha-main.json");
        let is_written = || std::fs::read_to_string(&file).is_ok_and(|text| text.contains("archive/main"));
        tokio::select! {
            () = test_support::until("what it hears is written down", is_written) => {}
            published = states.follow(shown, Duration::from_secs(1)) => panic!("{published:?}"),
        }
        noticing.abort();
        archive.close().await;
        bus.close().await;
    }

    #[test]
    fn what_was_heard_is_written_down_and_read_by_the_next_one_and_damage_and_age_expect_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let (file, config) = (folder.path().join("nodes-callisto-main.json"), callisto(""));
        assert_eq!(ran_before(&config, &file, NOW_S), Record::default(), "the first start");
        let mut nodes = OtherNodes::default();
        let mut take = |last, now_s| nodes.take("archive/main".to_owned(), "it", &state(last), at(100), now_s);
        let changes = [take(None, NOW_S), take(None, NOW_S + 5), take(Some(None), NOW_S + 6), take(None, NOW_S + 7)];
        assert_eq!(changes, [true, false, true, true]);
        assert!(take(None, NOW_S + NOTED_EVERY_S), "an hour later it is noted that it still runs");
        write(&file, &nodes.record());
        let heard: Record = [("archive/main".to_owned(), noted("dome-pc", NOW_S + NOTED_EVERY_S, false))].into();
        assert_eq!(ran_before(&config, &file, NOW_S + EXPECTED_FOR_S), heard);
        let late_s = NOW_S + NOTED_EVERY_S + EXPECTED_FOR_S + 1;
        assert_eq!(ran_before(&config, &file, late_s), Record::default(), "it was taken away");
        assert_eq!(ran_before(&config, &file, 100), heard, "a computer whose clock begins in 1970");
        std::fs::write(&file, "{\"archive").unwrap();
        assert_eq!(ran_before(&config, &file, NOW_S), Record::default());
    }
}
