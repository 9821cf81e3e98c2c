//! `[web]`: where the page and the API are served, and who is let in.

use std::fmt;
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::str::FromStr;

use contract::Chunk;
use serde::Deserialize;
use users::Grant;

/// `[web]`: where the page and the API are served, and who is let in.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Web {
    /// Address and port; loopback unless configured otherwise.
    pub listen: SocketAddr,
    /// Names that this server answers to, in addition to addresses and the name of its host.
    pub names: Vec<String>,
    /// The users, with their passwords' hashes and tokens; `starmesh user` writes it.
    pub users: PathBuf,
    /// Serve beyond this host without users: whoever reaches the address may do everything.
    pub insecure_open: bool,
    /// Certificate chain, PEM; with it, the page is served by TLS.
    pub certificate: Option<PathBuf>,
    /// The certificate's private key, PEM.
    pub key: Option<PathBuf>,
    /// Addresses whose requests may name their user and the address of the browser.
    pub trust_proxy: Vec<Network>,
    /// Header in which such a proxy names the user.
    pub proxy_user_header: String,
    /// Right of a user that such a proxy names and the users file does not have; none where absent.
    pub proxy_right: Option<Grant>,
    /// Paths that are answered without asking who it is, with the right of a viewer.
    pub public: Vec<String>,
    /// Requests of one user, or of one address, for which there is always room; for a moment twice as many.
    pub requests_per_s: u32,
    /// Push services of the site's own network, each with scheme, host and port; those of browsers' makers need not be named.
    pub push_services: Vec<String>,
    /// `[[web.webcam]]`: pictures of other servers that the page shows.
    pub webcam: Vec<Webcam>,
}

/// `[[web.webcam]]`: a picture of another server, which browsers fetch from there.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Webcam {
    /// How the page calls it.
    pub name: String,
    /// Address of the picture: `https://` or `http://`.
    pub url: String,
    /// The site that it shows; that of this file where absent.
    pub site: Option<Chunk>,
    /// The telescope of the site that it shows; all of them where absent.
    pub telescope: Option<Chunk>,
    /// It is fetched again after this, s.
    #[serde(default = "a_minute")]
    pub period_s: f64,
}

fn a_minute() -> f64 {
    60.0
}

impl Webcam {
    /// Scheme, host and port, as a policy for browsers names a server; absent where the address is none of a picture.
    pub fn origin(&self) -> Option<&str> {
        origin(&self.url)
    }
}

/// Scheme, host and port of an address of the web.
fn origin(url: &str) -> Option<&str> {
    let scheme = ["https://", "http://"].into_iter().find(|scheme| url.starts_with(scheme))?;
    let rest = url.get(scheme.len()..)?;
    let (host, _) = rest.split_once(['/', '?']).unwrap_or((rest, ""));
    let (name, port) = match host.rsplit_once(':') {
        Some((name, port)) if !port.ends_with(']') => (name, Some(port)),
        _ => (host, None),
    };
    let is_name = |name: &str| name.bytes().all(|b| b.is_ascii_alphanumeric() || b"-.".contains(&b));
    let inner = name.strip_prefix('[').and_then(|name| name.strip_suffix(']'));
    let is_host = !name.is_empty()
        && inner.map_or_else(|| is_name(name), |address| address.parse::<std::net::Ipv6Addr>().is_ok());
    let is_plain = url.bytes().all(|b| b.is_ascii_graphic() && !b"\"'<>\\^`{|}#".contains(&b));
    let fits = is_host && is_plain && port.is_none_or(|port| port.parse::<u16>().is_ok_and(|port| port > 0));
    fits.then(|| url.get(..scheme.len() + host.len())).flatten()
}

impl Default for Web {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 8080)),
            names: Vec::new(),
            users: "users.toml".into(),
            insecure_open: false,
            certificate: None,
            key: None,
            trust_proxy: Vec::new(),
            proxy_user_header: "X-Remote-User".to_owned(),
            proxy_right: None,
            public: Vec::new(),
            requests_per_s: 20,
            push_services: Vec::new(),
            webcam: Vec::new(),
        }
    }
}

impl Web {
    /// Must there be users before anything is served? So it is where others than the people on this host can ask.
    pub fn needs_users(&self) -> bool {
        !self.insecure_open && (!self.listen.ip().is_loopback() || !self.trust_proxy.is_empty())
    }

