//! Finds out who asks: each request gets a [`Principal`], or is refused.
//!
//! [`authenticate`] stands before all routes. It refuses ambiguous requests and those that a foreign page made a browser
//! send (`form`), finds what proves who asks ([`Credential`]), and puts the [`Principal`] into the request's extensions
//! together with [`Client`], [`Credential`] and [`Authentication`] itself. Which right a route needs is decided
//! elsewhere, by that principal.
//!
//! A credential is evaluated against the users file as it is now, each time: nothing that was taken away works on.

mod buckets;
mod edit;
mod exposure;
mod follow;
mod form;
mod logins;
mod sessions;

use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use bus::{Clock, MachineTime};
use config::{Network, Web};
use contract::Name;
use local_http::Peer;
use units::Utc;
use users::{Grant, Principal, Right, SecretHash, Users, WatchedUsers, Way};

use crate::addresses::is_page;
use crate::problem::{Code, Problem};
use buckets::Buckets;
pub use edit::Refusal;
pub use exposure::may_listen;
use logins::Logins;
pub use sessions::{LONGEST, Session, Sessions, TICKET_VALID, Tickets};

/// They open a socket, and are the only paths that take a ticket.
const SOCKETS: [&str; 3] = ["/api/v1/ws", "/ws", "/ws/log"];
const LOGIN: &str = "/api/v1/login";
const HEARTBEAT: &str = "/api/heartbeat";
/// What the login page consists of.
const LOGIN_ASSETS: [&str; 9] = [
    "/assets/starmesh.css",
    "/assets/live.css",
    "/assets/fonts/inter-var.woff2",
    "/assets/fonts/jetbrains-mono.woff2",
    "/assets/theme.js",
    "/assets/login.js",
    "/assets/favicon.svg",
    "/assets/manifest.webmanifest",
    "/favicon.ico",
];
const HEALTH: [&str; 3] = ["/healthz", "/readyz", "/version"];

/// What proves who asks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Credential {
    /// Nothing has to be proven here.
    Open,
    /// The cookie of a session.
    Session(SecretHash),
    /// A token.
    Token(SecretHash),
    /// The word of a proxy that is trusted.
    Proxy(String),
    /// Nothing, for what everybody may have.
    Nobody,
}

/// Where a request comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Client {
    /// The address of the browser or program; behind a trusted proxy, as the proxy states it.
    pub address: IpAddr,
    /// Did it come to us, or to a trusted proxy, by TLS?
    pub encrypted: bool,
    /// Is it certainly a program of this host?
    pub local: bool,
}

/// Both times at once; a test sets them.
pub type Now = Box<dyn Fn() -> (MachineTime, Utc) + Send + Sync>;

/// The users that may ask, and their sessions. Cheap to clone.
#[derive(Clone)]
pub struct Authentication(Arc<Inner>);

struct Inner {
    rules: Rules,
    file: PathBuf,
    /// Held while the disk is asked, which may take for ever.
    watched: Mutex<WatchedUsers>,
    /// The users file does not count, so that nobody is known who was known before.
    is_faulty: AtomicBool,
    users: RwLock<Option<Arc<Users>>>,
    sessions: Mutex<Sessions>,
    tickets: Mutex<Tickets>,
    requests: Mutex<Buckets<String>>,
    logins: Logins,
    now: Now,
}

struct Rules {
    proxies: Vec<Network>,
    proxy_user_header: HeaderName,
    proxy_right: Option<Grant>,
    public: Vec<String>,
    insecure_open: bool,
    encrypted: bool,
}

impl Authentication {
    /// By the machine's own clocks: a simulated sky makes no token expire.
    pub fn new(web: &Web) -> anyhow::Result<Self> {
        let clock = Clock::machine_clock();
        Self::with_clock(web, Box::new(move || (clock.machine(), clock.utc())))
    }

