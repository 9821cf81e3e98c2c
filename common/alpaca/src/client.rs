//! One Alpaca device: `get`, `put` and `image`, each with a total deadline, one at a time.

use std::sync::Arc;
use std::time::Duration;

use contract::{Kind, NoData};
use reqwest::header::{ACCEPT, AGE, CACHE_CONTROL, CONTENT_TYPE};
use reqwest::{Client, Response, Url};
use serde_json::Value;
use tokio::sync::{Mutex, MutexGuard};
use tokio::time::timeout;

use crate::body::{JSON_CAP, read_capped};
use crate::raw_image::RawImage;
use crate::response::{self, Answer};
use crate::transaction::Transactions;
use crate::{AlpacaError, Fault};

/// Total time for reading a property.
pub const STATUS_DEADLINE: Duration = Duration::from_secs(2);
/// Total time for a command to be taken.
pub const COMMAND_DEADLINE: Duration = Duration::from_secs(5);

/// Talks to one device of an Alpaca server. Cheap to clone; clones take turns.
#[derive(Clone)]
pub struct Alpaca {
    wire: Arc<Wire>,
    /// A device hears one request at a time, except where waiting could be dangerous.
    waits: bool,
}

struct Wire {
    ordinary: Client,
    /// Connections of their own for what must not wait behind a hung request.
    urgent: Client,
    server: String,
    kind: Kind,
    number: u32,
    transactions: Transactions,
    turn: Mutex<()>,
}

impl Alpaca {
    /// A device by its server (`host:port`), kind and number.
    ///
    /// A client that devices share spares those that are polled seldom a new connection for each poll; a request that
    /// hangs holds its own connection and nobody else's.
    pub fn new(ordinary: Client, server: &str, kind: Kind, number: u32) -> Result<Self, AlpacaError> {
        let wire = Wire {
            ordinary,
            urgent: http_client()?,
            server: server.to_owned(),
            kind,
            number,
            transactions: Transactions::fresh(),
            turn: Mutex::new(()),
        };
        Ok(Self { wire: Arc::new(wire), waits: true })
    }

    /// The same device by a connection of its own, which waits for no other request.
    pub fn at_once(&self) -> Self {
        Self { wire: self.wire.clone(), waits: false }
    }

    /// Reads a property, within 2 s from the moment it is this call's turn.
    pub async fn get(&self, member: &str) -> Result<Value, AlpacaError> {
        self.get_with(member, &[]).await
    }

    /// Reads a property that takes parameters.
    pub async fn get_with(&self, member: &str, parameters: &[(&str, &str)]) -> Result<Value, AlpacaError> {
        self.get_noting(member, parameters, || ()).await
    }

    /// As [`Self::get_with`]; `asks` is called when the request is about to be sent: the answer is at least as new.
    pub async fn get_noting(
        &self,
        member: &str,
        parameters: &[(&str, &str)],
        asks: impl FnOnce(),
    ) -> Result<Value, AlpacaError> {
        let _turn = self.my_turn().await;
        asks();
        let asking = async {
            match self.ask(member, parameters).await {
                // nothing was done yet, so one more try is harmless
                Err(AlpacaError::Transport { fault: Fault::Connect | Fault::Reset, .. }) => {
                    self.ask(member, parameters).await
                }
                other => other,
            }
        };
        let answer = timeout(STATUS_DEADLINE, asking)
            .await
            .unwrap_or_else(|_| Err(AlpacaError::timeout(STATUS_DEADLINE.as_secs_f64())))?;
        answer.value.ok_or(AlpacaError::NoValue)
    }

    /// Sets a property or calls a method, within 5 s; never sent twice.
    pub async fn put(&self, member: &str, parameters: &[(&str, &str)]) -> Result<(), AlpacaError> {
        self.put_within(member, parameters, COMMAND_DEADLINE).await
    }

    /// As [`Self::put`], for a method that blocks longer.
    pub async fn put_within(
        &self,
        member: &str,
        parameters: &[(&str, &str)],
        deadline: Duration,
    ) -> Result<(), AlpacaError> {
        self.send(member, parameters, deadline).await.map(|_| ())
    }

    /// Calls a method that answers, within 5 s; never sent twice. `None` where the answer has no value.
    pub async fn call(&self, member: &str, parameters: &[(&str, &str)]) -> Result<Option<Value>, AlpacaError> {
        self.send(member, parameters, COMMAND_DEADLINE).await.map(|answer| answer.value)
    }

    async fn send(&self, member: &str, parameters: &[(&str, &str)], deadline: Duration) -> Result<Answer, AlpacaError> {
        let _turn = self.my_turn().await;
        let asking = async {
            let (asked, ids) = self.ids();
            let form = encoded(parameters.iter().chain(&ids.pairs()));
            let send = async |client: &Client| {
                let request = client
                    .put(self.url(member, None))
                    .header(CONTENT_TYPE, "application/x-www-form-urlencoded")
                    .body(form.clone());
                let response = request.send().await.map_err(|error| AlpacaError::from_http(&error))?;
                self.read(response, asked).await
            };
            match send(self.client()).await {
                // no new connection could be made, so nothing was done: the polls' own may still stand
                Err(AlpacaError::Transport { fault: Fault::Connect, .. }) if !self.waits => {
                    send(&self.wire.ordinary).await
                }
                sent => sent,
            }
        };
        let late = || AlpacaError::timeout(deadline.as_secs_f64());
        timeout(deadline, asking).await.unwrap_or_else(|_| Err(late()))
    }

