//! The subscribers of the safety loop: one for each device that it rests on.
//!
//! Live states go on at once. In addition, a subscriber asks the device node for its record wherever states were
//! missed: at the first one from it, and after each hole, which a restart of the device node, a cut link or a stall of
//! this node has left. So nobody need wait again for what is known.

use std::future::Future;
use std::pin::Pin;
use std::time::Duration;

use anyhow::Context as _;
use bus::{Bus, Catch, Clock, MachineTime, Received, Subscriber};
use contract::device::observing_conditions::Fields as Weather;
use contract::device::record::{RecordQuestion, StateRecord};
use contract::device::safety_monitor::Fields as Monitor;
use contract::device::switch::Fields as Switches;
use contract::observatory::AlertKind;
use contract::{Device, DeviceState, Key, Kind, Link, Payload, Stamped};
use node::Node;
use safety::history::Now;
use safety::recall::{Asked, PlacedState, Recall};
use safety::rules::Rules;
use tokio::sync::mpsc;
use tokio::task::JoinSet;

use super::writers::{self, Manners, Writers};

/// What a subscriber passes on.
pub enum Word {
    /// Of a safety monitor.
    Monitor(Device, Heard<Monitor>),
    /// Of a weather station.
    Weather(Device, Heard<Weather>),
    /// Of a set of switches.
    Switch(Device, Heard<Switches>),
}

/// What is heard of a device.
pub enum Heard<F> {
    /// States were missed before the next one.
    Hole,
    /// A state.
    State(Box<DeviceState<F>>, Now),
    /// All states since the hole began, those that were missed among them; empty if there is no record of them.
    Recalled(Vec<PlacedState<F>>),
}

/// How a subscriber handles the devices of a kind.
struct Handling<F> {
    manners: Manners<F>,
    word: fn(Device, Heard<F>) -> Word,
}

/// A device node is asked for its record so often, after these pauses: one that was just found may not be known to
/// answer yet, and an answer may be lost or late.
const TRIES_MS: [u64; 3] = [0, 300, 800];
/// An answer that takes longer is none; with the pauses before the end of the safety loop's grace.
const TIMEOUT: Duration = Duration::from_millis(1200);

/// Starts a subscriber for each device of the rules; the channel gives what they receive.
pub async fn open(node: &Node, rules: &Rules) -> anyhow::Result<(JoinSet<()>, mpsc::Receiver<Word>)> {
    let (words, received) = mpsc::channel(256);
    let mut subscribers = JoinSet::new();
    for (device, back) in rules.look_back(node.bus.clock().speed()) {
        if device.kind == Kind::SafetyMonitor {
            let handling = Handling { manners: writers::MONITOR, word: Word::Monitor };
            subscribers.spawn(listen(node, device, &words, handling, back).await?);
        } else if device.kind == Kind::Switch {
            let handling = Handling { manners: Manners::of_values(), word: Word::Switch };
            subscribers.spawn(listen(node, device, &words, handling, back).await?);
        } else {
            let handling = Handling { manners: Manners::of_values(), word: Word::Weather };
            subscribers.spawn(listen(node, device, &words, handling, back).await?);
        }
    }
    Ok((subscribers, received))
}

