//! What every request must look like before anybody asks from whom it is.

use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, Method, header};

use crate::gate::Gate;
use crate::problem::{Code, Problem};

/// Headers that decide something: of two of them, a proxy and this server might each believe another one.
const ONCE: [HeaderName; 8] = [
    header::HOST,
    header::AUTHORIZATION,
    header::COOKIE,
    header::ORIGIN,
    header::CONTENT_TYPE,
    header::CONTENT_LENGTH,
    header::TRANSFER_ENCODING,
    header::UPGRADE,
];
/// Added by proxies; each of them says that the request does not come from where its connection does.
const FORWARDED: [&str; 4] = ["forwarded", "x-forwarded-for", "x-forwarded-host", "x-real-ip"];

/// Refuses what is ambiguous, and what a page of another server made a browser send.
///
/// # Errors
/// 400, 403 or 415, with what was expected.
pub fn check(request: &Request, proxy_user_header: &str, encrypted: bool) -> Result<(), Problem> {
    let headers = request.headers();
    let twice = |name: &str| headers.get_all(name).iter().nth(1).is_some();
    let once = ONCE.iter().map(HeaderName::as_str).chain([proxy_user_header]);
    if let Some(name) = once.into_iter().find(|name| twice(name)) {
        return Err(malformed(format!("The header {name} is there twice: expected once.")));
    }
    let host = headers.get(header::HOST).and_then(|host| host.to_str().ok());
    if request.uri().authority().is_some_and(|authority| host != Some(authority.as_str())) {
        return Err(malformed("The request names one server and its header Host another."));
    }
    let is_safe = matches!(*request.method(), Method::GET | Method::HEAD | Method::OPTIONS);
    if (!is_safe || headers.contains_key(header::UPGRADE)) && !Gate::is_of_our_page(headers, encrypted) {
        let detail = "A page of another server may neither read nor command this telescope network. Behind a proxy, let it pass \
                      on the header Host as the browser sent it.";
        return Err(Problem::new(Code::Forbidden, "Foreign page", detail));
    }
    if !is_safe { content_type(headers) } else { Ok(()) }
}

/// Forms of foreign pages can send other types without asking; JSON they cannot.
fn content_type(headers: &HeaderMap) -> Result<(), Problem> {
    let length = headers.get(header::CONTENT_LENGTH).is_some_and(|length| length != "0");
    let has_body = length || headers.contains_key(header::TRANSFER_ENCODING);
    let kind = headers.get(header::CONTENT_TYPE).map(|kind| kind.to_str().unwrap_or_default());
    let kind = kind.map(|kind| kind.split(';').next().unwrap_or_default().trim().to_ascii_lowercase());
    let is_json = |kind: &str| {
        kind == "application/json"
            || kind == "application/jsonl"
            || (kind.starts_with("application/") && kind.ends_with("+json"))
    };
    match kind {
        None if !has_body => Ok(()),
        Some(kind) if is_json(&kind) => Ok(()),
        _ => {
            Err(Problem::new(Code::UnsupportedMedia, "Not JSON", "Expected the header Content-Type: application/json."))
        }
    }
}

/// Did a proxy send this on for somebody else?
pub fn was_forwarded(headers: &HeaderMap) -> bool {
    FORWARDED.iter().any(|name| headers.contains_key(*name))
}

fn malformed(detail: impl Into<String>) -> Problem {
    Problem::new(Code::Malformed, "Ambiguous request", detail)
}
