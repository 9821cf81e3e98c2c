//! HTTP requests to the outside, with TLS where the URL asks for it.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context as _, anyhow, ensure};
use bytes::Bytes;
use http_body_util::{BodyExt as _, Full, Limited};
use hyper::{Method, Request, header};
use hyper_rustls::{HttpsConnector, HttpsConnectorBuilder};
use hyper_util::client::legacy::Client;
use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::rt::TokioExecutor;

use crate::trust;

/// One receiver's client. It is made anew after a failure, so that renewed certificates are accepted.
#[derive(Default)]
pub struct Http {
    client: Option<HttpClient>,
}

type HttpClient = Client<HttpsConnector<HttpConnector>, Full<Bytes>>;

/// The whole exchange, machine time.
const TIMEOUT: Duration = Duration::from_secs(20);
/// No more of an answer is read.
const MOST_BYTES: usize = 64 * 1024;

/// One request.
pub struct Ask<'a> {
    /// The method.
    pub method: Method,
    /// The URL; it may be a secret.
    pub url: &'a str,
    /// Bearer token.
    pub token: Option<&'a str>,
    /// JSON, or nothing.
    pub body: String,
}

impl Http {
    /// Sends one request; anything but a 2xx answer in time is an error. No message contains the URL or the token.
    pub async fn ask(&mut self, ask: Ask<'_>, ca_file: Option<&Path>) -> anyhow::Result<()> {
        let client = match self.client.take() {
            Some(client) => client,
            None => client(ask.url, ca_file).await?,
        };
        let exchange = tokio::time::timeout(TIMEOUT, exchange(&client, ask)).await;
        exchange.context("it did not answer within 20 s")??;
        self.client = Some(client);
        Ok(())
    }
}

/// A receiver without TLS is reached whatever is wrong with certificates.
async fn client(url: &str, ca_file: Option<&Path>) -> anyhow::Result<HttpClient> {
    let tls = if url.starts_with("https:") { trust::tls(ca_file).await? } else { trust::nobody()? };
    let connector = HttpsConnectorBuilder::new().with_tls_config(tls).https_or_http().enable_http1().build();
    Ok(Client::builder(TokioExecutor::new()).build(connector))
}

async fn exchange(client: &HttpClient, ask: Ask<'_>) -> anyhow::Result<()> {
    let Ask { method, url, token, body } = ask;
    let mut request = Request::builder().method(method).uri(url).header(header::USER_AGENT, "starmesh");
    if !body.is_empty() {
        request = request.header(header::CONTENT_TYPE, "application/json");
    }
    if let Some(token) = token {
        request = request.header(header::AUTHORIZATION, format!("Bearer {token}"));
    }
    let request = request.body(Full::new(Bytes::from(body))).context("its URL or its token cannot be sent")?;
    let answer = client.request(request).await.map_err(|error| match trust::explain(&error) {
        Some(why) => anyhow!(why),
        None => anyhow::Error::new(error).context("it cannot be reached"),
    })?;
    let status = answer.status();
    // The answer is read whole, so that the connection can be used again.
    let _ = Limited::new(answer.into_body(), MOST_BYTES).collect().await;
    ensure!(status.is_success(), "it answered {status}");
    Ok(())
}