/// Subscribes to a device's state and forwards each new one, with both times of its arrival.
async fn listen<F: Payload + PartialEq>(
    node: &Node,
    device: Device,
    words: &mpsc::Sender<Word>,
    handling: Handling<F>,
    back: Duration,
) -> anyhow::Result<impl Future<Output = ()> + use<F>> {
    let key = Key::State(device.clone()).to_string();
    let subscriber: Subscriber<DeviceState<F>> =
        node.bus.subscribe(&key, Catch::Newest, 256).await.with_context(|| format!("cannot subscribe to {device}"))?;
    let (words, bus, alerts) = (words.clone(), node.bus.clone(), node.alerts.clone());
    let instance = format!("{}/{}", device.kind, device.name);
    Ok(async move {
        let (mut writers, mut disputed) = (Writers::new(handling.manners), false);
        let mut past = PastStates::new(bus.clone(), device.clone(), back);
        loop {
            let heard = tokio::select! {
                received = subscriber.recv() => {
                    let mut received: Received<DeviceState<F>> = received;
                    let published = received.sample.clone();
                    let taken = writers.take(&mut received.sample, received.arrived);
                    match writers.dispute(received.arrived) {
                        Some(why) if !disputed => {
                            alerts.raise(AlertKind::SecondWriter, &instance, &format!("{device} is unsafe: {why}"));
                            disputed = true;
                        }
                        None if disputed => {
                            alerts.clear(AlertKind::SecondWriter, &instance);
                            disputed = false;
                        }
                        Some(_) | None => {}
                    }
                    if !taken {
                        continue;
                    }
                    let (at, body) = (arrival(bus.clock(), received.arrived), received.sample.body);
                    if past.observe(published, &body.link, at)
                        && words.send((handling.word)(device.clone(), Heard::Hole)).await.is_err()
                    {
                        return;
                    }
                    Heard::State(Box::new(body), at)
                }
                states = past.states() => Heard::Recalled(states),
            };
            if words.send((handling.word)(device.clone(), heard)).await.is_err() {
                return;
            }
        }
    })
}

/// Both times of an arrival: what waited in the queue is as old as it is.
fn arrival(clock: &Clock, arrived: MachineTime) -> Now {
    let queued = clock.machine().since(arrived).mul_f64(clock.speed());
    Now { sky: clock.sky().minus(queued), machine: arrived }
}

type RecordAnswer<F> = Result<(StateRecord<F>, Asked), String>;

/// What was missed of a device, and the question for it.
struct PastStates<F> {
    bus: Bus,
    device: Device,
    back: Duration,
    recall: Recall<F>,
    tries: std::slice::Iter<'static, u64>,
    asking: Option<Pin<Box<dyn Future<Output = RecordAnswer<F>> + Send>>>,
}

impl<F: Payload + PartialEq> PastStates<F> {
    fn new(bus: Bus, device: Device, back: Duration) -> Self {
        Self { bus, device, back, recall: Recall::default(), tries: [].iter(), asking: None }
    }

    /// A live state as its node published it, and what this node makes of its link; true where a hole ends with it, and
    /// the node is asked.
    fn observe(&mut self, published: Stamped<DeviceState<F>>, link: &Link, at: Now) -> bool {
        let body = DeviceState { link: link.clone(), ..published.body };
        let has_missed = self.recall.observe(&Stamped { body, ..published }, at);
        if has_missed {
            self.tries = TRIES_MS.iter();
            self.ask();
        }
        has_missed
    }

    fn ask(&mut self) {
        let Some(pause_ms) = self.tries.next() else { return };
        let (bus, device, pause) = (self.bus.clone(), self.device.clone(), Duration::from_millis(*pause_ms));
        let now = arrival(bus.clock(), bus.clock().machine());
        let question = RecordQuestion { back_s: self.recall.back(now, self.back, bus.clock().speed()).as_secs_f64() };
        self.asking = Some(Box::pin(async move {
            tokio::time::sleep(pause).await;
            let asked = bus.clock().machine();
            let record = bus.ask(&Key::Record(device), &question, TIMEOUT).await.map_err(|error| error.to_string())?;
            let answered = arrival(bus.clock(), bus.clock().machine());
            Ok((record, Asked { at: asked, answered, speed: bus.clock().speed() }))
        }));
    }