    fn with_clock(web: &Web, now: Now) -> anyhow::Result<Self> {
        let rate = f64::from(web.requests_per_s);
        let watched = WatchedUsers::new(web.users.clone());
        Ok(Self(Arc::new(Inner {
            rules: Rules {
                proxies: web.trust_proxy.clone(),
                proxy_user_header: web.proxy_user_header.to_ascii_lowercase().parse()?,
                proxy_right: web.proxy_right.clone(),
                public: web.public.clone(),
                insecure_open: web.insecure_open,
                encrypted: web.certificate.is_some(),
            },
            file: web.users.clone(),
            users: RwLock::new(watched.users().cloned()),
            is_faulty: AtomicBool::new(watched.fault().is_some()),
            watched: Mutex::new(watched),
            sessions: Mutex::default(),
            tickets: Mutex::default(),
            requests: Mutex::new(Buckets::new(rate, 2.0 * rate)),
            logins: Logins::default(),
            now,
        })))
    }

    /// The users that count now; absent while nobody is asked.
    pub fn users(&self) -> Option<Arc<Users>> {
        self.0.users.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// May everybody do everything who reaches this server, from wherever?
    pub fn is_insecurely_open(&self) -> bool {
        self.0.rules.insecure_open && self.users().is_none()
    }

    /// Does a proxy sign people in?
    pub fn is_behind_proxy(&self) -> bool {
        !self.0.rules.proxies.is_empty()
    }

    /// The users file.
    pub fn file(&self) -> PathBuf {
        self.0.file.clone()
    }

    /// Is the users file missing or damaged, so that nothing is known of who may do what?
    pub fn is_faulty(&self) -> bool {
        self.0.is_faulty.load(Ordering::Relaxed)
    }

    /// Machine time and civil time.
    pub fn now(&self) -> (MachineTime, Utc) {
        (self.0.now)()
    }

    /// Sessions of people.
    pub fn sessions(&self) -> MutexGuard<'_, Sessions> {
        self.0.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tickets for sockets.
    pub fn tickets(&self) -> MutexGuard<'_, Tickets> {
        self.0.tickets.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The user whose password this is.
    ///
    /// # Errors
    /// 429 where there were too many tries.
    pub async fn verify(
        &self,
        users: Arc<Users>,
        name: &str,
        password: String,
        address: IpAddr,
    ) -> Result<Option<Name>, Problem> {
        let verified = self.0.logins.verify(users, name, password, address, self.now().0).await;
        verified.map_err(|wait| Problem::too_many("Too many logins were tried.", wait))
    }

    /// The person or program of a credential, with the rights of this moment.
    ///
    /// # Errors
    /// 401 if it no longer proves anything, 403 if it does and there is no right.
    pub fn principal(&self, credential: &Credential) -> Result<Principal, Problem> {
        let (machine, utc) = self.now();
        let Some(users) = self.users() else {
            let name = if self.0.rules.insecure_open { "anybody" } else { "local" };
            return match credential {
                Credential::Nobody => Ok(nobody()),
                _ => Ok(Principal::open(name)),
            };
        };
        match credential {
            Credential::Nobody => Ok(nobody()),
            Credential::Open => Err(Problem::unauthenticated("There are users now: log in.")),
            Credential::Token(hash) => users
                .of_token(*hash, utc)
                .map_err(|why| Problem::unauthenticated(format!("The token gives nothing: {why}."))),
            Credential::Session(hash) => {
                let sessions = self.sessions();
                let session = sessions.get(hash, machine).filter(|session| session.is_of(&users));
                let user = session.and_then(|session| users.user(session.user.as_str()));
                let (name, user) =
                    user.ok_or_else(|| Problem::unauthenticated("The session is over: log in again."))?;
                Ok(Principal { name: name.to_string(), way: Way::Session, grants: user.grants.clone() })
            }
            Credential::Proxy(name) => {
                let grants = match (users.user(name), &self.0.rules.proxy_right) {
                    (Some((_, user)), _) => user.grants.clone(),
                    (None, Some(right)) if name.parse::<Name>().is_ok() => vec![right.clone()],
                    (None, _) => {
                        let detail =
                            "The proxy names a user who is not in the users file: `starmesh user add` makes one.";
                        return Err(Problem::new(Code::Forbidden, "Unknown user", detail));
                    }
                };
                Ok(Principal { name: name.clone(), way: Way::Proxy, grants })
            }
        }
    }

    /// A page that only this machine sees needs no limit: whoever is on it can do worse than ask.
    fn is_limited(&self) -> bool {
        let rules = &self.0.rules;
        rules.insecure_open || self.is_behind_proxy() || self.users().is_some()
    }

    /// Lets a request in with its principal, or refuses it.
    fn admit(&self, request: &mut Request) -> Result<(), Problem> {
        let client = self.client(request);
        let header = self.0.rules.proxy_user_header.as_str();
        form::check(request, header, self.0.rules.encrypted)?;
        let path = request.uri().path();
        let found = self.credential(request, &client);
        let found = found.and_then(|credential| self.principal(&credential).map(|principal| (credential, principal)));
        let found = match found {
            Err(refusal) => match self.everybodys(request.method(), path, &client) {
                Some(principal) => Ok((Credential::Nobody, principal)),
                None => Err(refusal),
            },
            found => found,
        };
        if self.is_limited() && !is_page(path) && !path.starts_with("/assets/") {
            let key = match &found {
                Ok((Credential::Session(_) | Credential::Token(_) | Credential::Proxy(_), principal)) => {
                    format!("user {}", principal.name)
                }
                _ => local_http::network(client.address).to_string(),
            };
            let mut requests = self.0.requests.lock().unwrap_or_else(PoisonError::into_inner);
            let taken = requests.take(key, self.now().0);
            taken.map_err(|wait| Problem::too_many("Too many requests.", wait))?;
        }
        let (credential, principal) = found?;
        if principal.grants.is_empty() && credential != Credential::Nobody {
            let detail = format!("{principal} has no right left that this proof gives.");
            return Err(Problem::new(Code::Forbidden, "No right", detail));
        }
        if let Credential::Session(hash) = &credential {
            self.sessions().touch(hash, self.now().0);
        }
        let extensions = request.extensions_mut();
        extensions.insert(client);
        extensions.insert(credential);
        extensions.insert(principal);
        extensions.insert(self.clone());
        Ok(())
    }

    /// What a request presents. Where several things are presented, the first of these counts, and is not replaced by
    /// another one if it fails: a ticket, a proxy's word, a token, a cookie.
    fn credential(&self, request: &Request, client: &Client) -> Result<Credential, Problem> {
        let headers = request.headers();
        if self.users().is_none() {
            return self.open(headers, peer(request));
        }
        if let Some(ticket) = ticket(request) {
            let credential = self.tickets().redeem(ticket, self.now().0);
            return credential.ok_or_else(|| Problem::unauthenticated("The ticket was used, or is older than 30 s."));
        }
        if let Some(name) = headers.get(&self.0.rules.proxy_user_header).filter(|_| self.is_proxy(peer(request))) {
            return Ok(Credential::Proxy(name.to_str().unwrap_or_default().to_owned()));
        }
        if let Some(value) = headers.get(header::AUTHORIZATION) {
            return token(value).map(Credential::Token);
        }
        match presented_session(headers, client.encrypted) {
            Some(session) => Ok(Credential::Session(SecretHash::of(session))),
            None => Err(Problem::unauthenticated(format!(
                "Log in by POST {LOGIN}, or send a token: Authorization: Bearer ..."
            ))),
        }
    }

    /// Without users, programs of this host are let in; by `insecure_open`, everybody.
    fn open(&self, headers: &HeaderMap, peer: IpAddr) -> Result<Credential, Problem> {
        if self.0.rules.insecure_open || (peer.is_loopback() && !form::was_forwarded(headers)) {
            return Ok(Credential::Open);
        }
        let detail = "This server has no users, so that it answers only to programs of its own host, and a proxy has forwarded \
                      this request: make users with `starmesh user add`, and set web.trust_proxy.";
        Err(Problem::new(Code::Forbidden, "No users", detail))
    }

    /// What is answered without knowing from whom the question is.
    fn everybodys(&self, method: &Method, path: &str, client: &Client) -> Option<Principal> {
        if path == LOGIN && method == Method::POST {
            return Some(nobody());
        }
        if !matches!(*method, Method::GET | Method::HEAD) {
            return None;
        }
        if is_page(path) || LOGIN_ASSETS.contains(&path) || HEALTH.contains(&path) {
            return Some(nobody());
        }
        let is_public = self.0.rules.public.iter().any(|public| public == path);
        (is_public || (path == HEARTBEAT && client.local)).then(|| Principal {
            name: "public".to_owned(),
            way: Way::Open,
            grants: vec![Grant::everywhere(Right::Viewer)],
        })
    }

    fn is_proxy(&self, peer: IpAddr) -> bool {
        self.0.rules.proxies.iter().any(|network| network.contains(peer))
    }

    fn client(&self, request: &Request) -> Client {
        let (headers, peer) = (request.headers(), peer(request));
        if !self.is_proxy(peer) {
            let local = peer.is_loopback() && !form::was_forwarded(headers);
            return Client { address: peer, encrypted: self.0.rules.encrypted, local };
        }
        let text = |name: &str| headers.get_all(name).iter().next_back().and_then(|value| value.to_str().ok());
        // The proxy writes the last address; those before it are the client's own words.
        let last = text("x-forwarded-for").and_then(|list| list.rsplit(',').next()).map(str::trim);
        let address = last.and_then(|last| last.parse().ok()).unwrap_or(peer);
        let encrypted = self.0.rules.encrypted || text("x-forwarded-proto").is_some_and(|proto| proto == "https");
        Client { address, encrypted, local: false }
    }
}

/// Lets requests in, each with its [`Principal`]; the answers of the API stay in no cache.
pub async fn authenticate(State(authentication): State<Authentication>, mut request: Request, next: Next) -> Response {
    let is_api = request.uri().path().starts_with("/api/");
    let mut response = match authentication.admit(&mut request) {
        Ok(()) => next.run(request).await,
        Err(problem) => problem.into_response(),
    };
    if is_api && !response.headers().contains_key(header::CACHE_CONTROL) {
        response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    }
    response
}

/// Name of the cookie of a session: under TLS, browsers take a name that begins so from this server and path alone.
fn cookie_name(encrypted: bool) -> &'static str {
    if encrypted { "__Host-starmesh" } else { "starmesh" }
}

