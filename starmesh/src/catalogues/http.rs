//! Sends a question to a web service and writes its answer into a file.

use std::io::Write as _;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use internet::header::{CONTENT_TYPE, LOCATION};
use internet::{Client, Method, Request, Uri};

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
    let (mut method, mut form) = (Method::POST, form);
    for _ in 0..=MOST_REDIRECTIONS {
        let mut request = Request::builder().method(method.clone()).uri(uri.clone());
        if method == Method::POST {
            request = request.header(CONTENT_TYPE, "application/x-www-form-urlencoded");
        }
        // A client for each: a redirection may lead to TLS, which asks for certificates.
        let client = Client::new(&uri.to_string(), None).await?;
        let mut answer = client.send(request, form.clone()).await?;
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
        if !status.is_success() {
            let text = internet::first_bytes(&mut answer, SHOWN).await;
            bail!("it answered {status}: {}", plain(&String::from_utf8_lossy(&text)));
        }
        let broken = || format!("{} cannot be written", file.display());
        let mut file = std::fs::File::create(file).with_context(broken)?;
        while let Some(data) = internet::next_bytes(&mut answer).await? {
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
    let mut text = String::new();
    for byte in value.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'.' | b'_' => text.push(char::from(byte)),
            b' ' => text.push('+'),
            byte => text += &format!("%{byte:02X}"),
        }
    }
    text
}

/// The words of an answer in markup.
pub fn plain(markup: &str) -> String {
    let (mut text, mut is_tag) = (String::new(), false);
    for letter in markup.chars() {
        match letter {
            '<' => is_tag = true,
            '>' => {
                is_tag = false;
                text.push(' ');
            }
            letter if !is_tag => text.push(letter),
            _ => {}
        }
    }
    let words: Vec<&str> = text.split_whitespace().collect();
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
