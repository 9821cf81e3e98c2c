//! HTTP requests to receivers of alerts.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context as _, ensure};
use internet::{Client, Method, Request, StatusCode, header};

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
    /// Its headers.
    pub headers: Vec<(header::HeaderName, String)>,
    /// What is sent.
    pub body: Vec<u8>,
    /// A stranger named the server: only one of the public internet is asked.
    pub is_strangers: bool,
}

impl<'a> Ask<'a> {
    /// Of a server that the configuration names, with a bearer token and JSON, or nothing.
    pub fn new(method: Method, url: &'a str, token: Option<&str>, json: String) -> Self {
        let kind = (!json.is_empty()).then(|| (header::CONTENT_TYPE, "application/json".to_owned()));
        let token = token.map(|token| (header::AUTHORIZATION, format!("Bearer {token}")));
        let headers = kind.into_iter().chain(token).collect();
        Self { method, url, headers, body: json.into_bytes(), is_strangers: false }
    }
}

impl Http {
    /// Sends one request; anything but a 2xx answer in time is an error. No message contains the URL or the token.
    pub async fn ask(&mut self, ask: Ask<'_>, ca_file: Option<&Path>) -> anyhow::Result<()> {
        let status = self.status(ask, ca_file).await?;
        ensure!(status.is_success(), "it answered {status}");
        Ok(())
    }

    /// Sends one request; no answer in time is an error.
    pub async fn status(&mut self, ask: Ask<'_>, ca_file: Option<&Path>) -> anyhow::Result<StatusCode> {
        let client = match self.client.take() {
            Some(client) => client,
            None if ask.is_strangers => Client::public(ask.url, ca_file).await?,
            None => Client::new(ask.url, ca_file).await?,
        };
        let exchange = tokio::time::timeout(TIMEOUT, exchange(&client, ask)).await;
        let status = exchange.context("it did not answer within 20 s")??;
        if status.is_success() {
            self.client = Some(client);
        }
        Ok(status)
    }
}

async fn exchange(client: &Client, ask: Ask<'_>) -> anyhow::Result<StatusCode> {
    let Ask { method, url, headers, body, .. } = ask;
    let request = Request::builder().method(method).uri(url);
    let request = headers.into_iter().fold(request, |request, (name, value)| request.header(name, value));
    let mut answer = client.send(request, body).await?;
    let status = answer.status();
    // The answer is read whole, so that the connection can be used again.
    let _ = internet::first_bytes(&mut answer, MOST_BYTES).await;
    Ok(status)
}
