//! The safety loop: hears the inputs, judges at each arrival and each second, and waits for nothing else.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use bus::{Catch, Clock, Heard, Node, Subscriber, Succession};
use contract::device::observing_conditions::Fields as Weather;
use contract::device::safety_monitor::Fields as Monitor;
use contract::device::switch::Fields as Switches;
use contract::node::NodeState;
use contract::observatory::{AlertKind, Interval, SafetyState, Verdict};
use contract::{Device, DeviceState, Key, Kind, NodeTopic, Payload, Role};
use sky::{EarthOrientation, Observer, Place};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;
use units::Angle;

use super::Ruling;
use super::heard::History;
use super::history::Now;
use super::intervals::{self, Intervals};
use super::judge::{Judgement, judge};
use super::rules::Rules;
use crate::standing::Standing;

/// So long after its start a node may be without a word from an input before that counts.
const GRACE: Duration = Duration::from_secs(5);

/// A state of a safety input.
enum Word {
    Monitor(Device, Box<DeviceState<Monitor>>, Now),
    Weather(Device, Box<DeviceState<Weather>>, Now),
    Switch(Device, Box<DeviceState<Switches>>, Now),
}

/// Judges until the node ends; the ruling is all that leaves this task.
pub async fn keep_judging(
    node: Node,
    rules: Arc<Rules>,
    mut standing: watch::Receiver<Standing>,
    ruling: watch::Sender<Ruling>,
) -> anyhow::Result<()> {
    let clock = node.bus.clock().clone();
    let (words, mut heard) = mpsc::channel(256);
    let mut ears = JoinSet::new();
    let mut devices: Vec<Device> = rules.monitors.iter().map(|rule| rule.device.clone()).collect();
    devices.dedup();
    for device in devices {
        ears.spawn(listen(&node, device, &words, Word::Monitor).await?);
    }
    let mut devices: Vec<Device> = rules.limits.iter().map(|rule| rule.device.clone()).collect();
    devices.dedup();
    for device in devices {
        match device.kind {
            Kind::Switch => ears.spawn(listen(&node, device, &words, Word::Switch).await?),
            _ => ears.spawn(listen(&node, device, &words, Word::Weather).await?),
        };
    }
    let nodes = listen_to_nodes(&node).await?;

    for (input, why) in &rules.disabled {
        node.alerts.raise(AlertKind::Disabled, input, &format!("{input} is disabled: {why}"));
    }
    let started = now(&clock);
    let mut history = History::new(&rules, started.sky);
    let past = intervals::path(&node.config);
    let read = past.clone();
    let mut past_verdicts = tokio::task::spawn_blocking(move || Intervals::read(&read)).await?;
    loop {
        history.sun_altitude_deg = sun_altitude_deg(&node.config, &clock);
        let effective = standing.borrow_and_update().applied_to(&rules, clock.utc());
        let judgement = judge(&effective, &history, now(&clock));
        let waited = now(&clock).machine.since(started.machine) >= GRACE;
        let settled = waited || history.all_heard() || judgement.speaks_against;
        if settled && let Some(ended) = past_verdicts.judge(judgement.verdict, &judgement.reasons, clock.utc()) {
            keep(past.clone(), ended);
        }
        publish(&ruling, judgement, past_verdicts.shown(), settled, &clock);
        tokio::select! {
            (name, state) = hear_node(&nodes) => {
                let own = clock.utc();
                history.nodes.hear(name, &state.said.body, state.said.at_utc, own, state.arrived);
            }
            word = heard.recv() => {
                let Some(word) = word else { anyhow::bail!("the ears of the safety loop are gone") };
                take_in(&mut history, &rules, word, clock.speed());
                // all that waits, before judging once
                while let Ok(word) = heard.try_recv() {
                    take_in(&mut history, &rules, word, clock.speed());
                }
            }
            changed = standing.changed() => changed?,
            () = clock.tick(Duration::from_secs(1)) => {}
        }
    }
}

fn sun_altitude_deg(config: &config::Observatory, clock: &Clock) -> Result<f64, String> {
    let place = &config.place;
    let (latitude, longitude) = (Angle::from_degrees(place.latitude_deg), Angle::from_degrees(place.longitude_deg));
    let place = Place::new(latitude, longitude, place.elevation_m);
    let observer = place.and_then(|place| Observer::new(&place, &EarthOrientation::default(), clock.utc()));
    observer.map(|observer| observer.sun().altitude.degrees()).map_err(|error| error.to_string())
}

