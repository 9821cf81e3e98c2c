//! The safety loop: receives the inputs, judges at each arrival and each second, and waits for nothing else.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use bus::{Catch, Clock, Received, Subscriber};
use contract::node::NodeState;
use contract::observatory::{AlertKind, Interval, Verdict};
use contract::{Key, NodeTopic, Role, Topic};
use node::Node;
use safety::active_orders::ActiveOrders;
use safety::clocks::{self, Doubt};
use safety::current_verdict::CurrentVerdict;
use safety::judge::{Judgement, judge};
use safety::received::History;
use safety::rules::Rules;
use safety::stored_history::{Moment, StoredHistory};
use safety::sun::Sun;
use tokio::sync::watch;

use super::clock_file::ClockFile;
use super::record_file::{self, RecordFile};
use super::subscribers::{self, Heard, Word, now};
use super::verdict_file;

/// So long after its start, a node may lack a value of an input before that counts.
const GRACE: Duration = Duration::from_secs(5);

/// Judges until the node ends; this task publishes its verdict and nothing else.
pub async fn keep_judging(
    node: Node,
    rules: Arc<Rules>,
    mut orders: watch::Receiver<ActiveOrders>,
    verdict: watch::Sender<CurrentVerdict>,
) -> anyhow::Result<()> {
    let clock = node.bus.clock().clone();
    let (subscribers, mut received) = subscribers::open(&node, &rules).await?;
    // A file without any input has nobody to listen to: the verdict goes on without.
    let is_deaf = subscribers.is_empty();
    let nodes = listen_to_nodes(&node).await?;

    for (input, why) in &rules.disabled {
        node.alerts.raise(AlertKind::Disabled, input, &format!("{input} is disabled: {why}"));
    }
    let started = now(&clock);
    let mut history = History::new(&rules, started.sky);
    history.speed = clock.speed();
    let (config, of_machine, utc) = (node.config.clone(), !clock.is_simulated(), clock.utc());
    let (speed, machine) = (clock.speed(), started.machine);
    let watched = move || {
        let folder = of_machine.then_some(config.folders.data.as_path());
        let file = ClockFile::new(folder, config.place.telescope.as_str());
        (file.watch(speed, utc, machine), file)
    };
    let mut sun = Sun::of(&node.config, rules.sun_altitude_max_deg);
    let (mut clocks, clock_file) = tokio::task::spawn_blocking(watched).await?;
    let host = node::host_name();
    let past = verdict_file::path(&node.config);
    let read = past.clone();
    let mut past_verdicts = tokio::task::spawn_blocking(move || verdict_file::read(&read)).await?;
    let boot = node::kernel_boot_id();
    let moment = || Moment { boot: boot.clone(), now: now(&clock), utc: clock.utc(), speed: clock.speed() };
    let record = record_file::path(&node.config, &node.id);
    let read = record.clone();
    let stored = tokio::task::spawn_blocking(move || record_file::read(&read)).await?;
    go_on(&mut history, &rules, stored, &moment());
    let mut record_file = RecordFile::open(record);
    loop {
        let (utc, machine) = (clock.utc(), clock.machine());
        let doubts = clocks.doubts(utc, machine, &history.nodes.witnesses(&host, machine));
        if let Some(anchor) = clocks.to_persist() {
            clock_file.write_aside(anchor);
        }
        report(&node.alerts, &doubts);
        history.sun = sun.stands(utc, &doubts);
        let (earliest, latest) = clocks::between(utc, &doubts);
        let effective = orders.borrow_and_update().applied_between(&rules, earliest, latest);
        let judgement = verdict.borrow().hold(judge(&effective, &history, now(&clock)));
        let waited = now(&clock).machine.since(started.machine) >= GRACE;
        let settled = waited || history.all_received() || judgement.speaks_against;
        if settled && let Some(ended) = past_verdicts.judge(judgement.verdict, &judgement.reasons, clock.utc()) {
            keep(past.clone(), ended);
        }
        publish(&verdict, judgement, past_verdicts.published(), settled, &clock);
        verdict.send_if_modified(|verdict| {
            let ahead_s = utc.seconds_since(earliest);
            std::mem::replace(&mut verdict.ahead_s, ahead_s).to_bits() != ahead_s.to_bits()
        });
        record_file.keep(clock.machine(), || history.store(&rules, &moment()));
        tokio::select! {
            (name, state) = recv_node(&nodes) => {
                let own = clock.utc();
                history.nodes.observe(name, &state.sample.body, state.sample.at_utc, own, state.arrived);
            }
            word = received.recv(), if !is_deaf => {
                let Some(word) = word else { anyhow::bail!("nothing listens to the safety inputs any more") };
                take_in(&mut history, &rules, word, clock.speed());
                // All that waits, before judging once.
                while let Ok(word) = received.try_recv() {
                    take_in(&mut history, &rules, word, clock.speed());
                }
            }
            changed = orders.changed() => changed?,
            () = clock.tick(Duration::from_secs(1)) => {}
        }
    }
}

