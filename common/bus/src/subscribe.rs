//! Hearing typed payloads: bounded queues that overwrite, and the newest value with its age.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use contract::{Key, Payload, Stamped};
use tokio::sync::{Notify, watch};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::{Sample, SampleKind};
use zenoh_ext::{AdvancedSubscriber, AdvancedSubscriberBuilderExt, RecoveryConfig};

use crate::history::{self, Watch};
use crate::numbers::Numbers;
use crate::transit::Transit;
use crate::{Bus, BusError, MachineTime, Succession, machine};

/// What a subscriber wants to hear.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Catch {
    /// The newest values: those of now at once, then each new one; older ones may be lost.
    Newest,
    /// Everything of the last ten minutes and all that follows, each once, with recovery after a cut. What is
    /// recovered is in order, and may come after the first newer payloads.
    All,
}

/// One payload as it was heard.
#[derive(Debug, Clone)]
pub struct Heard<T> {
    /// On which key.
    pub key: Key,
    /// What was said.
    pub said: Stamped<T>,
    /// When it arrived, on this machine's own clock, less what it was held or on its way longer than others were;
    /// ages are judged by it.
    pub arrived: MachineTime,
}

/// Hears payloads of one type on the keys of an expression.
pub struct Subscriber<T> {
    queue: Arc<Queue<T>>,
    _line: Line,
}

enum Line {
    Plain { _subscriber: zenoh::pubsub::Subscriber<()> },
    Advanced { _subscriber: AdvancedSubscriber<()>, _past: Watch },
}

/// Payloads of one subscriber that wait take at most so much as they came, whatever its capacity.
const MOST_WAITING_BYTES: usize = 32 << 20;

/// Payloads that wait to be heard.
pub(crate) struct Queue<T> {
    waiting: Mutex<Waiting<T>>,
    capacity: usize,
    /// Where each payload counts once: which were heard.
    numbers: Option<Mutex<Numbers>>,
    arrived: Notify,
    transit: Arc<Mutex<Transit>>,
    lost: AtomicU64,
    malformed: AtomicU64,
}

/// Payloads with their sizes.
struct Waiting<T> {
    payloads: VecDeque<(Heard<T>, usize)>,
    bytes: usize,
}

impl<T> Waiting<T> {
    fn pop(&mut self) -> Option<Heard<T>> {
        let (heard, bytes) = self.payloads.pop_front()?;
        self.bytes -= bytes;
        Some(heard)
    }