    /// Fetches the image of a camera as it comes; `pixels` is what is expected, for the deadline.
    pub async fn image(&self, pixels: u64) -> Result<RawImage, AlpacaError> {
        let _turn = self.my_turn().await;
        // 1 MB/s for 4 bytes a pixel and 10 s to begin with: a body that trickles must not hold the camera for ever
        let deadline = Duration::from_secs(10) + Duration::from_micros(pixels.saturating_mul(4));
        let fetching = async {
            let (asked, ids) = self.ids();
            let request = self
                .client()
                .get(self.url("imagearray", Some(&encoded(&ids.pairs()))))
                .header(ACCEPT, "application/imagebytes, application/json;q=0.5");
            let response = request.send().await.map_err(|error| AlpacaError::from_http(&error))?;
            RawImage::receive(response, pixels, &self.wire.transactions, asked).await
        };
        let late = || AlpacaError::timeout(deadline.as_secs_f64());
        timeout(deadline, fetching).await.unwrap_or_else(|_| Err(late()))
    }

    async fn my_turn(&self) -> Option<MutexGuard<'_, ()>> {
        if self.waits { Some(self.wire.turn.lock().await) } else { None }
    }

    fn client(&self) -> &Client {
        if self.waits { &self.wire.ordinary } else { &self.wire.urgent }
    }

    fn ids(&self) -> (u32, Ids) {
        let transaction = self.wire.transactions.next();
        let client = (std::process::id() & 0xFFFF).max(1);
        (transaction, Ids { client: client.to_string(), transaction: transaction.to_string() })
    }

    fn url(&self, member: &str, query: Option<&str>) -> String {
        let Wire { server, kind, number, .. } = &*self.wire;
        let question = if query.is_some() { "?" } else { "" };
        format!("http://{server}/api/v1/{kind}/{number}/{member}{question}{}", query.unwrap_or_default())
    }

    async fn ask(&self, member: &str, parameters: &[(&str, &str)]) -> Result<Answer, AlpacaError> {
        let (asked, ids) = self.ids();
        let query = encoded(parameters.iter().chain(&ids.pairs()));
        let request = self.client().get(self.url(member, Some(&query))).header(CACHE_CONTROL, "no-cache");
        let response = request.send().await.map_err(|error| AlpacaError::from_http(&error))?;
        let age = response.headers().get(AGE).map(|age| age.to_str().unwrap_or_default().trim().to_owned());
        let answer = self.read(response, asked).await?;
        match age {
            // what was read from the device just now
            None => Ok(answer),
            Some(age) if age.parse() == Ok(0_u32) => Ok(answer),
            Some(age) => {
                let detail = format!("a cache between here and the device says that its answer is {age:?} s old");
                Err(AlpacaError::Value(NoData::new("stale", detail)))
            }
        }
    }

    /// Reads the answer to request `asked`: of any device only the answer to this request, of a safety monitor only
    /// one that is exactly right.
    async fn read(&self, response: Response, asked: u32) -> Result<Answer, AlpacaError> {
        let status = response.status().as_u16();
        let body = read_capped(response, JSON_CAP).await?;
        match self.wire.kind {
            Kind::SafetyMonitor => response::parse_exactly(status, &body, &self.wire.transactions, asked),
            _ => response::parse(status, &body, &self.wire.transactions, asked),
        }
    }
}

/// The ids that each request carries.
struct Ids {
    client: String,
    transaction: String,
}

impl Ids {
    fn pairs(&self) -> [(&str, &str); 2] {
        [("ClientID", &self.client), ("ClientTransactionID", &self.transaction)]
    }
}

/// An HTTP client: no proxy, no redirects, no connection older than servers keep theirs.
pub fn http_client() -> Result<Client, AlpacaError> {
    local_http::client_builder()
        .connect_timeout(Duration::from_secs(2))
        // servers close idle connections after 5 s
        .pool_idle_timeout(Duration::from_secs(4))
        .tcp_nodelay(true)
        .build()
        .map_err(|error| AlpacaError::from_http(&error))
}

/// Name-value pairs as a query or a form writes them.
fn encoded<'a>(pairs: impl IntoIterator<Item = &'a (&'a str, &'a str)>) -> String {
    // the url crate behind reqwest knows the rules; the address is of no interest
    let Ok(mut url) = Url::parse("http://a/") else { return String::new() };
    url.query_pairs_mut().extend_pairs(pairs.into_iter().copied());
    url.query().unwrap_or_default().to_owned()
}

#[cfg(test)]
#[path = "client_tests.rs"]
mod tests;
