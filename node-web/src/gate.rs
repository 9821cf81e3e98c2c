//! Controls access to this server: the names that it answers to, the pages that may open a socket, and what browsers
//! may do with its answers.
//!
//! A page of another server can make a browser on this machine ask `http://evil.example:8080`, with that name pointing
//! at 127.0.0.1 (DNS rebinding). Answering only to our own names ends that; an address literal cannot be rebound, so
//! every one is accepted.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};

use crate::problem::Problem;

/// A page of ours loads everything from this server; no other script may run, no other page may frame it, and it sends
/// data to no other server.
const CONTENT_SECURITY_POLICY: &str =
    "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

/// The names this server answers to.
#[derive(Debug, Clone)]
pub struct Gate {
    listens: IpAddr,
    host_name: String,
}

impl Gate {
    /// For a server that listens here.
    pub fn new(listens: SocketAddr, host_name: String) -> Self {
        Self { listens: listens.ip(), host_name }
    }

    /// Is this one of our names? Takes the `Host` header, with or without a port.
    fn knows(&self, host: &str) -> bool {
        let name = without_port(host);
        let literal = name.trim_start_matches('[').trim_end_matches(']');
        let own_name = !self.host_name.is_empty() && name.eq_ignore_ascii_case(&self.host_name);
        match literal.parse::<IpAddr>() {
            Ok(address) => address == self.listens || address.is_loopback() || self.listens.is_unspecified(),
            Err(_) => name.eq_ignore_ascii_case("localhost") || (own_name && !self.listens.is_loopback()),
        }
    }

    /// May the page that asks open a socket here? Programs send no `Origin`; pages must be our own.
    pub fn same_origin(headers: &HeaderMap) -> bool {
        let text = |name| headers.get(name).and_then(|value: &HeaderValue| value.to_str().ok());
        match (headers.contains_key(header::ORIGIN), text(header::ORIGIN), text(header::HOST)) {
            (false, ..) => true,
            (true, Some(origin), Some(host)) => {
                let authority = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
                authority.is_some_and(|authority| authority.eq_ignore_ascii_case(host))
            }
            (true, ..) => false,
        }
    }
}

fn without_port(host: &str) -> &str {
    match host.rsplit_once(':') {
        // The colons of an IPv6 address stand in brackets.
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) && !name.ends_with(':') => name,
        _ => host,
    }
}

/// Refuses foreign names, and adds the headers that limit what browsers may do with each answer.
pub async fn guard(State(gate): State<Arc<Gate>>, request: Request, next: Next) -> Response {
    let host = request.headers().get(header::HOST).and_then(|host| host.to_str().ok());
    let mut response = match host {
        Some(host) if gate.knows(host) => next.run(request).await,
        _ => Problem::new(
            StatusCode::MISDIRECTED_REQUEST,
            "misdirected",
            "This server does not answer to that name",
            "Use localhost, an IP address, or the name of this host.",
        )
        .into_response(),
    };
    let headers = response.headers_mut();
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gate(listens: &str) -> Gate {
        Gate::new(listens.parse().unwrap(), "mountain-pc".to_owned())
    }

    #[test]
    fn a_loopback_server_answers_to_loopback_names_only() {
        let gate = gate("127.0.0.1:8080");
        for host in ["localhost", "LOCALHOST:8080", "127.0.0.1:8080", "127.0.0.1", "[::1]:8080", "[::1]"] {
            assert!(gate.knows(host), "{host}");
        }
        for host in ["evil.example", "localhost.evil.example:8080", "192.168.1.7:8080", "mountain-pc", "", ":8080"] {
            assert!(!gate.knows(host), "{host}");
        }
    }

    #[test]
    fn an_open_server_answers_to_addresses_and_its_own_name_but_to_no_other() {
        let gate = gate("0.0.0.0:8080");
        for host in ["192.168.1.7:8080", "[fe80::1]:8080", "mountain-pc:8080", "localhost"] {
            assert!(gate.knows(host), "{host}");
        }
        assert!(!gate.knows("evil.example:8080"));
    }

    #[test]
    fn only_our_own_page_opens_a_socket() {
        let headers = |origin: Option<&str>| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, "127.0.0.1:8080".parse().unwrap());
            if let Some(origin) = origin {
                headers.insert(header::ORIGIN, origin.parse().unwrap());
            }
            headers
        };
        assert!(Gate::same_origin(&headers(None)));
        assert!(Gate::same_origin(&headers(Some("http://127.0.0.1:8080"))));
        for origin in ["http://127.0.0.1:9999", "http://evil.example", "null", "127.0.0.1:8080"] {
            assert!(!Gate::same_origin(&headers(Some(origin))), "{origin}");
        }
    }
}
