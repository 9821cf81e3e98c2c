//! The subscribers of the safety loop: one for each device that it rests on.
//!
//! Live states go on at once. In addition, a subscriber asks the device node, at the first state from it, for the
//! record of the time before, so that a restarted observatory need not wait again for what is known.

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
use contract::{Device, DeviceState, Key, Kind, Payload, Stamped};
use node::Node;
use safety::history::Now;
use safety::recall::{Asked, PlacedState, Recall};
use safety::rules::Rules;
use tokio::sync::mpsc;
use tokio::task::JoinSet;

use super::writers::{self, Manners, Writers};

/// What a subscriber passes on.
pub enum Word {
    /// A state of a safety monitor.
    Monitor(Device, Box<DeviceState<Monitor>>, Now),
    /// A state of a weather station.
    Weather(Device, Box<DeviceState<Weather>>, Now),
    /// A state of a set of switches.
    Switch(Device, Box<DeviceState<Switches>>, Now),
    /// All states of a weather station, from before this node subscribed and since; empty if there was no record.
    WeatherBefore(Device, Vec<PlacedState<Weather>>),
    /// The same of a set of switches.
    SwitchBefore(Device, Vec<PlacedState<Switches>>),
}

/// Makes a `Word` of all states of a device.
type Retell<F> = fn(Device, Vec<PlacedState<F>>) -> Word;

/// How a subscriber handles the devices of a kind.
struct Handling<F> {
    manners: Manners<F>,
    state: fn(Device, Box<DeviceState<F>>, Now) -> Word,
    before: Option<Retell<F>>,
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
    let mut monitors: Vec<&Device> = rules.monitors.iter().map(|rule| &rule.device).collect();
    monitors.dedup();
    for device in monitors {
        let handling = Handling { manners: writers::MONITOR, state: Word::Monitor, before: None };
        subscribers.spawn(listen(node, device.clone(), &words, handling, Duration::ZERO).await?);
    }
    for (device, back) in rules.look_back(node.bus.clock().speed()) {
        if device.kind == Kind::Switch {
            let handling =
                Handling { manners: Manners::of_values(), state: Word::Switch, before: Some(Word::SwitchBefore) };
            subscribers.spawn(listen(node, device, &words, handling, back).await?);
        } else {
            let handling =
                Handling { manners: Manners::of_values(), state: Word::Weather, before: Some(Word::WeatherBefore) };
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
        let mut before = handling.before.map(|word| (word, PastStates::new(bus.clone(), device.clone(), back)));
        loop {
            tokio::select! {
                received = subscriber.recv() => {
                    let mut received: Received<DeviceState<F>> = received;
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
                    let at = arrival(bus.clock(), received.arrived);
                    if let Some((_, before)) = &mut before {
                        before.observe(&received.sample, at);
                    }
                    let word = (handling.state)(device.clone(), Box::new(received.sample.body), at);
                    if words.send(word).await.is_err() {
                        return;
                    }
                }
                (word, placed_states) = placed_states(&mut before) => {
                    before = None;
                    if words.send(word(device.clone(), placed_states)).await.is_err() {
                        return;
                    }
                }
            }
        }
    })
}

/// Both times of an arrival: what waited in the queue is as old as it is.
fn arrival(clock: &Clock, arrived: MachineTime) -> Now {
    let queued = clock.machine().since(arrived).mul_f64(clock.speed());
    Now { sky: clock.sky().minus(queued), machine: arrived }
}

/// Waits for the record, where one is awaited.
async fn placed_states<F: Payload + PartialEq, W: Copy>(
    before: &mut Option<(W, PastStates<F>)>,
) -> (W, Vec<PlacedState<F>>) {
    match before {
        Some((word, before)) => (*word, before.placed_states().await),
        None => std::future::pending().await,
    }
}

type RecordAnswer<F> = Result<(StateRecord<F>, Asked), String>;

/// The time before, while a device node is asked for it.
struct PastStates<F> {
    bus: Bus,
    device: Device,
    back: Duration,
    /// For the first incarnation that is received; a later one knows no more than was received live.
    recall: Option<Recall<F>>,
    over: bool,
    tries: std::slice::Iter<'static, u64>,
    asking: Option<Pin<Box<dyn Future<Output = RecordAnswer<F>> + Send>>>,
}

impl<F: Payload + PartialEq> PastStates<F> {
    fn new(bus: Bus, device: Device, back: Duration) -> Self {
        Self { bus, device, back, recall: None, over: false, tries: TRIES_MS.iter(), asking: None }
    }

    /// A live state; the first one is when the node is asked.
    fn observe(&mut self, sample: &Stamped<DeviceState<F>>, at: Now) {
        match &mut self.recall {
            Some(recall) => self.over |= !recall.observe(sample, at),
            None => {
                self.recall = Some(Recall::new(sample, at));
                self.ask();
            }
        }
    }

    fn ask(&mut self) {
        let Some(pause_ms) = self.tries.next() else { return };
        let (bus, device, pause) = (self.bus.clone(), self.device.clone(), Duration::from_millis(*pause_ms));
        let question = RecordQuestion { back_s: self.back.as_secs_f64() };
        self.asking = Some(Box::pin(async move {
            tokio::time::sleep(pause).await;
            let asked = bus.clock().machine();
            let record = bus.ask(&Key::Record(device), &question, TIMEOUT).await.map_err(|error| error.to_string())?;
            let answered = arrival(bus.clock(), bus.clock().machine());
            Ok((record, Asked { at: asked, answered, speed: bus.clock().speed() }))
        }));
    }

    /// Waits for all states up to now; empty if there is no record, or none that can be taken.
    ///
    /// May be dropped and called again.
    async fn placed_states(&mut self) -> Vec<PlacedState<F>> {
        loop {
            let Some(asking) = &mut self.asking else { std::future::pending().await };
            let answer = asking.as_mut().await;
            self.asking = None;
            let Some(recall) = self.recall.as_ref().filter(|_| !self.over) else {
                tracing::info!(device = %self.device, "its node was restarted: the dwell runs");
                return Vec::new();
            };
            let refused = match answer.and_then(|(record, asked)| recall.place(&record, asked)) {
                Ok(states) => {
                    tracing::info!(device = %self.device, states = states.len(), "its node answers about the time before");
                    return states;
                }
                Err(why) => why,
            };
            self.ask();
            if self.asking.is_none() {
                tracing::warn!(device = %self.device, why = refused, "no record of the time before: the dwell runs");
                return Vec::new();
            }
        }
    }
}
