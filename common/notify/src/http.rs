//! HTTP to the outside, with TLS by rustls and ring and the host's own root certificates.

use std::time::Duration;

use anyhow::{Context as _, ensure};
use bytes::Bytes;
use http_body_util::{BodyExt as _, Full, Limited};
use hyper::{Method, Request, header};
use hyper_rustls::{HttpsConnector, HttpsConnectorBuilder};
use hyper_util::client::legacy::Client;
use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::rt::TokioExecutor;

/// One receiver's client.
pub struct Http {
    client: Client<HttpsConnector<HttpConnector>, Full<Bytes>>,
}

/// The whole exchange, machine time.
const TIMEOUT: Duration = Duration::from_secs(20);
/// Nobody needs more of an answer.
const MOST_BYTES: usize = 64 * 1024;

impl Http {
    /// A client; a host without root certificates can only reach `http://`.
    pub fn new() -> anyhow::Result<Self> {
        let provider = rustls::crypto::ring::default_provider();
        let roots = match HttpsConnectorBuilder::new().with_provider_and_native_roots(provider.clone()) {
            Ok(builder) => builder,
            Err(error) => {
                tracing::warn!(%error, "this host has no root certificates: no https receiver can be reached");
                let config = rustls::ClientConfig::builder_with_provider(provider.into())
                    .with_safe_default_protocol_versions()?
                    .with_root_certificates(rustls::RootCertStore::empty())
                    .with_no_client_auth();
                HttpsConnectorBuilder::new().with_tls_config(config)
            }
        };
        let connector = roots.https_or_http().enable_http1().build();
        Ok(Self { client: Client::builder(TokioExecutor::new()).build(connector) })
    }

    /// Sends one request; anything but a 2xx answer in time is an error. No message holds the URL.
    pub async fn ask(&self, method: Method, url: &str, token: Option<&str>, body: String) -> anyhow::Result<()> {
        let mut request = Request::builder().method(method).uri(url).header(header::USER_AGENT, "starmesh");
        if !body.is_empty() {
            request = request.header(header::CONTENT_TYPE, "application/json");
        }
        if let Some(token) = token {
            request = request.header(header::AUTHORIZATION, format!("Bearer {token}"));
        }
        let request = request.body(Full::new(Bytes::from(body))).context("its URL or its token cannot be sent")?;
        let exchange = async {
            let answer = self.client.request(request).await.context("it cannot be reached")?;
            let status = answer.status();
            // read whole, so that the connection can be used again
            let _ = Limited::new(answer.into_body(), MOST_BYTES).collect().await;
            ensure!(status.is_success(), "it answered {status}");
            Ok(())
        };
        tokio::time::timeout(TIMEOUT, exchange).await.context("it did not answer within 20 s")?
    }
}