/// An alert names the clocks that disagree, and by how much.
fn report(alerts: &node::NodeAlerts, doubts: &[Doubt]) {
    if doubts.is_empty() {
        return alerts.clear(AlertKind::ClocksDisagree, "");
    }
    let words: Vec<String> = doubts.iter().map(ToString::to_string).collect();
    alerts.raise(AlertKind::ClocksDisagree, "", &words.join("; "));
}

/// Begins with what the incarnation before received, as far as it fits.
fn go_on(history: &mut History, rules: &Rules, stored: Result<Option<StoredHistory>, String>, moment: &Moment) {
    let does_not_count = "what was received before the restart does not count";
    // A file that is old, as each evening, is as good as none: the dwell runs, and the verdict says so.
    match stored.map(|stored| stored.map(|stored| history.restore(rules, &stored, moment))) {
        Ok(None) => {}
        Ok(Some(Ok(passed_over))) => {
            tracing::info!(left_out = passed_over.len(), "what was received before the restart counts");
            for (input, why) in passed_over {
                tracing::info!(input, why, "{does_not_count}");
            }
        }
        Ok(Some(Err(why))) => tracing::info!(why, "{does_not_count}"),
        Err(why) => tracing::warn!(why, "{does_not_count}"),
    }
}

fn take_in(history: &mut History, rules: &Rules, word: Word, speed: f64) {
    match word {
        Word::Monitor(device, heard) => match heard {
            Heard::Hole(hole) => history.miss(rules, &device, hole),
            Heard::State(state, at) => history.observe_monitor(rules, &device, &state, at),
            Heard::Recalled(states) => history.recall_monitor(rules, &device, states),
            Heard::NoRecord(refused) => history.go_without(&device, refused),
        },
        Word::Weather(device, heard) => match heard {
            Heard::Hole(hole) => history.miss(rules, &device, hole),
            Heard::State(state, at) => history.observe_weather(rules, &device, &state, speed, at),
            Heard::Recalled(states) => {
                if let Err(why) = history.recall_weather(rules, &device, states, speed) {
                    tracing::warn!(%device, why, "the record of the time before is not taken: the dwell runs");
                }
            }
            Heard::NoRecord(refused) => history.go_without(&device, refused),
        },
        Word::Switch(device, heard) => match heard {
            Heard::Hole(hole) => history.miss(rules, &device, hole),
            Heard::State(state, at) => history.observe_switch(rules, &device, &state, at),
            Heard::Recalled(states) => history.recall_switch(rules, &device, states),
            Heard::NoRecord(refused) => history.go_without(&device, refused),
        },
    }
}

/// Stores a verdict that ended, outside of the loop: no disk delays the next one.
fn keep(path: PathBuf, ended: Interval) {
    tokio::task::spawn_blocking(move || {
        if let Err(error) = verdict_file::append(&path, &ended) {
            tracing::warn!(file = %path.display(), %error, "a verdict that ended is not on disk");
        }
    });
}

/// The device and observatory nodes of this telescope and of the site's shared devices.
async fn listen_to_nodes(node: &Node) -> anyhow::Result<Vec<Subscriber<NodeState>>> {
    let own = node.config.address();
    let mut subscribers = Vec::new();
    for address in [own.shared(), own] {
        for role in [Role::Device, Role::Observatory] {
            let keys = Topic::Node(NodeTopic::State).at(&address).of_role(role);
            subscribers.push(node.bus.subscribe(keys, Catch::Newest, 64).await?);
        }
    }
    Ok(subscribers)
}

async fn recv_node(nodes: &[Subscriber<NodeState>]) -> (String, Received<NodeState>) {
    loop {
        let received =
            futures_util::future::select_all(nodes.iter().map(|subscriber| Box::pin(subscriber.recv()))).await.0;
        if let Key::Node(address, role, id, NodeTopic::State) = &received.key {
            return (format!("{}/{role}/{id}", address.telescope), received);
        }
    }
}

fn publish(
    verdict: &watch::Sender<CurrentVerdict>,
    judgement: Judgement,
    intervals: Vec<Interval>,
    settled: bool,
    clock: &Clock,
) {
    verdict.send_modify(|verdict| {
        if verdict.state.verdict != judgement.verdict {
            match judgement.verdict {
                Verdict::Safe => tracing::info!("the sky is safe"),
                Verdict::Unsafe => {
                    let first = judgement.reasons.first().map(|reason| format!("{}: {}", reason.input, reason.why));
                    tracing::warn!(why = first.unwrap_or_default(), "the sky is not safe");
                }
            }
        }
        verdict.renew(judgement, intervals, settled, clock.utc(), clock.machine());
    });
}
