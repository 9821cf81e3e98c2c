//! Receives typed payloads: each as it comes, or the newest value with its age.

use std::fmt::Display;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use contract::{BootId, Key, Payload};
use tokio::sync::watch;
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh_ext::{AdvancedSubscriber, AdvancedSubscriberBuilderExt, RecoveryConfig};

use crate::history::{self, Watch};
use crate::numbers::{Gap, Numbers};
use crate::queue::Queue;
use crate::{Bus, BusError, Received, Succession, machine};

/// Which samples a subscriber wants to receive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Catch {
    /// The newest values: those of now at once, then each new one; older ones may be lost.
    Newest,
    /// Everything that the publishers still hold and all that follows, each once, with recovery after a cut. What is
    /// recovered is in order, and may come after the first newer payloads.
    All,
}

/// Receives payloads of one type on the keys of an expression.
pub struct Subscriber<T> {
    queue: Arc<Queue<T>>,
    _line: ZenohSubscriber,
}

enum ZenohSubscriber {
    Plain { _subscriber: zenoh::pubsub::Subscriber<()> },
    Advanced { _subscriber: AdvancedSubscriber<()>, _past: Watch },
}

impl Bus {
    /// Subscribes to a key, to [`Keys`](contract::Keys) or to a key expression that a person wrote; at most `capacity` payloads wait, and new ones replace the oldest.
    pub async fn subscribe<T: Payload>(
        &self,
        expression: impl Display,
        catch: Catch,
        capacity: usize,
    ) -> Result<Subscriber<T>, BusError> {
        let numbers = (catch == Catch::All).then(Numbers::default);
        self.subscribe_with(expression.to_string(), numbers, capacity).await
    }

    /// As [`Self::subscribe`] with [`Catch::All`], for one that received before: of each incarnation and key, all from
    /// one number to another. Of these senders nothing comes twice, and what they published since then comes or is reported by
    /// [`Subscriber::given_up`].
    pub async fn subscribe_after<T: Payload>(
        &self,
        expression: impl Display,
        known: Vec<(BootId, Key, u64, u64)>,
        capacity: usize,
    ) -> Result<Subscriber<T>, BusError> {
        self.subscribe_with(expression.to_string(), Some(Numbers::after(known)), capacity).await
    }

    async fn subscribe_with<T: Payload>(
        &self,
        expression: String,
        numbers: Option<Numbers>,
        capacity: usize,
    ) -> Result<Subscriber<T>, BusError> {
        let wants_all = numbers.is_some();
        let queue = Arc::new(Queue::new(capacity, numbers, self.transit.clone()));
        let failed = |source| BusError::Declare { what: "a subscriber", key: expression.clone(), source };
        let builder = self.session.declare_subscriber(expression.clone());
        let into = queue.clone();
        let line = if wants_all {
            let recovering = builder.recovery(RecoveryConfig::default());
            let subscriber = recovering.callback(move |sample| into.push(&sample)).await.map_err(failed)?;
            let past = history::recall(&self.session, &self.turns, &expression, &queue).await.map_err(failed)?;
            ZenohSubscriber::Advanced { _subscriber: subscriber, _past: past }
        } else {
            let subscriber = builder.callback(move |sample| into.push(&sample)).await.map_err(failed)?;
            self.ask_newest(expression, queue.clone());
            ZenohSubscriber::Plain { _subscriber: subscriber }
        };
        Ok(Subscriber { queue, _line: line })
    }

    /// Asks in the background for what is true now, so that a late joiner need not wait for the next repeat.
    ///
    /// Asked more than once: a session that has just opened does not know all its peers yet.
    fn ask_newest<T: Payload>(&self, expression: String, queue: Arc<Queue<T>>) {
        let session = self.session.clone();
        tokio::spawn(async move {
            for pause_ms in [0, 300, 1500] {
                tokio::time::sleep(Duration::from_millis(pause_ms)).await;
                let into = Arc::downgrade(&queue);
                // All that answer, and all their samples: a stranger's answer must not take the place of the writer's.
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
        self.latest_with(key, |_| {}).await
    }

    /// As [`Self::latest`]; `each` gets every payload before it is the newest one, also one that another soon follows.
    pub async fn latest_with<T: Payload>(
        &self,
        key: &Key,
        mut each: impl FnMut(&Received<T>) + Send + 'static,
    ) -> Result<Latest<T>, BusError> {
        let subscriber = self.subscribe::<T>(key, Catch::Newest, 16).await?;
        let (sender, receiver) = watch::channel(None);
        let succession: Arc<Mutex<Succession>> = Arc::default();
        let into = succession.clone();
        let task = tokio::spawn(async move {
            loop {
                let received: Received<T> = subscriber.recv().await;
                if lock(&into).is_newer(&received.sample.boot_id, received.sample.seq, received.arrived) {
                    each(&received);
                    sender.send_replace(Some(received));
                }
            }
        });
        Ok(Latest { receiver, succession, _task: Arc::new(AbortOnDrop(task)) })
    }
}

impl<T> Subscriber<T> {
    /// Waits for the next payload.
    pub async fn recv(&self) -> Received<T> {
        self.queue.next().await
    }

    /// Payloads that gave way to newer ones.
    pub fn lost(&self) -> u64 {
        self.queue.lost()
    }

    /// Payloads that were published between others that were received, and never came; [`Catch::All`] only.
    pub fn missing(&self) -> u64 {
        self.queue.missing()
    }

    /// Payloads that are lost, since this was asked last: their publishers were asked for them and hold them no more.
    /// [`Catch::All`] only.
    pub fn given_up(&self) -> Vec<Gap> {
        self.queue.take_given_up()
    }

    /// Payloads that could not be read.
    pub fn malformed(&self) -> u64 {
        self.queue.malformed()
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The newest payload of one key. Cheap to clone.
#[derive(Clone)]
pub struct Latest<T> {
    receiver: watch::Receiver<Option<Received<T>>>,
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
    pub fn get(&self) -> Option<Received<T>> {
        self.receiver.borrow().clone()
    }

    /// The newest payload unless it arrived longer ago than `age`.
    pub fn fresh(&self, age: Duration) -> Option<Received<T>> {
        self.get().filter(|received| machine::now().since(received.arrived) <= age)
    }

    /// Do two nodes publish on the key at the same time? Then neither is to be believed.
    pub fn has_rivals(&self) -> bool {
        lock(&self.succession).rivals(machine::now()).is_some()
    }

    /// Waits for the next change after the newest payload that this clone has seen.
    pub async fn changed(&mut self) {
        if self.receiver.changed().await.is_err() {
            // The follower ended with the runtime; nothing will ever change again.
            std::future::pending::<()>().await;
        }
    }
}
