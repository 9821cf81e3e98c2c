//! Questions and commands: asked of one key, answered at once, and *unknown* when no answer comes.

use std::fmt::Display;
use std::future::Future;
use std::sync::Arc;
use std::time::{Duration, Instant};

use contract::row::Carried;
use contract::{Accepted, Command, CommandId, Device, Key, Payload, Reason, Refusal, Reply, Stamped};
use serde::de::DeserializeOwned;
use tokio::sync::{Semaphore, mpsc};
use zenoh::bytes::Encoding;
use zenoh::qos::Priority;
use zenoh::query::{ConsolidationMode, Query, QueryTarget};
use zenoh::session::ZenohId;

use crate::session::MOST_BYTES;
use crate::writers::{MOST_WRITERS, other_states};
use crate::{Bus, BusError};

/// Questions that one service answers at the same time; more are left without an answer.
const AT_ONCE: usize = 32;
/// Answers to one question that wait to be looked at; a flood of them comes from no node.
const ANSWERS: usize = 4 * MOST_WRITERS;
/// How long the writers of a key are asked for.
const WRITERS: Duration = Duration::from_secs(1);
/// Payloads that [`Bus::get_all`] takes at most.
const MOST_PAYLOADS: usize = 4096;

/// Why a question has no answer.
#[derive(Debug, thiserror::Error)]
pub enum AskError {
    /// Nobody answered, or too late: whether it was done is unknown, look at the state.
    #[error("no answer from {key} within {timeout_s} s; whether it was done is unknown")]
    Unknown {
        /// The key that was asked.
        key: String,
        /// How long was waited.
        timeout_s: f64,
    },
    /// The answer could not be read.
    #[error("{key} answered what cannot be read: {detail}")]
    Unreadable {
        /// The key that was asked.
        key: String,
        /// What is wrong.
        detail: String,
    },
    /// Programs that claim the same key answered differently.
    #[error("{key} was answered by {count} programs that contradict each other; whether it was done is unknown")]
    Contested {
        /// The key that was asked.
        key: String,
        /// How many answered.
        count: usize,
    },
    /// The answer is a refusal.
    #[error("{key}: {refusal}")]
    Refused {
        /// The key that was asked.
        key: String,
        /// The refusal.
        #[source]
        refusal: Refusal,
    },
}

/// A key that is answered; it falls silent when this is dropped.
pub struct Service {
    _queryable: zenoh::query::Queryable<()>,
}