/// The header that gives a session to a browser, or, without a secret, takes it away.
pub fn session_cookie(secret: Option<&str>, encrypted: bool) -> String {
    let name = cookie_name(encrypted);
    let secure = if encrypted { "; Secure" } else { "" };
    let gone = if secret.is_none() { "; Max-Age=0" } else { "" };
    format!("{name}={}; Path=/; HttpOnly; SameSite=Strict{secure}{gone}", secret.unwrap_or_default())
}

/// Everybody: no right at all, and good for what needs none.
fn nobody() -> Principal {
    Principal { name: "nobody".to_owned(), way: Way::Open, grants: Vec::new() }
}

fn peer(request: &Request) -> IpAddr {
    let known = request.extensions().get::<Peer>();
    known.map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |Peer(address)| address.to_canonical())
}

fn ticket(request: &Request) -> Option<&str> {
    let query = request.uri().query().filter(|_| SOCKETS.contains(&request.uri().path()))?;
    query.split('&').find_map(|pair| pair.strip_prefix("ticket="))
}

fn token(value: &HeaderValue) -> Result<SecretHash, Problem> {
    let (scheme, rest) = value.to_str().unwrap_or_default().split_once(' ').unwrap_or_default();
    match scheme.to_ascii_lowercase().as_str() {
        "bearer" => Ok(SecretHash::of(rest.trim())),
        "basic" => Err(Problem::unauthenticated(
            "A password is not sent with each request: make a token with `starmesh user token add`, and send it as \
             Authorization: Bearer TOKEN.",
        )),
        _ => Err(Problem::unauthenticated("Expected the header Authorization: Bearer TOKEN.")),
    }
}

/// What the cookie of a session holds, if a request has one.
pub fn presented_session(headers: &HeaderMap, encrypted: bool) -> Option<&str> {
    cookie(headers, cookie_name(encrypted))
}

/// The value of a cookie; none if there are several of this name, since another server of the same host could have set one.
fn cookie<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    let all = headers.get(header::COOKIE)?.to_str().ok()?;
    let mut values = all.split(';').filter_map(|pair| pair.trim().split_once('=')).filter(|(key, _)| *key == name);
    match (values.next(), values.next()) {
        (Some((_, value)), None) => Some(value),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