    /// Puts a payload at the end; returns how many older ones gave way to it.
    fn push(&mut self, heard: Heard<T>, bytes: usize, capacity: usize) -> u64 {
        let mut lost = 0;
        while self.payloads.len() >= capacity || (self.bytes + bytes > MOST_WAITING_BYTES && self.bytes > 0) {
            if self.pop().is_none() {
                break;
            }
            lost += 1;
        }
        self.payloads.push_back((heard, bytes));
        self.bytes += bytes;
        lost
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<T: Payload> Queue<T> {
    /// Takes a sample in; one that cannot be read is counted.
    pub(crate) fn push(&self, sample: &Sample) {
        if sample.kind() != SampleKind::Put {
            return;
        }
        // keys of other programs and of zenoh itself (`@adv`) are none of ours
        let Some(key) = Key::parse(sample.key_expr().as_str()) else { return };
        let bytes = sample.payload().to_bytes();
        match serde_json::from_slice(&bytes) {
            Ok(said) => {
                let arrived = lock(&self.transit).arrived(&said, machine::now());
                self.push_heard(Heard { key, said, arrived }, bytes.len());
            }
            Err(error) => {
                if self.malformed.fetch_add(1, Ordering::Relaxed) == 0 {
                    tracing::warn!(%key, %error, "a malformed payload was dropped; later ones are only counted");
                }
            }
        }
    }

    fn push_heard(&self, heard: Heard<T>, bytes: usize) {
        let is_new = |numbers: &Mutex<Numbers>| lock(numbers).hear(&heard.said.boot_id, &heard.key, heard.said.seq);
        if !self.numbers.as_ref().is_none_or(is_new) {
            return;
        }
        let lost = lock(&self.waiting).push(heard, bytes, self.capacity);
        self.lost.fetch_add(lost, Ordering::Relaxed);
        self.arrived.notify_one();
    }
}

impl Bus {
    /// Subscribes to a key expression; at most `capacity` payloads wait, the oldest give way.
    pub async fn subscribe<T: Payload>(
        &self,
        expression: &str,
        catch: Catch,
        capacity: usize,
    ) -> Result<Subscriber<T>, BusError> {
        let queue = Arc::new(Queue {
            waiting: Mutex::new(Waiting { payloads: VecDeque::new(), bytes: 0 }),
            capacity,
            numbers: (catch == Catch::All).then(Mutex::default),
            arrived: Notify::new(),
            transit: self.transit.clone(),
            lost: AtomicU64::new(0),
            malformed: AtomicU64::new(0),
        });
        let failed = |source| BusError::Declare { what: "a subscriber", key: expression.to_owned(), source };
        let builder = self.session.declare_subscriber(expression.to_owned());
        let into = queue.clone();
        let line = match catch {
            Catch::Newest => {
                let subscriber = builder.callback(move |sample| into.push(&sample)).await.map_err(failed)?;
                Line::Plain { _subscriber: subscriber }
            }
            Catch::All => {
                let recovering = builder.recovery(RecoveryConfig::default());
                let subscriber = recovering.callback(move |sample| into.push(&sample)).await.map_err(failed)?;
                let past = history::recall(&self.session, expression, &queue).await.map_err(failed)?;
                Line::Advanced { _subscriber: subscriber, _past: past }
            }
        };
        if catch == Catch::Newest {
            self.ask_newest(expression, queue.clone());
        }
        Ok(Subscriber { queue, _line: line })
    }

    /// Asks in the background for what is true now, so that a late joiner need not wait for the next repeat.
    ///
    /// Asked more than once: a session that has just opened does not know all its peers yet.
    fn ask_newest<T: Payload>(&self, expression: &str, queue: Arc<Queue<T>>) {
        let (session, expression) = (self.session.clone(), expression.to_owned());
        tokio::spawn(async move {
            for pause_ms in [0, 300, 1500] {
                tokio::time::sleep(Duration::from_millis(pause_ms)).await;
                let into = Arc::downgrade(&queue);
                // all that answer, and all that they say: a stranger's answer must not take the place of the writer's
                let asked = session
                    .get(&expression)
                    .target(QueryTarget::All)
                    .consolidation(ConsolidationMode::None)
                    .timeout(Duration::from_secs(2))
                    .callback(move |reply| {
                        if let (Ok(sample), Some(into)) = (reply.result(), into.upgrade()) {
                            into.push(sample);
                        }
                    });
                if let Err(error) = asked.await {
                    tracing::debug!(%error, "nobody could be asked for the newest values");
                }
            }
        });
    }

    /// Follows one key: the newest payload with its time of arrival.
    pub async fn latest<T: Payload>(&self, key: &Key) -> Result<Latest<T>, BusError> {
        let subscriber = self.subscribe::<T>(&key.to_string(), Catch::Newest, 16).await?;
        let (sender, receiver) = watch::channel(None);
        let succession: Arc<Mutex<Succession>> = Arc::default();
        let into = succession.clone();
        let task = tokio::spawn(async move {
            loop {
                let heard: Heard<T> = subscriber.hear().await;
                if lock(&into).is_newer(&heard.said.boot_id, heard.said.seq, heard.arrived) {
                    sender.send_replace(Some(heard));
                }
            }
        });
        Ok(Latest { receiver, succession, _task: Arc::new(AbortOnDrop(task)) })
    }
}

impl<T> Subscriber<T> {
    /// Waits for the next payload.
    pub async fn hear(&self) -> Heard<T> {
        loop {
            // registered before looking, so that an arrival in between is not missed
            let arrived = self.queue.arrived.notified();
            let next = lock(&self.queue.waiting).pop();
            match next {
                Some(heard) => return heard,
                None => arrived.await,
            }
        }
    }

    /// Payloads that gave way to newer ones.
    pub fn lost(&self) -> u64 {
        self.queue.lost.load(Ordering::Relaxed)
    }

    /// Payloads that were said between others that were heard, and never came; [`Catch::All`] only.
    pub fn missing(&self) -> u64 {
        self.queue.numbers.as_ref().map_or(0, |numbers| lock(numbers).missing())
    }

    /// Payloads that could not be read.
    pub fn malformed(&self) -> u64 {
        self.queue.malformed.load(Ordering::Relaxed)
    }
}

/// The newest payload of one key. Cheap to clone.
#[derive(Clone)]
pub struct Latest<T> {
    receiver: watch::Receiver<Option<Heard<T>>>,
    succession: Arc<Mutex<Succession>>,
    _task: Arc<AbortOnDrop>,
}

struct AbortOnDrop(tokio::task::JoinHandle<()>);

impl Drop for AbortOnDrop {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl<T: Clone> Latest<T> {
    /// The newest payload, if any came yet.
    pub fn get(&self) -> Option<Heard<T>> {
        self.receiver.borrow().clone()
    }

    /// The newest payload unless it arrived longer ago than `age`.
    pub fn fresh(&self, age: Duration) -> Option<Heard<T>> {
        self.get().filter(|heard| machine::now().since(heard.arrived) <= age)
    }

    /// Do two nodes speak on the key at the same time? Then neither is to be believed.
    pub fn has_rivals(&self) -> bool {
        lock(&self.succession).rivals(machine::now()).is_some()
    }

    /// Waits for the next change after the newest payload that this clone has seen.
    pub async fn changed(&mut self) {
        if self.receiver.changed().await.is_err() {
            // the follower ended with the runtime; nothing will ever change again
            std::future::pending::<()>().await;
        }
    }
}