impl Bus {
    /// Asks one question, and returns the answer of the program that publishes the state next to the key; answers of
    /// others do not count.
    pub async fn ask<Q: Payload, A: DeserializeOwned>(
        &self,
        key: &Key,
        question: &Q,
        timeout: Duration,
    ) -> Result<A, AskError> {
        let (states, moves) = (other_states(key), decides(key));
        let is_of_any_archive = matches!(key, Key::History(_) | Key::ArchivedFrame(_) | Key::NightReport(_));
        let is_large = key.topic().row().carried == Carried::LargeAnswers;
        let key = key.to_string();
        let unreadable = |detail: String| AskError::Unreadable { key: key.clone(), detail };
        let payload = serde_json::to_vec(question).map_err(|error| unreadable(error.to_string()))?;
        if payload.len() > MOST_BYTES {
            let detail = format!("the question has {} bytes; the bus takes at most {MOST_BYTES}", payload.len());
            return Err(unreadable(detail));
        }
        let unknown = || AskError::Unknown { key: key.clone(), timeout_s: timeout.as_secs_f64() };
        let until = Instant::now() + timeout;
        let mut answers = self.put_question(&key, payload, is_large, timeout).await.ok_or_else(unknown)?;
        let mut counted: Vec<(ZenohId, Vec<u8>)> = Vec::new();
        let mut strangers = 0;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            // An end of the answers differs from a timeout: the latter may hide an answer.
            let Ok(next) = tokio::time::timeout(left, answers.recv()).await else { return Err(unknown()) };
            let Some(Answer { who, bytes }) = next else { break };
            let writers = match &states {
                Some(states) => self.writers.of(&self.session, states, who, left.min(WRITERS)).await,
                None => Vec::new(),
            };
            if writers.is_empty() && !moves {
                // No other program claims the key; the answer moves nothing.
                return serde_json::from_slice(&bytes).map_err(|error| unreadable(error.to_string()));
            }
            if !writers.contains(&who) {
                strangers += 1;
                continue;
            }
            if writers.len() == 1 {
                return serde_json::from_slice(&bytes).map_err(|error| unreadable(error.to_string()));
            }
            // Several programs claim the key: an old incarnation of the node, or a stranger.
            if counted.len() < MOST_WRITERS {
                counted.push((who, bytes));
            }
        }
        if strangers > 0 {
            tracing::warn!(
                key,
                strangers,
                "a program answered for a key without publishing the state that belongs to it"
            );
        }
        if is_of_any_archive {
            // Each is right about what it has; one that is new, or catches up, has less.
            counted.sort_by_key(|(_, bytes)| std::cmp::Reverse(bytes.len()));
            counted.truncate(1);
        }
        let Some((_, first)) = counted.first() else { return Err(unknown()) };
        if counted.iter().any(|(_, bytes)| bytes != first) {
            return Err(AskError::Contested { key, count: counted.len() });
        }
        serde_json::from_slice(first).map_err(|error| unreadable(error.to_string()))
    }

    /// Puts a question to every queryable of a key: one that calls itself complete takes it from nobody.
    async fn put_question(
        &self,
        key: &str,
        payload: Vec<u8>,
        is_large: bool,
        timeout: Duration,
    ) -> Option<mpsc::Receiver<Answer>> {
        // The answer has the priority of its question: a file must not delay what people wait for.
        let priority = if is_large { Priority::DataLow } else { Priority::InteractiveHigh };
        let (sender, receiver) = mpsc::channel(ANSWERS);
        let own_key = key.to_owned();
        let asked = self
            .session
            .get(key.to_owned())
            .payload(payload)
            .encoding(Encoding::APPLICATION_JSON)
            .priority(priority)
            .express(!is_large)
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .timeout(timeout)
            .callback(move |reply| {
                // An error reply is zenoh's own word for a timeout; our refusals are ordinary answers.
                let (Some(who), Ok(sample)) = (reply.replier_id(), reply.result()) else { return };
                if sample.key_expr().as_str() == own_key {
                    // It is full only in a flood of answers, which no node makes.
                    let _ = sender.try_send(Answer { who: who.zid(), bytes: sample.payload().to_bytes().into_owned() });
                }
            });
        asked.await.ok().map(|()| receiver)
    }

    /// Sends a command to a device; `Ok` means taken, not done.
    pub async fn command<C: Payload>(
        &self,
        device: &Device,
        command: &Command<C>,
        timeout: Duration,
    ) -> Result<Accepted, AskError> {
        let key = Key::Command(device.clone());
        match self.ask::<_, Reply>(&key, command, timeout).await? {
            Reply::Accepted(accepted) if accepted.id == command.id => Ok(accepted),
            Reply::Accepted(accepted) => {
                let detail = format!("the id {} instead of {}", accepted.id, command.id);
                Err(AskError::Unreadable { key: key.to_string(), detail })
            }
            Reply::Refusal(refusal) => Err(AskError::Refused { key: key.to_string(), refusal }),
        }
    }

    /// Answers a key: `answer` gets each question, or why it could not be read.
    ///
    /// A query with a wildcard, such as a look at `starmesh/**`, is no question and is not answered. One without a
    /// payload is no command and no order: it is refused here, and leaves no record.
    pub async fn serve<Q, A, F, W>(&self, key: &Key, answer: F) -> Result<Service, BusError>
    where
        Q: Payload,
        A: Payload,
        F: Fn(Result<Q, String>) -> W + Send + Sync + 'static,
        W: Future<Output = A> + Send + 'static,
    {
        let runtime = tokio::runtime::Handle::current();
        let (text, answer) = (key.to_string(), Arc::new(answer));
        let own_key = text.clone();
        let is_order = matches!(key, Key::Command(_) | Key::Order(_));
        let places = Arc::new(Semaphore::new(AT_ONCE));
        let declared = self.session.declare_queryable(text).callback(move |query: Query| {
            if query.key_expr().as_str() != own_key {
                return;
            }
            let Ok(place) = places.clone().try_acquire_owned() else {
                tracing::warn!(key = own_key, at_once = AT_ONCE, "too many questions at once; one was not answered");
                return;
            };
            let bytes = query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
            let (answer, key) = (answer.clone(), own_key.clone());
            runtime.spawn(async move {
                let _place = place;
                let written = if is_order && bytes.is_empty() {
                    serde_json::to_vec(&nothing_asked())
                } else {
                    let question = serde_json::from_slice::<Q>(&bytes).map_err(|error| error.to_string());
                    serde_json::to_vec(&answer(question).await)
                };
                let Ok(bytes) = written else { return };
                if bytes.len() > MOST_BYTES {
                    let (bytes, most) = (bytes.len(), MOST_BYTES);
                    tracing::error!(key, bytes, most, "an answer is too large for the bus and was not sent");
                    return;
                }
                if let Err(error) = query.reply(key, bytes).encoding(Encoding::APPLICATION_JSON).await {
                    tracing::debug!(%error, "a question left before its answer");
                }
            });
        });
        let failed = |source| BusError::Declare { what: "a service", key: key.to_string(), source };
        Ok(Service { _queryable: declared.await.map_err(failed)? })
    }

    /// Asks for the newest payloads of all keys of an expression.
    pub async fn get_all<T: Payload>(&self, expression: impl Display, timeout: Duration) -> Vec<(Key, Stamped<T>)> {
        let (sender, mut receiver) = mpsc::channel(MOST_PAYLOADS);
        let asked = self
            .session
            .get(expression.to_string())
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .timeout(timeout)
            .callback(move |reply| {
                // An answer that does not fit is part of a flood.
                if let Ok(sample) = reply.into_result() {
                    let _ = sender.try_send(sample);
                }
            });
        let mut found = Vec::new();
        if asked.await.is_err() {
            return found;
        }
        while let Some(sample) = receiver.recv().await {
            let key = Key::parse(sample.key_expr().as_str());
            let payload = serde_json::from_slice(&sample.payload().to_bytes());
            if let (Some(key), Ok(payload)) = (key, payload) {
                found.push((key, payload));
            }
        }
        found
    }
}

/// Does something move, or is something held to be safe, by the answer to this key?
fn decides(key: &Key) -> bool {
    matches!(key, Key::Command(_) | Key::Order(_) | Key::Record(_))
}

/// One program's answer.
struct Answer {
    who: ZenohId,
    bytes: Vec<u8>,
}

fn nothing_asked() -> Reply {
    let detail = "nothing was asked: the query has no payload".to_owned();
    Reply::Refusal(Refusal { id: CommandId(String::new()), reason: Reason::Malformed, detail })
}