fn now(clock: &Clock) -> Now {
    Now { sky: clock.sky(), machine: clock.machine() }
}

fn take_in(history: &mut History, rules: &Rules, word: Word, speed: f64) {
    match word {
        Word::Monitor(device, state, at) => history.hear_monitor(rules, &device, &state, at),
        Word::Weather(device, state, at) => history.hear_weather(rules, &device, &state, speed, at),
        Word::Switch(device, state, at) => history.hear_switch(rules, &device, &state, at),
    }
}

/// Keeps a verdict that ended, beside the loop: no disk delays the next one.
fn keep(path: PathBuf, ended: Interval) {
    tokio::task::spawn_blocking(move || {
        if let Err(error) = intervals::append(&path, &ended) {
            tracing::warn!(file = %path.display(), %error, "a verdict that ended is not on disk");
        }
    });
}

/// The device and observatory nodes of this telescope and of the site's shared devices.
async fn listen_to_nodes(node: &Node) -> anyhow::Result<Vec<Subscriber<NodeState>>> {
    let own = node.config.address();
    let mut ears = Vec::new();
    for address in [own.shared(), own] {
        for role in [Role::Device, Role::Observatory] {
            let keys = format!("{}/{address}/node/{role}/*/{}", contract::key::ROOT, NodeTopic::State.word());
            ears.push(node.bus.subscribe(&keys, Catch::Newest, 64).await?);
        }
    }
    Ok(ears)
}

async fn hear_node(nodes: &[Subscriber<NodeState>]) -> (String, Heard<NodeState>) {
    loop {
        let heard = futures_util::future::select_all(nodes.iter().map(|ear| Box::pin(ear.hear()))).await.0;
        if let Key::Node(address, role, id, NodeTopic::State) = &heard.key {
            return (format!("{}/{role}/{id}", address.telescope), heard);
        }
    }
}

fn publish(
    ruling: &watch::Sender<Ruling>,
    judgement: Judgement,
    intervals: Vec<Interval>,
    settled: bool,
    clock: &Clock,
) {
    ruling.send_modify(|ruling| {
        if ruling.state.verdict != judgement.verdict {
            match judgement.verdict {
                Verdict::Safe => tracing::info!("the sky is safe"),
                Verdict::Unsafe => {
                    let first = judgement.reasons.first().map(|reason| format!("{}: {}", reason.input, reason.why));
                    tracing::warn!(why = first.unwrap_or_default(), "the sky is not safe");
                }
            }
            ruling.state.since_utc = clock.utc();
        }
        ruling.state = SafetyState {
            verdict: judgement.verdict,
            since_utc: ruling.state.since_utc,
            reasons: judgement.reasons,
            suspended: judgement.suspended,
            advisories: judgement.advisories,
            time_to_safe_s: judgement.time_to_safe_s,
            inputs: judgement.inputs,
            avoid: judgement.avoid,
            intervals,
        };
        ruling.judged = clock.machine();
        ruling.settled |= settled;
    });
}

/// Subscribes to a device's state and forwards each new one, with both times of its arrival.
async fn listen<F: Payload>(
    node: &Node,
    device: Device,
    words: &mpsc::Sender<Word>,
    word: fn(Device, Box<DeviceState<F>>, Now) -> Word,
) -> anyhow::Result<impl Future<Output = ()> + use<F>> {
    let key = Key::State(device.clone()).to_string();
    let subscriber: Subscriber<DeviceState<F>> =
        node.bus.subscribe(&key, Catch::Newest, 256).await.with_context(|| format!("cannot hear {device}"))?;
    let (words, clock) = (words.clone(), node.bus.clock().clone());
    Ok(async move {
        let mut succession = Succession::default();
        loop {
            let heard: Heard<DeviceState<F>> = subscriber.hear().await;
            if !succession.is_newer(&heard.said.boot_id, heard.said.seq, heard.arrived) {
                continue;
            }
            // what waited in the queue is as old as it is
            let queued = clock.machine().since(heard.arrived).mul_f64(clock.speed());
            let start = bus::SkyTime::from_start(Duration::ZERO);
            let sky = bus::SkyTime::from_start(clock.sky().since(start).saturating_sub(queued));
            let at = Now { sky, machine: heard.arrived };
            if words.send(word(device.clone(), Box::new(heard.said.body), at)).await.is_err() {
                return;
            }
        }
    })
}
