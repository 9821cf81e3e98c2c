//! One question to a web service.

use std::time::Duration;

use anyhow::{Context as _, ensure};

/// The whole exchange, machine time.
const TIMEOUT: Duration = Duration::from_secs(30);
/// An answer about one name has some kilobytes.
const MOST_BYTES: usize = 1_000_000;

/// The answer's text; anything but a 2xx answer in time is an error.
pub async fn get(url: &str) -> anyhow::Result<String> {
    tokio::time::timeout(TIMEOUT, exchange(url)).await.context("it did not answer within 30 s")?
}

async fn exchange(url: &str) -> anyhow::Result<String> {
    let client = internet::Client::new(url, None).await?;
    let mut answer = client.send(internet::Request::get(url), String::new()).await?;
    let status = answer.status();
    ensure!(status.is_success(), "it answered {status}");
    let body = internet::whole_bytes(&mut answer, MOST_BYTES).await?;
    Ok(String::from_utf8_lossy(&body).into_owned())
}

/// A value in a URL, percent-encoded.
pub fn encoded(value: &str) -> String {
    let mut text = String::new();
    for byte in value.trim().bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'.' | b'_' => text.push(char::from(byte)),
            byte => text += &format!("%{byte:02X}"),
        }
    }
    text
}
