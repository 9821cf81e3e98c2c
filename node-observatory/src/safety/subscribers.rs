//! The subscribers of the safety loop: one for each device that it rests on.
//!
//! Live states go on at once. In addition, a subscriber asks the device node for its record wherever states were
//! missed: at the first one from it, and after each hole, which a restart of the device node, a cut link or a stall of
//! this node has left. So nobody need wait again for what is known. A dome that is shut waits for the answer.

use std::future::Future;
use std::pin::Pin;
use std::time::Duration;

use anyhow::Context as _;
use bus::{AskError, Bus, Catch, Clock, MachineTime, Received, Subscriber};
use contract::device::observing_conditions::Fields as Weather;
use contract::device::record::{RecordQuestion, StateRecord};
use contract::device::safety_monitor::Fields as Monitor;
use contract::device::switch::Fields as Switches;
use contract::observatory::AlertKind;
use contract::{Device, DeviceState, Key, Kind, Link, Payload, Stamped};
use node::Node;
use safety::history::Now;
use safety::missed::Hole;
use safety::recall::{Asked, NotTaken, PlacedState, Recall};
use safety::rules::Rules;
use tokio::sync::mpsc;
use tokio::task::JoinSet;

use super::failed_questions::FailedQuestions;
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
    /// States were missed before the next one, and their node is asked.
    Hole(Hole),
    /// A state.
    State(Box<DeviceState<F>>, Now),
    /// All states since the hole began, those that were missed among them.
    Recalled(Vec<PlacedState<F>>),
    /// There is no record of them, or one that says something against what was received: then what, and when that was
    /// known.
    NoRecord(Option<(String, Now)>),
}

/// How a subscriber handles the devices of a kind.
struct Handling<F> {
    manners: Manners<F>,
    word: fn(Device, Heard<F>) -> Word,
}

/// A device node is asked for its record so often for each hole, after these pauses and one that grows with the holes that
/// it does not explain: one that was just found may not be known to answer yet, and an answer may be lost or late.
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
                    let Some(at) = arrival(bus.clock(), received.arrived) else { continue };
                    let body = received.sample.body;
                    if let Some(hole) = past.observe(published, &body.link, at)
                        && words.send((handling.word)(device.clone(), Heard::Hole(hole))).await.is_err()
                    {
                        return;
                    }
                    Heard::State(Box::new(body), at)
                }
                heard = past.answered() => heard,
            };
            if words.send((handling.word)(device.clone(), heard)).await.is_err() {
                return;
            }
        }
    })
}

/// Both times now.
pub fn now(clock: &Clock) -> Now {
    Now { sky: clock.sky(), machine: clock.machine() }
}

/// Both times of an arrival: what waited in the queue is as old as it is. What was held since before this machine was
/// started would look as young as the machine, so it has none.
fn arrival(clock: &Clock, arrived: MachineTime) -> Option<Now> {
    let queued = clock.machine().since(arrived).mul_f64(clock.speed());
    let is_of_this_boot = arrived > MachineTime::from_boot(Duration::ZERO);
    is_of_this_boot.then(|| Now { sky: clock.sky().minus(queued), machine: arrived })
}

type RecordAnswer<F> = Result<(StateRecord<F>, Asked), AskError>;

/// What was missed of a device, and the question for it.
struct PastStates<F> {
    bus: Bus,
    device: Device,
    back: Duration,
    recall: Recall<F>,
    failed: FailedQuestions,
    /// What the last answer to this question that was one said against what was received.
    refused: Option<String>,
    tries: std::slice::Iter<'static, u64>,
    asking: Option<Pin<Box<dyn Future<Output = RecordAnswer<F>> + Send>>>,
}

impl<F: Payload + PartialEq> PastStates<F> {
    fn new(bus: Bus, device: Device, back: Duration) -> Self {
        let (recall, failed) = (Recall::default(), FailedQuestions::default());
        Self { bus, device, back, recall, failed, refused: None, tries: [].iter(), asking: None }
    }

    /// A live state as its node published it, and what this node makes of its link; gives the hole that ends with it, for
    /// which the node is asked.
    fn observe(&mut self, published: Stamped<DeviceState<F>>, link: &Link, at: Now) -> Option<Hole> {
        let body = DeviceState { link: link.clone(), ..published.body };
        if !self.recall.observe(&Stamped { body, ..published }, at) {
            return None;
        }
        self.tries = TRIES_MS.iter();
        self.refused = None;
        self.ask();
        self.recall.hole()
    }

