//! The one loop for all kinds: connects, polls, publishes, executes commands, reconnects.
//!
//! Each device has a task of its own, so a hung one delays no other. Within the task nothing is awaited but the
//! `select!`: it takes a command, the answer to a command, the answer to a poll and the timers in any order, so that a
//! command that makes safe waits for no request that hangs, except for [`STOP_TURN`] for a stop before it: two stops are
//! sent one after the other, and none drops the other.

mod command;
mod contradiction;
mod silence;
mod slowness;
mod turns;
mod unread;

use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use alpaca::{Abilities, Alpaca, AlpacaError};
use bus::Publisher;
use config::Common;
use contract::audit::AuditOutcome as Ended;
use contract::device::DeviceDescription;
use contract::observatory::AlertKind;
use contract::{Device, DeviceKind as _, DeviceState, Key, LastCommand, Link};
use node::{Looks, Node};
use tokio::sync::mpsc;
use tokio::task::{JoinError, JoinSet};
use tokio::time::{Instant, sleep_until};

use self::command::RunningCommand;
use self::contradiction::Contradiction;
use self::silence::SilentPolls;
use self::unread::ReadingAgain;
use crate::command_server::{CommandServer, Order};
use crate::driver::{Capabilities, Command, Driver, Executed, Fields};
use crate::has::Has;
use crate::now::Now;
use crate::polling::{Greeting, Poll, PropertyAnswer, Questions};
use crate::readings::Readings;
use crate::record::StatePublisher;

/// While something moves or exposes.
const FAST: Duration = Duration::from_millis(100);
/// A device that is busy for so long without a command is polled at leisure again.
const BUSY_LIMIT: Duration = Duration::from_secs(600);
/// A state is published at least so often.
const PUBLISH_EVERY: Duration = Duration::from_secs(5);
/// Capabilities are published so often.
const CAPABILITIES: Duration = Duration::from_secs(10);
/// States kept for those who were away, in addition to those at the poll period: so many changes per minute.
const CHANGES_PER_MIN: f64 = 60.0;
/// Longest wait before the next try to connect.
const LONGEST_BACK_OFF_S: f64 = 30.0;

/// A stop waits no longer for the answer to the stop before it, which then goes on beside it.
const STOP_TURN: Duration = Duration::from_secs(1);

type Task<T> = Option<Pin<Box<dyn Future<Output = T> + Send>>>;

enum Polling<D: Driver> {
    Greeted(Result<Greeting<D>, AlpacaError>),
    Polled(Poll),
}

/// One device and all that its loop needs.
pub struct Serve<D: Driver> {
    /// The node.
    pub node: Node,
    /// The device on the bus.
    pub device: Device,
    /// Its block of the configuration.
    pub common: Common,
    /// How many devices were started before; spreads the polls.
    pub index: u32,
    /// Its driver.
    pub driver: Arc<D>,
    /// Its server.
    pub alpaca: Alpaca,
    /// Where its commands are taken.
    pub command_server: Arc<CommandServer<D>>,
    /// Polled rows of the FITS-header table.
    pub polled: Vec<String>,
    /// Fixed rows of it.
    pub fixed: Vec<String>,
}

struct Loop<D: Driver> {
    serve: Serve<D>,
    states: StatePublisher<Fields<D>>,
    descriptions: Publisher<DeviceDescription<Capabilities<D>>>,
    readings: Readings,
    link: Link,
    device_state: bool,
    has: Has,
    description: Option<DeviceDescription<Capabilities<D>>>,
    last_command: Option<LastCommand>,
    running: Option<RunningCommand<D>>,
    job: Task<Result<Executed, AlpacaError>>,
    /// What the device can do is read again, where some of it could not be read.
    reading_again: ReadingAgain<D>,
    contradiction: Contradiction,
    /// Until then the stops below wait for the job.
    turn_ends: Instant,
    /// Stops that were accepted while the request of another stop had no answer yet, each once.
    stops: VecDeque<Order<Command<D>>>,
    /// Requests of stops whose turn is over without an answer: they go on to their end.
    unanswered: JoinSet<Result<Executed, AlpacaError>>,
    polling: Task<Polling<D>>,
    next_turn: Instant,
    next_full: Instant,
    next_description: Instant,
    busy_since: Option<Instant>,
    failures: i32,
    silent_polls: SilentPolls,
    published: Option<(DeviceState<Fields<D>>, Instant)>,
    /// What of the rest is still to be asked in this round, where what decides is read apart.
    rest: VecDeque<String>,
    /// What is still to be asked singly in this round.
    parts: VecDeque<String>,
    /// The rest has its turn before what decides is asked again.
    rest_is_due: bool,
    /// So many questions at once; more than one to a slow server.
    lanes: usize,
    /// Its server could not answer several questions at once.
    one_lane: bool,
    /// Average time of a question in the last poll.
    each: Duration,
    /// Nothing is published before this, because what was read is old and is being read again.
    quiet_until: Option<Instant>,
    /// Asks a device that has fallen silent; true once it answers.
    knocking: Task<bool>,
    looks: Looks,
}