    /// Waits for all states since the hole; empty if there is no record of them, or none that can be taken.
    ///
    /// May be dropped and called again.
    async fn states(&mut self) -> Vec<PlacedState<F>> {
        loop {
            let Some(asking) = &mut self.asking else { std::future::pending().await };
            let answer = asking.as_mut().await;
            self.asking = None;
            let refused = match answer.and_then(|(record, asked)| self.recall.place(&record, asked)) {
                Ok(states) => {
                    tracing::info!(device = %self.device, states = states.len(), "its node recorded what was missed");
                    self.recall.close();
                    return states;
                }
                Err(why) => why,
            };
            self.ask();
            if self.asking.is_none() {
                tracing::warn!(device = %self.device, why = refused, "no record of what was missed: it was silence");
                self.recall.close();
                return Vec::new();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use bus::{Publisher, Quality, Service};
    use contract::device::record::{EarlierStates, StateEntry};
    use contract::{BootId, Datum, Role};
    use serde_json::Value;
    use test_support::{ALPHA, LIMIT, block, join, private_bus};

    use super::*;

    fn state() -> DeviceState<Monitor> {
        DeviceState {
            link: Link::Connected,
            busy: false,
            period_s: 1.0,
            poll_s: None,
            last_command: None,
            fields: Monitor { is_safe: Datum::Known(true), gapless_safe_s: 7.0 },
            readings: Default::default(),
        }
    }

    /// A device node that publishes one state, and answers with it after those that an earlier incarnation published.
    async fn device_node(
        bus: &Bus,
        device: &Device,
        earlier: Option<(BootId, Vec<MachineTime>)>,
    ) -> (Publisher<DeviceState<Monitor>>, Service) {
        let (boot_id, clock) = (bus.boot_id().clone(), bus.clock().clone());
        let own = [clock.machine()];
        let answer = move |_: Result<RecordQuestion, String>| {
            let entries = |times: &[MachineTime]| {
                let entry = |(seq, at): (u64, &MachineTime)| StateEntry {
                    seq,
                    age_s: clock.machine().since(*at).as_secs_f64(),
                    reading_ages_s: Default::default(),
                    link: Link::Connected,
                    fields: state().fields,
                };
                (0..).zip(times).map(entry).collect::<Vec<_>>()
            };
            let earlier = earlier
                .iter()
                .map(|(boot_id, times)| EarlierStates { boot_id: boot_id.clone(), entries: entries(times) });
            let earlier = earlier.collect();
            let record = StateRecord { boot_id: boot_id.clone(), speed: 1.0, entries: entries(&own), earlier };
            let answer = serde_json::to_value(record).unwrap();
            async move { answer }
        };
        let service = bus.serve::<RecordQuestion, Value, _, _>(&Key::Record(device.clone()), answer).await.unwrap();
        let key = Key::State(device.clone());
        let states = bus.publisher_as(&key, Quality::State { cache: 1 }).await.unwrap();
        states.put(state()).await.unwrap();
        (states, service)
    }

    /// Receives a hole, the state after it and what was recalled: the number of states, and the length of the record for
    /// which the newest one is believed.
    async fn after_a_hole(received: &mut mpsc::Receiver<Word>) -> (usize, f64) {
        let mut next = async || match tokio::time::timeout(LIMIT, received.recv()).await.unwrap().unwrap() {
            Word::Monitor(_, heard) => heard,
            Word::Weather(..) | Word::Switch(..) => panic!("there is no such device"),
        };
        assert!(matches!(next().await, Heard::Hole));
        let Heard::State(state, _) = next().await else { panic!("no state") };
        let Heard::Recalled(states) = next().await else { panic!("not asked") };
        (states.len(), state.fields.gapless_safe_s)
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_device_node_is_asked_for_what_was_missed_also_by_one_that_goes_on_listening() {
        let folder = tempfile::tempdir().unwrap();
        let text = format!("{ALPHA}{}", block("safetymonitor", "m", "a:1", ""));
        let config = config::parse(&text, folder.path()).unwrap();
        let (rules, device) = (Rules::of(&config), config.device(Kind::SafetyMonitor, &"m".parse().unwrap()));
        let bus = private_bus(Clock::machine_clock()).await;
        let (first, second) = (join(&bus).await, join(&bus).await);
        let node = Node::new(Role::Observatory, "main".parse().unwrap(), config, Default::default(), bus);

        let began = first.clock().machine();
        let running = device_node(&first, &device, None).await;
        let (_subscribers, mut received) = open(&node, &rules).await.unwrap();
        assert_eq!(after_a_hole(&mut received).await, (1, 7.0), "its first state is all that it knows");
        drop(running);
        let boot_id = first.boot_id().clone();
        first.close().await;

        // Before its end it published one more, which came nowhere; the next incarnation has both on its disk.
        let earlier = Some((boot_id, vec![began, second.clock().machine()]));
        let _running = device_node(&second, &device, earlier).await;
        assert_eq!(after_a_hole(&mut received).await, (2, 0.0), "the one that was missed, and the first one after it");
    }
}