    /// The pause before the next question, if there is to be one.
    fn pause(&mut self, now: MachineTime) -> Option<Duration> {
        let pause_ms = self.tries.next()?;
        Some(self.failed.pause(now) + Duration::from_millis(*pause_ms))
    }

    fn ask(&mut self) {
        let (bus, device) = (self.bus.clone(), self.device.clone());
        let (now, speed) = (now(bus.clock()), bus.clock().speed());
        let Some(pause) = self.pause(now.machine) else { return };
        let then = Now { sky: now.sky.plus(pause.mul_f64(speed)), machine: now.machine.plus(pause) };
        let question = RecordQuestion { back_s: self.recall.back(then, self.back, speed).as_secs_f64() };
        self.asking = Some(Box::pin(async move {
            tokio::time::sleep(pause).await;
            let asked = bus.clock().machine();
            let record = bus.ask(&Key::Record(device), &question, TIMEOUT).await?;
            Ok((record, Asked { at: asked, answered: self::now(bus.clock()), speed }))
        }));
    }

    /// Waits for all states since the hole, or until it is known that there is no record of them that can be taken.
    ///
    /// May be dropped and called again.
    async fn answered(&mut self) -> Heard<F> {
        loop {
            let Some(asking) = &mut self.asking else { std::future::pending().await };
            let answer = asking.as_mut().await;
            self.asking = None;
            let placed = answer.map(|(record, asked)| self.recall.place(&record, asked));
            let is_silence = matches!(placed, Err(AskError::Unknown { .. }) | Ok(Err(NotTaken::Untimely(_))));
            let why = match placed {
                Ok(Ok(states)) => {
                    self.recall.close();
                    let failed_before = self.failed.end();
                    let device = &self.device;
                    tracing::info!(%device, states = states.len(), failed_before, "its node recorded what was missed");
                    return Heard::Recalled(states);
                }
                Ok(Err(NotTaken::Untimely(why) | NotTaken::Contradicts(why))) => why,
                Err(error) => error.to_string(),
            };
            if !is_silence {
                self.refused = Some(why.clone());
            }
            self.ask();
            if self.asking.is_none() {
                self.recall.close();
                return Heard::NoRecord(self.fail(&why));
            }
        }
    }

    /// Nothing is to be had; gives what an answer said against what was received, if one did. Of a run of failures the first
    /// is logged.
    fn fail(&mut self, why: &str) -> Option<(String, Now)> {
        let (now, device) = (now(self.bus.clock()), &self.device);
        let refused = self.refused.take();
        match (self.failed.fail(now.machine), &refused) {
            (true, Some(why)) => {
                tracing::warn!(%device, why, "what was missed is not known: a shut dome waits its dwell after it");
            }
            (true, None) => tracing::warn!(%device, why, "no record of what was missed: it was silence"),
            (false, _) => tracing::debug!(%device, why, "again no record of what was missed"),
        }
        refused.map(|why| (why, now))
    }
}

#[cfg(test)]
mod tests {
    use bus::{Publisher, Quality, Service};
    use contract::device::record::{EarlierStates, StateEntry};
    use contract::{BootId, Datum, Role};
    use futures_util::FutureExt as _;
    use safety::reading::state;
    use serde_json::Value;
    use test_support::{ALPHA, LIMIT, block, join, private_bus};

    use super::*;