impl<D: Driver> Serve<D> {
    /// Serves the device until the node is stopped.
    pub async fn run(self, mut orders: mpsc::UnboundedReceiver<Order<Command<D>>>) -> anyhow::Result<()> {
        let (bus, stop) = (self.node.bus.clone(), self.node.stop.clone());
        let per_min = 60.0 / self.common.period_s + CHANGES_PER_MIN;
        let cache = (self.node.config.spool.hold_min * per_min).ceil() as usize;
        let states = StatePublisher::open(&self.node, &self.device, &self.common, cache).await?;
        let key = Key::Capabilities(self.device.clone());
        let descriptions = bus.publisher(&key).await?;
        let command_server = self.command_server.clone();
        let answer = move |command| {
            let command_server = command_server.clone();
            async move { command_server.answer(command).await }
        };
        let driver = self.driver.clone();
        let service = bus.serve(&Key::Command(self.device.clone()), answer).await?;
        // The same phase at every start, a different one for each device.
        let phase = Duration::from_millis(37 * u64::from(self.index));
        let now = Instant::now();
        let mut lap = Loop {
            serve: self,
            states,
            descriptions,
            readings: Readings::default(),
            link: Link::Connecting,
            device_state: false,
            has: Has::default(),
            description: None,
            last_command: None,
            running: None,
            job: None,
            reading_again: ReadingAgain::default(),
            contradiction: Contradiction::default(),
            turn_ends: now,
            stops: VecDeque::new(),
            unanswered: JoinSet::new(),
            polling: None,
            next_turn: now + phase.min(Duration::from_millis(900)),
            next_full: now,
            next_description: now,
            busy_since: None,
            failures: 0,
            silent_polls: SilentPolls::default(),
            published: None,
            rest: VecDeque::new(),
            parts: VecDeque::new(),
            rest_is_due: false,
            lanes: 1,
            one_lane: false,
            each: Duration::ZERO,
            quiet_until: None,
            knocking: None,
            looks: Looks::begin(bus.clock().machine(), turns::STALL),
        };
        lap.publish(true).await;
        loop {
            let wake = lap.wake().min(Instant::now() + bus.clock().machine().to_tick(turns::LOOK));
            let turn = tokio::select! {
                biased;
                () = stop.wait() => {
                    for order in lap.running.iter().map(|running| &running.order).chain(&lap.stops) {
                        let detail = "the node ended; how the command ends is not known".to_owned();
                        lap.account(order, Ended::Failed { detail });
                    }
                    // Nothing is taken that nobody would do.
                    drop(service);
                    lap.states.end().await;
                    return Ok(());
                }
                Some(order) = orders.recv() => Turn::Order(order),
                result = finished(&mut lap.job) => Turn::Executed(result),
                Some(answered) = lap.unanswered.join_next() => Turn::Late(answered),
                polling = finished(&mut lap.polling) => Turn::Polling(polling),
                answers = finished(&mut lap.knocking) => Turn::Knocked(answers),
                read = finished(&mut lap.reading_again.task) => Turn::ReadAgain(read),
                () = driver.stirred() => Turn::Stirred,
                () = sleep_until(wake) => Turn::Due,
            };
            let stood_still = lap.stood_still();
            match turn {
                turn if !turn.counts(stood_still) => {}
                Turn::Order(order) => lap.take(order),
                Turn::Executed(result) => lap.executed(result),
                Turn::Late(answered) => lap.late(answered),
                Turn::Polling(Polling::Greeted(greeting)) => lap.greeted(greeting),
                Turn::Polling(Polling::Polled(poll)) => {
                    let full = poll.full;
                    lap.polled(poll);
                    lap.publish(full).await;
                }
                Turn::Knocked(true) => lap.answers_again(),
                Turn::Knocked(false) | Turn::Stirred => {}
                Turn::ReadAgain(read) => lap.read_again(read),
                Turn::Due => lap.due(),
            }
            lap.next_stop();
            lap.publish(false).await;
        }
    }
}

