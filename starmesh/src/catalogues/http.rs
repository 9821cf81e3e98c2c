//! Sends a question to a web service and writes its answer into a file; TLS by rustls and the host's own root
//! certificates.

use std::io::Write as _;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use bytes::Bytes;
use http_body_util::{BodyExt as _, Full};
use hyper::header::{CONTENT_TYPE, LOCATION, USER_AGENT};
use hyper::{Method, Request, Uri};
use hyper_rustls::HttpsConnectorBuilder;
use hyper_util::client::legacy::Client;
use hyper_util::rt::TokioExecutor;

/// TAP services may redirect to the address of the answer; more redirections than this are a circle.
const MOST_REDIRECTIONS: usize = 5;
/// The part of an answer that is no table which an error quotes, bytes.
const SHOWN: usize = 4096;

/// Sends a form and writes the answer to `file`; anything but a 2xx answer in time is an error with the message of the
/// service.
pub async fn post(url: &str, form: &[(&str, &str)], file: &Path, timeout: Duration) -> anyhow::Result<()> {
    let body: Vec<String> = form.iter().map(|(name, value)| format!("{name}={}", encoded(value))).collect();
    let exchange = exchange(url, body.join("&"), file);
    let waited = tokio::time::timeout(timeout, exchange).await;
    waited.with_context(|| format!("no whole answer within {:.0} s", timeout.as_secs_f64()))?
}

async fn exchange(url: &str, form: String, file: &Path) -> anyhow::Result<()> {
    let mut uri: Uri = url.parse().with_context(|| format!("{url} is no web address"))?;
    let provider = rustls::crypto::ring::default_provider();
    let connector = match HttpsConnectorBuilder::new().with_provider_and_native_roots(provider.clone()) {
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
    let client = Client::builder(TokioExecutor::new()).build::<_, Full<Bytes>>(connector);
    let (mut method, mut form) = (Method::POST, form);
    for _ in 0..=MOST_REDIRECTIONS {
        let mut request = Request::builder().method(method.clone()).uri(uri.clone()).header(USER_AGENT, "starmesh");
        if method == Method::POST {
            request = request.header(CONTENT_TYPE, "application/x-www-form-urlencoded");
        }
        let request = request.body(Full::new(Bytes::from(form.clone()))).context("the question cannot be sent")?;
        let answer = client.request(request).await.context("it cannot be reached")?;
        let status = answer.status();
        if status.is_redirection() {
            let place = answer.headers().get(LOCATION).and_then(|place| place.to_str().ok());
            let next = absolute(&uri, place.context("it redirects to nowhere")?)?;
            ensure!(
                next.scheme_str() == Some("https") || uri.scheme_str() == Some("http"),
                "it redirects from https to {next}, which anybody could listen to"
            );
            (uri, method) = (next, if status.as_u16() >= 307 { method } else { Method::GET });
            if method == Method::GET {
                form.clear();
            }
            continue;
        }
        let mut body = answer.into_body();
        if !status.is_success() {
            let mut said = Vec::new();
            while let Some(Ok(frame)) = body.frame().await
                && said.len() < SHOWN
            {
                said.extend(frame.into_data().unwrap_or_default());
            }
            bail!("it answered {status}: {}", plain(&String::from_utf8_lossy(&said)));
        }
        let broken = || format!("{} cannot be written", file.display());
        let mut file = std::fs::File::create(file).with_context(broken)?;
        while let Some(frame) = body.frame().await {
            let data = frame.context("the answer broke off")?.into_data().unwrap_or_default();
            file.write_all(&data).with_context(broken)?;
        }
        return file.sync_all().with_context(broken);
    }
    bail!("it redirects in a circle")
}

/// The address in a redirection: whole, or within the same host.
fn absolute(from: &Uri, place: &str) -> anyhow::Result<Uri> {
    let whole = if place.starts_with('/') {
        let host = from.authority().map(ToString::to_string).unwrap_or_default();
        format!("{}://{host}{place}", from.scheme_str().unwrap_or("http"))
    } else {
        place.to_owned()
    };
    let uri: Uri = whole.parse().with_context(|| format!("it redirects to {place:?}, which is no web address"))?;
    ensure!(uri.authority().is_some(), "it redirects to {place:?}, expected a whole web address");
    Ok(uri)
}

/// A value of a form (application/x-www-form-urlencoded).
fn encoded(value: &str) -> String {
    let mut said = String::new();
    for byte in value.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'.' | b'_' => said.push(char::from(byte)),
            b' ' => said.push('+'),
            byte => said += &format!("%{byte:02X}"),
        }
    }
    said
}

/// The words of an answer in markup.
pub fn plain(markup: &str) -> String {
    let (mut said, mut is_tag) = (String::new(), false);
    for letter in markup.chars() {
        match letter {
            '<' => is_tag = true,
            '>' => {
                is_tag = false;
                said.push(' ');
            }
            letter if !is_tag => said.push(letter),
            _ => {}
        }
    }
    let words: Vec<&str> = said.split_whitespace().collect();
    if words.is_empty() { "nothing".to_owned() } else { short(&words.join(" ")) }
}

/// The first words.
pub fn short(text: &str) -> String {
    let cut: String = text.chars().take(300).collect();
    if cut.len() < text.len() { format!("{cut} ...") } else { cut }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_and_redirections_are_read_as_they_are_meant() {
        assert_eq!(encoded("a <= 'b', 1+2é"), "a+%3C%3D+%27b%27%2C+1%2B2%C3%A9");
        assert_eq!(plain("<a><INFO value=\"ERROR\">Cannot parse\n query</INFO></a>"), "Cannot parse query");
        assert_eq!(plain("<a/>"), "nothing");
        let from: Uri = "http://127.0.0.1:8080/tap/sync".parse().unwrap();
        assert_eq!(absolute(&from, "/job/1").unwrap().to_string(), "http://127.0.0.1:8080/job/1");
        assert_eq!(absolute(&from, "https://x.org/1").unwrap().to_string(), "https://x.org/1");
        assert!(absolute(&from, "job/1").is_err());
    }
}