    fn safe() -> DeviceState<Monitor> {
        state(Link::Connected, Monitor { is_safe: Datum::Known(true), gapless_safe_s: 7.0 })
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
            let now = clock.machine();
            let entries = |times: &[MachineTime]| {
                let entry = |(seq, at): (u64, &MachineTime)| StateEntry {
                    seq,
                    age_s: now.since(*at).as_secs_f64(),
                    reading_ages_s: Default::default(),
                    link: Link::Connected,
                    fields: safe().fields,
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
        states.put(safe()).await.unwrap();
        (states, service)
    }

    /// Receives a hole, the state after it and what was recalled: the number of states, and the length of the record for
    /// which the newest one is believed.
    async fn after_a_hole(received: &mut mpsc::Receiver<Word>) -> (usize, f64) {
        let mut next = async || match tokio::time::timeout(LIMIT, received.recv()).await.unwrap().unwrap() {
            Word::Monitor(_, heard) => heard,
            Word::Weather(..) | Word::Switch(..) => panic!("there is no such device"),
        };
        assert!(matches!(next().await, Heard::Hole(_)));
        let Heard::State(state, _) = next().await else { panic!("no state") };
        let states = match next().await {
            Heard::Recalled(states) => states,
            Heard::NoRecord(why) => panic!("no record is taken: {:?}", why.map(|(why, _)| why)),
            Heard::Hole(_) | Heard::State(..) => panic!("not asked"),
        };
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

    #[test]
    fn what_was_held_since_before_the_boot_of_this_host_has_no_time() {
        let clock = Clock::machine_clock();
        assert_eq!(arrival(&clock, MachineTime::from_boot(Duration::ZERO)), None);
        assert_eq!(arrival(&clock, clock.machine()).map(|at| at.machine <= clock.machine()), Some(true));
    }

    fn monitor() -> Device {
        contract::Address::new("s", "t").unwrap().device(Kind::SafetyMonitor, &"m".parse().unwrap())
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn an_answer_that_contradicts_is_told_and_the_next_question_waits() {
        let device = monitor();
        let bus = private_bus(Clock::machine_clock()).await;
        let other = join(&bus).await;
        let _running = device_node(&other, &device, None).await;
        let states: Subscriber<DeviceState<Monitor>> =
            bus.subscribe(&Key::State(device.clone()).to_string(), Catch::Newest, 4).await.unwrap();
        let mut sample = tokio::time::timeout(LIMIT, states.recv()).await.unwrap().sample;
        // Its record ends before.
        sample.seq = 5;
        let mut past = PastStates::<Monitor>::new(bus.clone(), device, Duration::from_secs(600));
        assert!(past.observe(sample, &Link::Connected, now(bus.clock())).is_some());
        let heard = tokio::time::timeout(LIMIT, past.answered()).await.unwrap();
        let Heard::NoRecord(Some((why, at))) = heard else { panic!("its answer contradicts what was received") };
        assert_eq!(why, "it does not reach the first state that was received here");
        past.tries = TRIES_MS.iter();
        assert_eq!(past.pause(at.machine), Some(Duration::from_secs(1)));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn only_an_answer_against_what_was_received_is_more_than_silence() {
        let bus = private_bus(Clock::machine_clock()).await;
        let (key, boot_id, at) = (|| "a key".to_owned(), BootId::fresh(), now(bus.clock()));
        let sample =
            |boot_id| Stamped { boot_id, seq: 5, at_utc: units::Utc::EPOCH, sent_s: None, held_s: None, body: safe() };
        let answer = |boot_id: &BootId, took: Duration| {
            let (link, fields) = (Link::Connected, safe().fields);
            let entry =
                StateEntry { seq: 5, age_s: took.as_secs_f64(), reading_ages_s: Default::default(), link, fields };
            let record =
                StateRecord { boot_id: boot_id.clone(), speed: 1.0, entries: vec![entry], earlier: Vec::new() };
            let answered = Now { sky: at.sky.plus(took), machine: at.machine.plus(took) };
            Ok((record, Asked { at: at.machine, answered, speed: 1.0 }))
        };
        let rows: [(RecordAnswer<Monitor>, bool); 5] = [
            (Err(AskError::Unknown { key: key(), timeout_s: 1.2 }), false),
            (answer(&boot_id, Duration::from_secs(2)), false),
            (answer(&BootId::fresh(), Duration::ZERO), true),
            (Err(AskError::Contested { key: key(), count: 2 }), true),
            (Err(AskError::Unreadable { key: key(), detail: "half of it".to_owned() }), true),
        ];
        for (answer, is_more) in rows {
            let words = format!("{answer:?}");
            let mut past = PastStates::<Monitor>::new(bus.clone(), monitor(), Duration::from_secs(600));
            assert!(past.observe(sample(boot_id.clone()), &Link::Connected, at).is_some());
            // The only answer, in place of one by the bus.
            past.asking = Some(Box::pin(async move { answer }));
            past.tries = [].iter();
            let Some(Heard::NoRecord(refused)) = past.answered().now_or_never() else { panic!("{words}") };
            assert_eq!(refused.is_some(), is_more, "{words}");
        }
    }
}
