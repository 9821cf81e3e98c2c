//! What `starmesh up` reports on the bus about its nodes: an end that nobody asked for is a line of the log, which the archive
//! keeps, and a node that hung or ended three times within ten minutes is an alert.
//!
//! It publishes them itself: a node that ends before it has joined the bus cannot. Its name among the nodes of the telescope is
//! `device/starmesh-up`, as that of a guard process is `device/enclosure-guard`.

use std::collections::BTreeMap;
use std::time::Duration;

use anyhow::Context as _;
use bus::{Bus, MachineTime};
use contract::node::{DiaryLine, Level};
use contract::observatory::AlertKind;
use contract::{Address, Key, NodeTopic, Role, printable};
use node::NodeAlerts;
use node::runs::{Ends, MANY, WITHIN};
use tokio::sync::mpsc;

const NAME: &str = "starmesh-up";
/// Alerts are published again so often.
const REPEATED: Duration = Duration::from_secs(10);
/// Ends that wait for the bus.
const MOST: usize = 100;

/// Takes the ends. Cheap to clone; never waits.
#[derive(Debug, Clone)]
pub struct Reports(mpsc::Sender<End>);

#[derive(Debug)]
struct End {
    node: String,
    how: String,
    /// When it is started again, in words.
    next: String,
    is_hung: bool,
}

impl Reports {
    /// Publishes under the address of a telescope as long as the returned work runs.
    pub fn start(bus: &Bus, address: Address) -> (Self, impl Future<Output = anyhow::Result<()>> + use<>) {
        let (sender, ends) = mpsc::channel(MOST);
        (Self(sender), publish(bus.clone(), address, ends))
    }

    /// A node ended and nobody had asked it to; `next` says when it is started again, such as `in 60 s`.
    pub fn ended(&self, role: Role, id: &str, how: &str, next: &str, is_hung: bool) {
        let (node, how, next) = (contract::node::name(role, id), printable(how).into_owned(), next.to_owned());
        // A full queue is one of a bus that takes nothing; the console has the line.
        let _ = self.0.try_send(End { node, how, next, is_hung });
    }
}

async fn publish(bus: Bus, address: Address, mut ends: mpsc::Receiver<End>) -> anyhow::Result<()> {
    let name: contract::Name = NAME.parse().context("the name of a supervisor")?;
    let key = |topic| Key::Node(address.clone(), Role::Device, name.clone(), topic);
    let alerts = NodeAlerts::new(bus.clock().clone());
    let lines = bus.publisher::<DiaryLine>(&key(NodeTopic::Diary)).await?;
    let published = bus.publisher(&key(NodeTopic::Alerts)).await?;
    let clock = bus.clock();
    let taking = async {
        let mut nodes: BTreeMap<String, Counted> = BTreeMap::new();
        loop {
            // Some seconds later an alert is over.
            let end = tokio::time::timeout(REPEATED, ends.recv()).await;
            let now = clock.machine();
            match end {
                Ok(Some(end)) => {
                    lines.put(line(&end)).await?;
                    let last = format!("{}, started again {}", end.how, end.next);
                    nodes.entry(end.node).or_default().take(end.is_hung, last, now);
                }
                Ok(None) => return Ok(()),
                Err(_) => {}
            }
            for (node, counted) in &mut nodes {
                match counted.cause(node, now) {
                    Some(cause) => alerts.raise(AlertKind::NodeEnds, node, &cause),
                    None => alerts.clear(AlertKind::NodeEnds, node),
                }
            }
        }
    };
    tokio::select! {
        ended = taking => ended,
        () = alerts.keep_time() => Ok(()),
        ended = published.follow(alerts.watch(), REPEATED) => Ok(ended?),
    }
}

fn line(end: &End) -> DiaryLine {
    let fields = [("node", &end.node), ("how", &end.how)].map(|(name, value)| (name.to_owned(), value.clone()));
    DiaryLine {
        level: Level::Error,
        target: "starmesh::up".to_owned(),
        message: format!(
            "the node {} ended without being asked to ({}); it is started again {}",
            end.node, end.how, end.next
        ),
        fields: fields.into(),
    }
}