    /// Keys with what does not hold.
    pub(crate) fn faults(&self) -> Vec<(String, String)> {
        let mut found = Vec::new();
        match (&self.certificate, &self.key) {
            (Some(_), None) => {
                found.push(("certificate", "web.certificate: expected web.key too, its private key".into()));
            }
            (None, Some(_)) => found.push(("key", "web.key: expected web.certificate too, its certificate".into())),
            _ => {}
        }
        let is_host =
            |name: &str| !name.is_empty() && name.bytes().all(|b| b.is_ascii_alphanumeric() || b"-.".contains(&b));
        if let Some(name) = self.names.iter().find(|name| !is_host(name)) {
            let what = format!(
                "web.names: {name:?} is no name of a host: expected one such as \"dome.example.org\", without port"
            );
            found.push(("names", what));
        }
        let is_token = |name: &str| !name.is_empty() && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-');
        let spoken = ["authorization", "cookie", "host", "origin", "content-type", "content-length"];
        let header = self.proxy_user_header.to_ascii_lowercase();
        if !is_token(&header) || spoken.contains(&&*header) || header.starts_with("x-forwarded") {
            let what = format!(
                "web.proxy_user_header: {header:?} cannot carry a name: expected one such as \"X-Remote-User\""
            );
            found.push(("proxy_user_header", what));
        }
        if self.proxy_right.is_some() && self.trust_proxy.is_empty() {
            let what = "web.proxy_right: no proxy is trusted: expected web.trust_proxy, such as [\"10.0.0.5/32\"]";
            found.push(("proxy_right", what.into()));
        }
        if let Some(path) = self.public.iter().find(|path| !path.starts_with('/') || path.contains(['?', '*', '%'])) {
            let what = format!("web.public: {path:?} is no path: expected one such as \"/api/heartbeat\"");
            found.push(("public", what));
        }
        if let Some(service) = self.push_services.iter().find(|service| origin(service) != Some(service.as_str())) {
            let what = format!(
                "web.push_services: {service:?}: expected scheme, host and port, such as \"https://push.example.lan:8443\""
            );
            found.push(("push_services", what));
        }
        if !(1..=10_000).contains(&self.requests_per_s) {
            let what = format!("web.requests_per_s = {}: expected 1 to 10000", self.requests_per_s);
            found.push(("requests_per_s", what));
        }
        let found = found.into_iter().map(|(key, what): (&str, String)| (format!("web.{key}"), what));
        found.chain(self.webcam_faults()).collect()
    }

    fn webcam_faults(&self) -> Vec<(String, String)> {
        let mut found = Vec::new();
        let mut seen = std::collections::BTreeSet::new();
        for (index, webcam) in self.webcam.iter().enumerate() {
            let mut add = |key: &str, what: String| {
                found.push((format!("web.webcam[{index}].{key}"), format!("web.webcam \"{}\": {what}", webcam.name)));
            };
            if webcam.name.trim().is_empty() || webcam.name.chars().count() > 60 {
                add("name", "name: expected 1 to 60 letters, such as \"All-sky\"".to_owned());
            }
            if !seen.insert((&webcam.site, &webcam.telescope, &webcam.name)) {
                add("name", "name: another webcam of this place has this name".to_owned());
            }
            if webcam.origin().is_none() {
                let what = "url: expected the address of a picture, such as \"https://allsky.example.org/latest.jpg\", without a user or password";
                add("url", what.to_owned());
            }
            if !(1.0..=86_400.0).contains(&webcam.period_s) {
                add("period_s", format!("period_s = {}: expected 1 to 86400 s", webcam.period_s));
            }
        }
        found
    }

    /// What a person should know.
    pub(crate) fn warnings(&self) -> Vec<(String, String)> {
        let is_hidden = |webcam: &Webcam| self.certificate.is_some() && webcam.url.starts_with("http://");
        let hidden = self.webcam.iter().enumerate().filter(|(_, webcam)| is_hidden(webcam));
        let warn = |(index, webcam): (usize, &Webcam)| {
            let what = format!(
                "web.webcam \"{}\": url begins with http://, and the page is served by TLS: most browsers show no such picture \
                 on it. Use an https:// address",
                webcam.name
            );
            (format!("web.webcam[{index}].url"), what)
        };
        hidden.map(warn).collect()
    }
}

/// Addresses that begin alike, such as `10.0.0.0/24`; one address without a length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct Network {
    address: IpAddr,
    length: u8,
}

impl Network {
    /// Is the address one of them? IPv4 addresses inside IPv6 ones count as what they are.
    pub fn contains(&self, address: IpAddr) -> bool {
        let top = |bits: u128, of: u32| if self.length == 0 { 0 } else { bits >> (of - u32::from(self.length)) };
        match (self.address, address.to_canonical()) {
            (IpAddr::V4(own), IpAddr::V4(other)) => top(own.to_bits().into(), 32) == top(other.to_bits().into(), 32),
            (IpAddr::V6(own), IpAddr::V6(other)) => top(own.to_bits(), 128) == top(other.to_bits(), 128),
            _ => false,
        }
    }
}

/// A text that is no network.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is no network: expected an address with the length of its common part, such as \"10.0.0.5/32\" or \"10.0.0.0/24\""
)]
pub struct BadNetwork(String);

impl FromStr for Network {
    type Err = BadNetwork;

    fn from_str(text: &str) -> Result<Self, BadNetwork> {
        let bad = || BadNetwork(text.to_owned());
        let (address, length) = text.split_once('/').map_or((text, None), |(a, length)| (a, Some(length)));
        let address: IpAddr = address.parse().map_err(|_| bad())?;
        let most = if address.is_ipv4() { 32 } else { 128 };
        let length = length.map_or(Ok(most), |length| length.parse().map_err(|_| bad()))?;
        if length <= most { Ok(Self { address, length }) } else { Err(bad()) }
    }
}

