//! Questions and commands: asked of one key, answered at once, and *unknown* when no answer comes.

use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use contract::{Accepted, Command, Device, Key, Payload, Refusal, Reply, Stamped};
use serde::de::DeserializeOwned;
use zenoh::bytes::Encoding;
use zenoh::qos::Priority;
use zenoh::query::Query;

use crate::{Bus, BusError};

/// Why a question has no answer.
#[derive(Debug, thiserror::Error)]
pub enum AskError {
    /// Nobody answered, or too late: whether it was done is unknown, look at the state.
    #[error("no answer from {key} within {timeout_s} s; whether it was done is unknown")]
    Unknown {
        /// Who was asked.
        key: String,
        /// How long was waited.
        timeout_s: f64,
    },
    /// The answer could not be read.
    #[error("{key} answered what cannot be read: {detail}")]
    Unreadable {
        /// Who was asked.
        key: String,
        /// What is wrong.
        detail: String,
    },
    /// The answer is a refusal.
    #[error("{key}: {refusal}")]
    Refused {
        /// Who was asked.
        key: String,
        /// What it said.
        #[source]
        refusal: Refusal,
    },
}

/// A key that is answered; it falls silent when this is dropped.
pub struct Service {
    _queryable: zenoh::query::Queryable<()>,
}

impl Bus {
    /// Asks one question and returns the first answer.
    pub async fn ask<Q: Payload, A: DeserializeOwned>(
        &self,
        key: &Key,
        question: &Q,
        timeout: Duration,
    ) -> Result<A, AskError> {
        let key = key.to_string();
        let unreadable = |key: &str, detail: String| AskError::Unreadable { key: key.to_owned(), detail };
        let payload = serde_json::to_vec(question).map_err(|error| unreadable(&key, error.to_string()))?;
        let replies = self
            .session
            .get(key.clone())
            .payload(payload)
            .encoding(Encoding::APPLICATION_JSON)
            .priority(Priority::InteractiveHigh)
            .express(true)
            .timeout(timeout)
            .with(zenoh::handlers::FifoChannel::new(4))
            .await;
        let unknown = || AskError::Unknown { key: key.clone(), timeout_s: timeout.as_secs_f64() };
        let replies = replies.map_err(|_| unknown())?;
        match replies.recv_async().await.map(zenoh::query::Reply::into_result) {
            Ok(Ok(sample)) => serde_json::from_slice(&sample.payload().to_bytes())
                .map_err(|error| unreadable(&key, error.to_string())),
            // an error reply is zenoh's own word for a timeout; our refusals are ordinary answers
            Ok(Err(_)) | Err(_) => Err(unknown()),
        }
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
            Reply::Accepted(accepted) => Ok(accepted),
            Reply::Refusal(refusal) => Err(AskError::Refused { key: key.to_string(), refusal }),
        }
    }

    /// Answers a key: `answer` gets each question, or why it could not be read.
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
        let declared = self.session.declare_queryable(text).callback(move |query: Query| {
            let bytes = query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
            let question = serde_json::from_slice::<Q>(&bytes).map_err(|error| error.to_string());
            let (answer, key) = (answer.clone(), own_key.clone());
            runtime.spawn(async move {
                let body = answer(question).await;
                let Ok(bytes) = serde_json::to_vec(&body) else { return };
                if let Err(error) = query.reply(key, bytes).encoding(Encoding::APPLICATION_JSON).await {
                    tracing::debug!(%error, "a question left before its answer");
                }
            });
        });
        let failed = |source| BusError::Declare { what: "a service", key: key.to_string(), source };
        Ok(Service { _queryable: declared.await.map_err(failed)? })
    }

    /// Asks for the newest payloads of all keys of an expression.
    pub async fn get_all<T: Payload>(&self, expression: &str, timeout: Duration) -> Vec<(Key, Stamped<T>)> {
        let asked = self.session.get(expression.to_owned()).timeout(timeout);
        let Ok(replies) = asked.with(zenoh::handlers::FifoChannel::new(4096)).await else { return Vec::new() };
        let mut found = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            let Ok(sample) = reply.into_result() else { continue };
            let key = Key::parse(sample.key_expr().as_str());
            let said = serde_json::from_slice(&sample.payload().to_bytes());
            if let (Some(key), Ok(said)) = (key, said) {
                found.push((key, said));
            }
        }
        found
    }
}