/// The ends of one node. Pure: time comes in.
#[derive(Default)]
struct Counted {
    ends: Ends,
    hung_at: Option<MachineTime>,
    last: String,
}

impl Counted {
    fn take(&mut self, is_hung: bool, last: String, now: MachineTime) {
        self.ends.take(seconds(now));
        self.hung_at = if is_hung { Some(now) } else { self.hung_at };
        self.last = last;
    }

    /// Why a person must know, if one must.
    fn cause(&mut self, node: &str, now: MachineTime) -> Option<String> {
        let hung = self.hung_at.is_some_and(|at| now.since(at) <= WITHIN);
        if self.ends.are_many(seconds(now)) {
            let minutes = WITHIN.as_secs() / 60;
            return Some(format!("the node {node} ended {MANY} times within {minutes} min; last: {}", self.last));
        }
        hung.then(|| format!("the node {node} hung, and was ended and started again"))
    }
}

fn seconds(at: MachineTime) -> u64 {
    at.since(MachineTime::from_boot(Duration::ZERO)).as_secs()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(s))
    }

    #[test]
    fn the_third_end_is_an_alert_that_names_the_signal_and_a_node_that_hung_is_one_at_once() {
        let killed = || "signal: 9 (SIGKILL)".to_owned();
        let mut node = Counted::default();
        for s in [100, 160] {
            node.take(false, killed(), at(s));
            assert_eq!(node.cause("archive/main", at(s)), None);
        }
        node.take(false, killed(), at(200));
        let cause = node.cause("archive/main", at(200)).unwrap();
        assert_eq!(cause, "the node archive/main ended 3 times within 10 min; last: signal: 9 (SIGKILL)");
        assert_eq!(node.cause("archive/main", at(701)), None, "the first is more than ten minutes ago");

        let mut node = Counted::default();
        node.take(true, "it hung".to_owned(), at(100));
        assert!(node.cause("web/main", at(100)).unwrap().contains("hung"));
        assert_eq!(node.cause("web/main", at(701)), None);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn an_end_by_a_signal_is_a_line_on_the_bus_and_the_third_one_an_alert() {
        use bus::{Catch, Clock};
        use contract::Topic;
        use contract::observatory::Alerts;
        let open = |connect| async move {
            let config = config::Bus { listen: vec!["tcp/127.0.0.1:0".to_owned()], connect, multicast: false };
            Bus::open(&config, Clock::machine_clock()).await.unwrap()
        };
        let own = open(Vec::new()).await;
        let other = open(own.locators().await).await;
        let address = Address::new("site", "alpha").unwrap();
        let keys = |topic| Topic::Node(topic).at(&address);
        let lines = other.subscribe::<DiaryLine>(keys(NodeTopic::Diary), Catch::All, 100).await.unwrap();
        let alerts = other.subscribe::<Alerts>(keys(NodeTopic::Alerts), Catch::Newest, 100).await.unwrap();
        let (reports, work) = Reports::start(&own, address.clone());
        let work = tokio::spawn(work);
        for _ in 0..MANY {
            reports.ended(Role::Archive, "main", "signal: 9 (SIGKILL)", "in 60 s", false);
        }
        let limit = Duration::from_secs(60);
        let received = async {
            let line = lines.recv().await.sample.body;
            let wanted =
                "the node archive/main ended without being asked to (signal: 9 (SIGKILL)); it is started again in 60 s";
            assert_eq!(line.message, wanted);
            let is_raised = |alert: &contract::observatory::Alert| {
                alert.id == "node-ends/archive/main" && alert.cause.ends_with("SIGKILL), started again in 60 s")
            };
            while !alerts.recv().await.sample.body.alerts.iter().any(is_raised) {}
        };
        tokio::time::timeout(limit, received).await.unwrap();
        drop(reports);
        tokio::time::timeout(limit, work).await.unwrap().unwrap().unwrap();
    }
}
