//! HTTP requests to receivers of alerts.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context as _, ensure};
use internet::{Client, Method, Request, header};

/// One receiver's client. It is made anew after a failure, so that renewed certificates are accepted.
#[derive(Default)]
pub struct Http {
    client: Option<Client>,
}

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
            None => Client::new(ask.url, ca_file).await?,
        };
        let exchange = tokio::time::timeout(TIMEOUT, exchange(&client, ask)).await;
        exchange.context("it did not answer within 20 s")??;
        self.client = Some(client);
        Ok(())
    }
}

async fn exchange(client: &Client, ask: Ask<'_>) -> anyhow::Result<()> {
    let Ask { method, url, token, body } = ask;
    let mut request = Request::builder().method(method).uri(url);
    if !body.is_empty() {
        request = request.header(header::CONTENT_TYPE, "application/json");
    }
    if let Some(token) = token {
        request = request.header(header::AUTHORIZATION, format!("Bearer {token}"));
    }
    let mut answer = client.send(request, body).await?;
    let status = answer.status();
    // The answer is read whole, so that the connection can be used again.
    let _ = internet::first_bytes(&mut answer, MOST_BYTES).await;
    ensure!(status.is_success(), "it answered {status}");
    Ok(())
}