/// What the loop woke up for.
enum Turn<D: Driver> {
    Order(Order<Command<D>>),
    Executed(Result<Executed, AlpacaError>),
    Late(Result<Result<Executed, AlpacaError>, JoinError>),
    Polling(Polling<D>),
    Knocked(bool),
    Stirred,
    Due,
    ReadAgain(ReadAgain<D>),
}

/// What reading the capabilities again came to.
type ReadAgain<D> = (Abilities, Result<Capabilities<D>, AlpacaError>);

/// Waits for a task, if there is one, and forgets it.
async fn finished<T>(task: &mut Task<T>) -> T {
    let Some(running) = task else { return std::future::pending().await };
    let result = running.as_mut().await;
    *task = None;
    result
}

impl<D: Driver> Loop<D> {
    fn period(&self) -> Duration {
        Duration::from_secs_f64(self.serve.common.period_s)
    }

    fn publish_period(&self) -> Duration {
        // A poll under way will publish by itself; a state of a device that hangs is published later, but not never.
        let periods = if self.polling.is_some() { 3 } else { 1 };
        self.period().min(PUBLISH_EVERY) * periods
    }

    fn wake(&self) -> Instant {
        let mut wake = self.published.as_ref().map_or_else(Instant::now, |(_, at)| *at + self.publish_period());
        if let Some(until) = self.quiet_until {
            wake = wake.max(until);
        }
        if self.polling.is_none() {
            wake = wake.min(self.next_turn);
        }
        if self.description.is_some() {
            wake = wake.min(self.next_description);
        }
        if let Some(next) = self.reading_again.next() {
            wake = wake.min(next);
        }
        if let Some(deadline) = self.running.as_ref().and_then(|running| running.deadline) {
            wake = wake.min(deadline);
        }
        if !self.stops.is_empty() {
            wake = wake.min(self.turn_ends);
        }
        wake
    }

    /// A timer ran out.
    fn due(&mut self) {
        let now = Instant::now();
        if self.running.as_ref().and_then(|running| running.deadline).is_some_and(|deadline| now >= deadline) {
            self.judge(None);
        }
        self.begin_reading_again(now);
        if self.polling.is_some() || now < self.next_turn {
            return;
        }
        let Serve { driver, common, alpaca, fixed, node, .. } = &self.serve;
        let questions = Questions { alpaca: alpaca.clone(), clock: node.bus.clock().clone() };
        if self.link != Link::Connected {
            let (driver, common, fixed) = (driver.clone(), common.clone(), fixed.clone());
            let greet = async move { Polling::<D>::Greeted(questions.greet(driver, &common, &fixed).await) };
            self.polling = Some(Box::pin(greet));
            return;
        }
        let wanted = self.next_wanted(now);
        self.polling = Some(Box::pin(async move { Polling::<D>::Polled(questions.poll(wanted).await) }));
    }

    /// All polled properties that the device has.
    fn wanted(&self) -> Vec<String> {
        let own = self.serve.driver.polled();
        let others = self.serve.polled.iter().filter(|name| !own.contains(name)).cloned().collect::<Vec<_>>();
        self.has.present(own.into_iter().chain(others))
    }

    fn greeted(&mut self, greeting: Result<Greeting<D>, AlpacaError>) {
        let greeting = match greeting {
            Ok(greeting) => greeting,
            Err(error) => return self.lose(&error),
        };
        if self.link != Link::Connected {
            tracing::info!(device = %self.serve.device, name = greeting.description.device_name, "device connected");
        }
        self.has.ask_again();
        for PropertyAnswer { property, result, at_utc, .. } in greeting.answers {
            self.has.learn(&property, &result);
            self.readings.keep(&property, result.map_err(|error| error.no_data()), at_utc);
        }
        (self.lanes, self.one_lane, self.rest_is_due) = (1, false, false);
        self.rest.clear();
        self.parts.clear();
        self.device_state = greeting.device_state;
        self.link = Link::Connected;
        self.serve.node.alerts.clear(AlertKind::DeviceLost, self.instance());
        self.status().can = Some(greeting.description.can.clone());
        self.description = Some(greeting.description);
        self.reading_again = ReadingAgain::of(greeting.abilities);
        (self.failures, self.silent_polls, self.knocking) = (0, SilentPolls::default(), None);
        let now = Instant::now();
        (self.next_turn, self.next_full, self.next_description) = (now, now, now);
        self.observe_now();
    }

    fn keep(&mut self, answers: Vec<PropertyAnswer>) {
        for PropertyAnswer { property, result, at_utc, asked } in answers {
            self.has.learn(&property, &result);
            self.readings.keep_asked(&property, result.map_err(|error| error.no_data()), at_utc, asked);
        }
    }

