//! The requests of the object store through the project's own client, so that there is one TLS.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use http_body_util::{BodyExt as _, Limited};
use internet::header::{HeaderValue, IF_MATCH, IF_NONE_MATCH};
use internet::{Method, StatusCode};
use object_store::ClientOptions;
use object_store::client::{
    HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpResponse, HttpResponseBody, HttpService,
};

/// A request has so long for the head of its answer, plus what its bytes take at this rate.
const TIMEOUT: Duration = Duration::from_secs(if cfg!(test) { 2 } else { 60 });
const SLOWEST_BYTES_PER_S: u64 = 20_000;

/// An answer that is not the content of an object has at most so many bytes; a list of 1,000 names has some 400,000.
const MOST_ANSWER_BYTES: usize = 4 << 20;

/// Makes the client of the store's requests.
#[derive(Debug, Clone)]
pub struct Connector {
    /// What they go through.
    pub client: internet::Client,
    /// An upload in parts makes only objects whose names nothing has.
    pub create_only: bool,
    /// Becomes true when a request with a condition is answered by "not implemented".
    pub has_no_conditions: Arc<AtomicBool>,
}

impl HttpConnector for Connector {
    fn connect(&self, _: &ClientOptions) -> object_store::Result<HttpClient> {
        Ok(HttpClient::new(Service(self.clone())))
    }
}

#[derive(Debug)]
struct Service(Connector);

/// What went wrong with a request, in words.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct RequestFailed(String);

fn failed(kind: HttpErrorKind, why: String) -> HttpError {
    HttpError::new(kind, RequestFailed(why))
}

impl HttpService for Service {
    fn call<'a, 'b>(
        &'a self,
        request: HttpRequest,
    ) -> Pin<Box<dyn Future<Output = Result<HttpResponse, HttpError>> + Send + 'b>>
    where
        'a: 'b,
        Self: 'b,
    {
        Box::pin(self.send(request))
    }
}

impl Service {
    async fn send(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        let (mut parts, body) = request.into_parts();
        let body = body.collect().await?.to_bytes();
        let query = parts.uri.query().unwrap_or_default();
        let (is_content, is_end) = (
            parts.method == Method::GET && !query.contains("list-type="),
            parts.method == Method::POST && query.contains("uploadId="),
        );
        if is_end && self.0.create_only {
            // The last request of an upload in parts, which makes the object. The signature does not cover it.
            parts.headers.insert(IF_NONE_MATCH, HeaderValue::from_static("*"));
        }
        let has_condition = parts.headers.contains_key(IF_NONE_MATCH) || parts.headers.contains_key(IF_MATCH);
        let most = TIMEOUT + Duration::from_secs(body.len() as u64 / SLOWEST_BYTES_PER_S);
        let request = internet::Request::from_parts(parts, body);
        let answer = match tokio::time::timeout(most, self.0.client.send_whole(request)).await {
            Ok(Ok(answer)) => answer,
            Ok(Err(error)) => {
                let (kind, why) = match internet::trust::explain(&error) {
                    Some(why) => (HttpErrorKind::Unknown, why),
                    None if error.is_connect() => (HttpErrorKind::Connect, format!("it cannot be reached: {error:?}")),
                    None => (HttpErrorKind::Interrupted, format!("the connection broke: {error:?}")),
                };
                return Err(failed(kind, why));
            }
            Err(_) => {
                let why = format!("it did not answer within {} s", most.as_secs());
                return Err(failed(HttpErrorKind::Timeout, why));
            }
        };
        let (parts, body) = answer.into_parts();
        if has_condition && parts.status == StatusCode::NOT_IMPLEMENTED {
            self.0.has_no_conditions.store(true, Ordering::Relaxed);
        }
        let broken = |error| failed(HttpErrorKind::Interrupted, format!("its answer broke off: {error}"));
        if is_content && parts.status.is_success() {
            // The reader waits for each piece with a limit.
            return Ok(HttpResponse::from_parts(parts, HttpResponseBody::new(body.map_err(broken))));
        }
        let whole = tokio::time::timeout(TIMEOUT, Limited::new(body, MOST_ANSWER_BYTES).collect()).await;
        let late = |_| failed(HttpErrorKind::Timeout, format!("its answer did not end within {} s", TIMEOUT.as_secs()));
        let whole = whole
            .map_err(late)?
            .map_err(|error| failed(HttpErrorKind::Interrupted, format!("its answer broke off: {error}")))?;
        Ok(HttpResponse::from_parts(parts, whole.to_bytes().into()))
    }
}
