//! HTTP to servers outside the observatory: receivers of alerts, services of names and of star catalogues.
//!
//! [`Client`] is the only such client; the crate `local_http` makes those for hardware and for our own addresses. TLS is done by rustls with
//! ring and accepts the authorities that the host accepts ([`trust`]). reqwest, which the local clients use, stays without TLS: with it, each
//! client that is made without a provider of cryptography would panic. A client for addresses that strangers chose ([`Client::public`]) connects
//! to the public internet alone.
//!
//! # Invariants
//!
//! - No message of an error contains the URL, because a URL may be a secret.

mod names;
pub mod trust;

use std::path::Path;

use anyhow::{Context as _, anyhow, ensure};
use bytes::Bytes;
use http_body_util::{BodyExt as _, Full};
use hyper::body::Incoming;
use hyper_rustls::{HttpsConnector, HttpsConnectorBuilder};
use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::rt::TokioExecutor;

use names::Names;

pub use hyper::{Method, Request, Response, StatusCode, Uri, header, http::request};

/// A client that follows no redirection, uses no proxy, and waits as long as its caller does.
#[derive(Debug, Clone)]
pub struct Client(hyper_util::client::legacy::Client<HttpsConnector<HttpConnector<Names>>, Full<Bytes>>);

impl Client {
    /// A client for the server of a URL; `ca_file` holds authorities in addition to the host's. A server without TLS is
    /// reached whatever is wrong with certificates.
    ///
    /// # Errors
    /// The certificates cannot be read, or there are none and the server needs one.
    pub async fn new(url: &str, ca_file: Option<&Path>) -> anyhow::Result<Self> {
        Self::to(url, ca_file, false).await
    }

    /// The same for a server that somebody else named: one without TLS is not reached, nor one whose name leads to an address of this host
    /// or of a private network.
    ///
    /// # Errors
    /// As for [`Client::new`], or the URL has an address in the place of a name.
    pub async fn public(url: &str, ca_file: Option<&Path>) -> anyhow::Result<Self> {
        let uri = url.parse::<Uri>().ok();
        let host = uri.as_ref().and_then(Uri::host).unwrap_or_default();
        // Nothing resolves an address: it would be connected to as it is.
        let is_address = host.trim_matches(['[', ']']).parse::<std::net::IpAddr>().is_ok();
        ensure!(!is_address, "it is named by its address: expected a name of the public internet");
        Self::to(url, ca_file, true).await
    }

    async fn to(url: &str, ca_file: Option<&Path>, public_only: bool) -> anyhow::Result<Self> {
        let has_tls = url.parse::<Uri>().is_ok_and(|uri| uri.scheme_str() == Some("https"));
        let tls = if has_tls { trust::tls(ca_file).await? } else { trust::nobody()? };
        let mut tcp = HttpConnector::new_with_resolver(Names::new(public_only));
        tcp.enforce_http(false);
        let connector = HttpsConnectorBuilder::new().with_tls_config(tls);
        let connector = if public_only { connector.https_only() } else { connector.https_or_http() };
        let connector = connector.enable_http1().wrap_connector(tcp);
        Ok(Self(hyper_util::client::legacy::Client::builder(TokioExecutor::new()).build(connector)))
    }

    /// Sends a request; the answer may have any status.
    ///
    /// # Errors
    /// The request makes no sense, or the server cannot be reached: with the reason and what to do.
    pub async fn send(&self, request: request::Builder, body: impl Into<Bytes>) -> anyhow::Result<Response<Incoming>> {
        let request = request.header(header::USER_AGENT, "starmesh").body(Full::new(body.into()));
        let request = request.context("its URL or its token has characters that no request may have")?;
        self.0.request(request).await.map_err(|error| match trust::explain(&error) {
            Some(why) => anyhow!(why),
            None => anyhow::Error::new(error).context("it cannot be reached"),
        })
    }
}

/// A request that did not get an answer.
pub type SendError = hyper_util::client::legacy::Error;

impl Client {
    /// Sends a request as it is, for services whose requests are signed.
    ///
    /// # Errors
    /// The server cannot be reached, or TLS refused it: [`trust::explain`] says why.
    pub async fn send_whole(&self, request: Request<Bytes>) -> Result<Response<Incoming>, SendError> {
        self.0.request(request.map(Full::new)).await
    }
}

/// The next piece of an answer.
///
/// # Errors
/// The answer broke off.
pub async fn next_bytes(answer: &mut Response<Incoming>) -> anyhow::Result<Option<Bytes>> {
    while let Some(frame) = answer.body_mut().frame().await {
        if let Ok(data) = frame.context("its answer broke off")?.into_data() {
            return Ok(Some(data));
        }
    }
    Ok(None)
}

/// The first bytes of an answer, at most so many, to quote; what came of it, where it breaks off.
pub async fn first_bytes(answer: &mut Response<Incoming>, most: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    while bytes.len() < most
        && let Ok(Some(data)) = next_bytes(answer).await
    {
        bytes.extend_from_slice(&data[..data.len().min(most - bytes.len())]);
    }
    bytes
}

/// A whole answer.
///
/// # Errors
/// The answer broke off, or has more than `most` bytes.
pub async fn whole_bytes(answer: &mut Response<Incoming>, most: usize) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    while let Some(data) = next_bytes(answer).await? {
        ensure!(bytes.len() + data.len() <= most, "its answer has more than {most} bytes");
        bytes.extend_from_slice(&data);
    }
    Ok(bytes)
}
