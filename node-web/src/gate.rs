//! Controls access to this server: the names that it answers to, the pages that may command and open a socket, and what
//! browsers may do with its answers.
//!
//! A page of another server can make a browser on this machine ask `http://evil.example:8080`, with that name pointing
//! at 127.0.0.1 (DNS rebinding). Answering only to our own names ends that; an address literal cannot be rebound, so
//! every one is accepted.

use std::collections::BTreeSet;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use config::Webcam;

use crate::problem::{Code, Problem};

/// A page of ours loads everything from this server, except for pictures of webcams; no other script may run, no other page
/// may frame it, and it sends data to no other server.
const CONTENT_SECURITY_POLICY: &str =
    "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

/// The names this server answers to.
#[derive(Debug, Clone)]
pub struct Gate {
    listens: IpAddr,
    host_name: String,
    names: Vec<String>,
    policy: HeaderValue,
}

impl Gate {
    /// For a server that listens here, with the names that the site gave it, whose pages show these webcams.
    pub fn new(listens: SocketAddr, host_name: String, names: Vec<String>, webcams: &[Webcam]) -> Self {
        Self { listens: listens.ip(), host_name, names, policy: policy(webcams) }
    }

    /// Is this one of our names? Takes the `Host` header, with or without a port.
    fn knows(&self, host: &str) -> bool {
        let name = without_port(host);
        let literal = name.trim_start_matches('[').trim_end_matches(']');
        let own_name = !self.host_name.is_empty() && name.eq_ignore_ascii_case(&self.host_name);
        match literal.parse::<IpAddr>() {
            Ok(address) => address == self.listens || address.is_loopback() || self.listens.is_unspecified(),
            Err(_) => {
                name.eq_ignore_ascii_case("localhost")
                    || (own_name && !self.listens.is_loopback())
                    || self.names.iter().any(|own| own.eq_ignore_ascii_case(name))
            }
        }
    }

    /// Is this a request of a page of ours, or of a program? Programs send no `Origin`; of a page, the browser names where it
    /// is from. A server that speaks TLS does not trust a page that came without.
    pub fn is_of_our_page(headers: &HeaderMap, encrypted: bool) -> bool {
        let site = headers.get_all("sec-fetch-site").iter();
        if site.into_iter().any(|site| site != "same-origin" && site != "none") {
            return false;
        }
        let text = |name| headers.get(name).and_then(|value: &HeaderValue| value.to_str().ok());
        match (headers.contains_key(header::ORIGIN), text(header::ORIGIN), text(header::HOST)) {
            (false, ..) => true,
            (true, Some(origin), Some(host)) => {
                let plain = origin.strip_prefix("http://").filter(|_| !encrypted);
                let authority = plain.or_else(|| origin.strip_prefix("https://"));
                authority.is_some_and(|authority| authority.eq_ignore_ascii_case(host))
            }
            (true, ..) => false,
        }
    }
}

/// The pictures of exactly these servers may be shown; a policy that does not fit a header shows none of them.
fn policy(webcams: &[Webcam]) -> HeaderValue {
    let strict = HeaderValue::from_static(CONTENT_SECURITY_POLICY);
    let origins: BTreeSet<&str> = webcams.iter().filter_map(Webcam::origin).collect();
    if origins.is_empty() {
        return strict;
    }
    let origins: Vec<&str> = origins.into_iter().collect();
    let policy = format!("{CONTENT_SECURITY_POLICY}; img-src 'self' {}", origins.join(" "));
    HeaderValue::from_str(&policy).unwrap_or(strict)
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
    let policy = gate.policy.clone();
    let mut response = match host {
        Some(host) if gate.knows(host) => next.run(request).await,
        _ => Problem::new(
            Code::Misdirected,
            "This server does not answer to that name",
            "Use localhost, an IP address, or the name of this host; other names are given in web.names.",
        )
        .into_response(),
    };
    let headers = response.headers_mut();
    headers.entry(header::CONTENT_SECURITY_POLICY).or_insert(policy);
    for (name, value) in [
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ] {
        // A page of another kind has a policy of its own.
        headers.entry(name).or_insert(HeaderValue::from_static(value));
    }
    response
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderName;

    use super::*;

    fn gate(listens: &str) -> Gate {
        Gate::new(listens.parse().unwrap(), "mountain-pc".to_owned(), vec!["dome.example.org".to_owned()], &[])
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
        assert!(gate.knows("Dome.example.org:8080") && !gate.knows("a.dome.example.org"));
    }

    #[test]
    fn only_our_own_page_opens_a_socket_and_commands() {
        let is_ours = |encrypted, own: &[(&'static str, &str)]| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, "127.0.0.1:8080".parse().unwrap());
            headers.extend(own.iter().map(|(name, value)| (HeaderName::from_static(name), value.parse().unwrap())));
            Gate::is_of_our_page(&headers, encrypted)
        };
        assert!(is_ours(false, &[]) && is_ours(true, &[("sec-fetch-site", "none")]));
        assert!(is_ours(false, &[("origin", "http://127.0.0.1:8080"), ("sec-fetch-site", "same-origin")]));
        assert!(is_ours(true, &[("origin", "https://127.0.0.1:8080")]));
        assert!(
            !is_ours(true, &[("origin", "http://127.0.0.1:8080")]),
            "anybody on the way could have changed that page"
        );
        for site in ["cross-site", "same-site", "", "nonsense"] {
            assert!(!is_ours(false, &[("sec-fetch-site", site)]), "{site}");
            let headers = [("origin", "http://127.0.0.1:8080"), ("sec-fetch-site", site)];
            assert!(!is_ours(false, &headers), "{site}");
        }
        for origin in
            ["http://127.0.0.1:9999", "http://evil.example", "null", "127.0.0.1:8080", "http://127.0.0.1:8080.evil"]
        {
            assert!(!is_ours(false, &[("origin", origin)]), "{origin}");
        }
    }
}
