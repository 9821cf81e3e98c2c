//! One question to a web service; TLS by rustls and the host's own root certificates.

use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use bytes::Bytes;
use http_body_util::{BodyExt as _, Empty, Limited};
use hyper::header::USER_AGENT;
use hyper::{Request, Uri};
use hyper_rustls::HttpsConnectorBuilder;
use hyper_util::client::legacy::Client;
use hyper_util::rt::TokioExecutor;

/// The whole exchange, machine time.
const TIMEOUT: Duration = Duration::from_secs(30);
/// An answer about one name has some kilobytes.
const MOST_BYTES: usize = 1_000_000;

/// The answer's text; anything but a 2xx answer in time is an error.
pub async fn get(url: &str) -> anyhow::Result<String> {
    tokio::time::timeout(TIMEOUT, exchange(url)).await.context("it did not answer within 30 s")?
}

async fn exchange(url: &str) -> anyhow::Result<String> {
    let uri: Uri = url.parse().with_context(|| format!("{url} is no web address"))?;
    let provider = rustls::crypto::ring::default_provider();
    // Reading the host's certificates takes some milliseconds of the disk.
    let own = provider.clone();
    let believing = tokio::task::spawn_blocking(|| HttpsConnectorBuilder::new().with_provider_and_native_roots(own));
    let connector = match believing.await? {
        Ok(builder) => builder,
        Err(error) if uri.scheme_str() == Some("https") => {
            bail!("this host has no root certificates ({error}): install the package ca-certificates")
        }
        Err(_) => {
            let config = rustls::ClientConfig::builder_with_provider(provider.into())
                .with_safe_default_protocol_versions()?
                .with_root_certificates(rustls::RootCertStore::empty())
                .with_no_client_auth();
            HttpsConnectorBuilder::new().with_tls_config(config)
        }
    };
    let connector = connector.https_or_http().enable_http1().build();
    let client = Client::builder(TokioExecutor::new()).build::<_, Empty<Bytes>>(connector);
    let request = Request::get(uri).header(USER_AGENT, "starmesh").body(Empty::new())?;
    let answer = client.request(request).await.context("it cannot be reached")?;
    let status = answer.status();
    ensure!(status.is_success(), "it answered {status}");
    let body = Limited::new(answer.into_body(), MOST_BYTES).collect().await;
    let body = body.map_err(|error| anyhow::anyhow!("its answer broke off: {error}"))?.to_bytes();
    Ok(String::from_utf8_lossy(&body).into_owned())
}

/// A value in a URL, percent-encoded.
pub fn encoded(value: &str) -> String {
    let mut said = String::new();
    for byte in value.trim().bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'.' | b'_' => said.push(char::from(byte)),
            byte => said += &format!("%{byte:02X}"),
        }
    }
    said
}