impl TryFrom<String> for Network {
    type Error = BadNetwork;

    fn try_from(text: String) -> Result<Self, BadNetwork> {
        text.parse()
    }
}

impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.address, self.length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_network_contains_the_addresses_that_begin_alike() {
        for (network, inside, outside) in [
            ("10.0.0.5", "10.0.0.5", "10.0.0.6"),
            ("10.0.0.0/24", "::ffff:10.0.0.77", "10.0.1.0"),
            ("0.0.0.0/0", "1.2.3.4", "::1"),
            ("fd00::/8", "fdff::1", "fe80::1"),
            ("::1", "::1", "127.0.0.1"),
        ] {
            let network: Network = network.parse().unwrap();
            assert!(network.contains(inside.parse().unwrap()), "{network} {inside}");
            assert!(!network.contains(outside.parse().unwrap()), "{network} {outside}");
        }
        for bad in ["", "10.0.0.5/33", "10.0.0.5/-1", "proxy", "10.0.0/24", "::1/129", "10.0.0.5/"] {
            assert!(bad.parse::<Network>().is_err(), "{bad:?}");
        }
    }

    #[test]
    fn a_webcam_is_of_one_server_that_a_policy_can_name() {
        let origin = |url: &str| {
            let webcam =
                Webcam { name: "a".to_owned(), url: url.to_owned(), site: None, telescope: None, period_s: 60.0 };
            webcam.origin().map(str::to_owned)
        };
        for (url, expected) in [
            ("https://allsky.example.org/latest.jpg?size=2", "https://allsky.example.org"),
            ("http://10.0.0.7:8081/cam", "http://10.0.0.7:8081"),
            ("http://[fd00::7]:81/cam", "http://[fd00::7]:81"),
            ("http://[fd00::7]", "http://[fd00::7]"),
            ("https://h?x", "https://h"),
        ] {
            assert_eq!(origin(url).as_deref(), Some(expected));
        }
        for bad in [
            "",
            "allsky.jpg",
            "ftp://h/x",
            "https://",
            "https:///x",
            "https://me:secret@h/x",
            "https://h:0/x",
            "https://h:99999/x",
            "https://h; script-src */x",
            "https://h,https://g/x",
            "https://*/x",
            "https://h/a b",
            "https://h/\"x",
            "javascript:alert(1)",
            "https://[::1/x",
            "HTTPS://h/x",
        ] {
            assert_eq!(origin(bad), None, "{bad}");
        }
    }

    #[test]
    fn webcams_are_read_and_refused_with_their_place() {
        let place =
            "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0\nlongitude_deg = 0\nelevation_m = 0\n";
        let parse = |text: &str| crate::parse(&format!("{place}{text}"), std::path::Path::new("/"));
        let cam = "[[web.webcam]]\nname = \"All-sky\"\nurl = \"https://a.example/x.jpg\"\n";
        let web = parse(&format!(
            "{cam}[[web.webcam]]\nname = \"Dome\"\nurl = \"http://b\"\ntelescope = \"t\"\nperiod_s = 5\n"
        ));
        let web = web.unwrap().web;
        assert_eq!((web.webcam.len(), web.webcam[0].period_s, web.webcam[1].period_s), (2, 60.0, 5.0));
        for (text, expected) in [
            (cam.replace("https://a", "a"), "line 9: web.webcam \"All-sky\": url: expected the address of a picture"),
            (format!("{cam}{cam}"), "line 11: web.webcam \"All-sky\": name: another webcam"),
            (format!("{cam}period_s = 0\n"), "period_s = 0: expected 1 to 86400 s"),
            (format!("{cam}site = \"A B\"\n"), "site"),
            (format!("{cam}link = 1\n"), "there is no key \"link\" in [[web.webcam]]"),
            ("[[web.webcam]]\nname = \"x\"\n".to_owned(), "url"),
        ] {
            let fault = parse(&text).unwrap_err().to_string();
            assert!(fault.contains(expected), "{expected}: {fault}");
        }
    }

    #[test]
    fn users_are_needed_wherever_others_than_this_host_can_ask() {
        let on = |listen: &str| Web { listen: listen.parse().unwrap(), ..Web::default() };
        for (web, needed) in [
            (on("127.0.0.1:8080"), false),
            (on("[::1]:8080"), false),
            (on("0.0.0.0:8080"), true),
            (on("[::]:8080"), true),
            (on("10.0.0.5:8080"), true),
            (Web { trust_proxy: vec!["127.0.0.1".parse().unwrap()], ..Web::default() }, true),
            (Web { insecure_open: true, ..on("0.0.0.0:8080") }, false),
        ] {
            assert_eq!(web.needs_users(), needed, "{web:?}");
        }
    }
}