    fn polled(&mut self, poll: Poll) {
        self.device_state = poll.device_state;
        let denied = poll.denied().filter(|_| self.has.has_spoken()).cloned();
        self.quiet_until = None;
        let splits = self.splits();
        self.pace(&poll);
        self.note_silence(&poll);
        // The rest of a device may hang by itself: what decides shows whether there is a link. Of a device with properties
        // that decide, one that hangs ends the poll, and then several in a row show it.
        let deciding = self.deciding();
        let is_gone = self.silent_polls.take(&poll, &deciding);
        self.keep(poll.answers);
        let is_timeout = poll.lost.as_ref().is_some_and(AlpacaError::is_timeout);
        let shows = !splits || is_gone || (poll.full && !is_timeout);
        let lost = poll.lost.filter(|error| shows || !error.is_transport());
        if let Some(error) = lost.or(denied) {
            return self.lose(&error);
        }
        self.serve.driver.observed(&self.readings, poll.began);
        self.note_contradiction();
        self.note_unread();
        self.judge(Some(poll.began_at));
        let now = Instant::now();
        if splits {
            self.note_slowness(self.each * u32::try_from(self.wanted().len()).unwrap_or(u32::MAX));
            self.next_turn = if self.rest_is_due || !self.parts.is_empty() { now } else { self.next_full };
            return;
        }
        let pause = if self.is_fast(now) { FAST } else { self.period() };
        if poll.full {
            self.note_slowness(now.duration_since(poll.began_at));
        }
        let tick = now + self.serve.node.bus.clock().machine().to_tick(pause);
        // A poll that took longer than its period is followed by the next at once.
        self.next_turn = if now.duration_since(poll.began_at) < pause { tick } else { now };
    }

    fn is_fast(&mut self, now: Instant) -> bool {
        if self.running.is_some() {
            return true;
        }
        let busy = self.serve.driver.is_busy(&self.serve.driver.fields(&self.readings));
        let since = if busy { Some(*self.busy_since.get_or_insert(now)) } else { None };
        self.busy_since = since;
        since.is_some_and(|since| now.duration_since(since) < BUSY_LIMIT)
    }

    /// As alerts name the device.
    fn instance(&self) -> String {
        format!("{}/{}", D::Kind::KIND, self.serve.device.name)
    }

    fn observe_now(&self) {
        let clock = self.serve.node.bus.clock();
        self.serve.driver.observed(&self.readings, Now { machine: clock.machine(), sky: clock.sky() });
    }

    fn status(&self) -> std::sync::MutexGuard<'_, crate::command_server::DeviceStatus<D>> {
        self.serve.command_server.status.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn state(&self) -> DeviceState<Fields<D>> {
        let fields = self.serve.driver.fields(&self.readings);
        DeviceState {
            link: self.link.clone(),
            busy: self.running.is_some() || self.serve.driver.is_busy(&fields),
            period_s: self.period().min(PUBLISH_EVERY).as_secs_f64(),
            poll_s: Some(self.period().as_secs_f64()),
            last_command: self.last_command.clone(),
            fields,
            readings: self.readings.published(D::Kind::KIND, self.serve.node.bus.clock().machine()),
        }
    }

    /// Publishes the state if it has changed, if it is time, or in any case.
    async fn publish(&mut self, in_any_case: bool) {
        let now = Instant::now();
        let state = self.state();
        {
            let mut status = self.status();
            status.link = state.link.clone();
            status.fields = state.fields.clone();
        }
        if self.polling.is_some() && self.quiet_until.is_some_and(|until| now < until) {
            return;
        }
        self.quiet_until = None;
        let same = |before: &DeviceState<Fields<D>>| {
            let words = |state: &DeviceState<Fields<D>>| serde_json::to_value(&state.fields).ok();
            before.link == state.link
                && before.busy == state.busy
                && before.last_command == state.last_command
                && words(before) == words(&state)
        };
        let due =
            self.published.as_ref().is_none_or(|(before, at)| now >= *at + self.publish_period() || !same(before));
        if in_any_case || due {
            if let Err(error) = self.states.put(state.clone()).await {
                tracing::warn!(device = %self.serve.device, %error, "the state could not be published");
            }
            self.published = Some((state, now));
        }
        if let Some(description) = &self.description
            && now >= self.next_description
        {
            if let Err(error) = self.descriptions.put(description.clone()).await {
                tracing::warn!(device = %self.serve.device, %error, "the capabilities could not be published");
            }
            self.next_description = now + CAPABILITIES;
        }
    }
}
