//! Publishes typed payloads, stamped and counted.

use std::marker::PhantomData;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use contract::row::Carried;
use contract::{Key, Payload, Stamped};
use zenoh::bytes::Encoding;
use zenoh::qos::{CongestionControl, Priority};
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

use crate::session::MOST_BYTES;
use crate::{Bus, BusError, MachineTime, machine, transit};

/// How a key is carried; every quality drops rather than blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quality {
    /// Repeated regularly; so many samples are retained, so that a subscriber catches up after a cut, and the newest is
    /// answered to a plain `get`.
    State {
        /// Samples kept for those who were away.
        cache: usize,
    },
    /// Happens once; kept for so many samples.
    Event {
        /// Samples kept for those who were away.
        cache: usize,
    },
    /// Permits and guard numbers: first on the wire, never queued, never repeated.
    Urgent,
}

impl Quality {
    fn of(key: &Key) -> Self {
        match key.topic().row().carried {
            Carried::State(cache) => Self::State { cache },
            Carried::Event(cache) => Self::Event { cache },
            Carried::Urgent => Self::Urgent,
            // The last two are not published.
            Carried::Telemetry | Carried::Query | Carried::LargeAnswers | Carried::Token => Self::State { cache: 1 },
        }
    }
}

/// Publishes payloads of one type on one key.
pub struct Publisher<T> {
    key: String,
    line: ZenohPublisher,
    seq: AtomicU64,
    bus: Bus,
    newest: Newest,
    _answers: Option<zenoh::query::Queryable<()>>,
    _payload: PhantomData<fn(T)>,
}

/// The newest payload, and when it was published.
type Newest = Arc<Mutex<Option<(Vec<u8>, MachineTime)>>>;

enum ZenohPublisher {
    Plain(zenoh::pubsub::Publisher<'static>),
    Advanced(AdvancedPublisher<'static>),
}

impl Bus {
    /// Declares a publisher, as the table of the bus has its topic.
    pub async fn publisher<T: Payload>(&self, key: &Key) -> Result<Publisher<T>, BusError> {
        self.publisher_as(key, Quality::of(key)).await
    }

    /// Declares a publisher whose quality depends on more than its topic.
    pub async fn publisher_as<T: Payload>(&self, key: &Key, quality: Quality) -> Result<Publisher<T>, BusError> {
        let text = key.to_string();
        let failed = |source| BusError::Declare { what: "a publisher", key: key.to_string(), source };
        let builder = self
            .session
            .declare_publisher(text.clone())
            .encoding(Encoding::APPLICATION_JSON)
            .congestion_control(CongestionControl::Drop);
        let line = match quality {
            Quality::Urgent => {
                let urgent = builder.priority(Priority::RealTime).express(true);
                ZenohPublisher::Plain(urgent.await.map_err(failed)?)
            }
            Quality::State { cache } | Quality::Event { cache } => {
                // No heartbeat: states repeat, and events are followed by states, so the next sample shows a gap.
                let advanced = builder
                    .cache(CacheConfig::default().max_samples(cache))
                    .sample_miss_detection(MissDetectionConfig::default())
                    .publisher_detection();
                ZenohPublisher::Advanced(advanced.await.map_err(failed)?)
            }
        };
        let newest = Newest::default();
        let answers = match quality {
            Quality::State { .. } => Some(self.answer_newest(&text, newest.clone()).await.map_err(failed)?),
            Quality::Event { .. } | Quality::Urgent => None,
        };
        Ok(Publisher {
            key: text,
            line,
            seq: AtomicU64::new(0),
            bus: self.clone(),
            newest,
            _answers: answers,
            _payload: PhantomData,
        })
    }

    async fn answer_newest(&self, key: &str, newest: Newest) -> Result<zenoh::query::Queryable<()>, zenoh::Error> {
        let runtime = tokio::runtime::Handle::current();
        let own_key = key.to_owned();
        self.session
            .declare_queryable(key.to_owned())
            .callback(move |query| {
                let (key, newest) = (own_key.clone(), newest.clone());
                runtime.spawn(async move {
                    // Looked up by this task and not before it: a runtime that hangs must not answer with the value of
                    // an earlier time.
                    let held = newest.lock().unwrap_or_else(PoisonError::into_inner).clone();
                    let Some((bytes, published)) = held else { return };
                    let bytes = transit::held(bytes, machine::now().since(published));
                    if let Err(error) = query.reply(key, bytes).encoding(Encoding::APPLICATION_JSON).await {
                        tracing::debug!(%error, "a question left before its answer");
                    }
                });
            })
            .await
    }
}

impl<T: Payload> Publisher<T> {
    /// Publishes a payload now, stamped with this node's boot id, the next number and sky time.
    pub async fn put(&self, body: T) -> Result<(), BusError> {
        let now = machine::now();
        let stamped = Stamped {
            boot_id: self.bus.boot_id().clone(),
            seq: self.seq.fetch_add(1, Ordering::Relaxed),
            at_utc: self.bus.clock().utc(),
            sent_s: Some(transit::sent_s(now)),
            held_s: None,
            body,
        };
        let failed = |detail: String| BusError::Publish { key: self.key.clone(), detail };
        let bytes = serde_json::to_vec(&stamped).map_err(|error| failed(error.to_string()))?;
        if bytes.len() > MOST_BYTES {
            // Every receiver would drop it, and the link with it.
            let (key, bytes, most) = (&self.key, bytes.len(), MOST_BYTES);
            tracing::error!(key, bytes, most, "a payload is too large for the bus and was not sent");
            return Ok(());
        }
        if self._answers.is_some() {
            *self.newest.lock().unwrap_or_else(PoisonError::into_inner) = Some((bytes.clone(), now));
        }
        let sent = match &self.line {
            ZenohPublisher::Plain(publisher) => publisher.put(bytes).await,
            ZenohPublisher::Advanced(publisher) => publisher.put(bytes).await,
        };
        sent.map_err(|error| failed(error.to_string()))
    }

    /// The number with which the next payload will be published.
    pub fn next_seq(&self) -> u64 {
        self.seq.load(Ordering::Relaxed)
    }

    /// Publishes the newest value of a watch at each change and at least every `period`, until the sender is gone.
    pub async fn follow(&self, mut values: tokio::sync::watch::Receiver<T>, period: Duration) -> Result<(), BusError> {
        loop {
            let value = values.borrow_and_update().clone();
            self.put(value).await?;
            if let Ok(Err(_)) = tokio::time::timeout(period, values.changed()).await {
                return Ok(());
            }
        }
    }
}
