//! The network in short, one telescope in full.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::Json;
use axum::extract::{Extension, Path, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use contract::{Address, Chunk, Key, Right};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use units::Utc;
use users::Principal;

use crate::diary::Line;
use crate::model::Entry;
use crate::network::Network;
use crate::problem::Problem;
use crate::server::Server;
use crate::summary::{NodeSummary, Summary, nodes};

/// Nothing between this server and its reader may store what is true only now.
pub const NEVER_CACHED: [(header::HeaderName, &str); 1] = [(header::CACHE_CONTROL, "no-store")];

/// The whole network in short.
#[derive(Debug, JsonSchema, Serialize)]
pub struct NetworkAnswer {
    /// Sky time of this server.
    pub server_time_utc: Utc,
    /// How many times faster than real time the sky goes; 1 except in a simulation.
    pub speed: f64,
    /// The telescopes.
    pub telescopes: Vec<TelescopeInNetwork>,
    /// What the telescopes of each site share.
    pub shared: Vec<TelescopeInNetwork>,
    /// Pictures of other servers, of the sites and telescopes that the caller may see.
    pub webcams: Vec<WebcamInNetwork>,
}

/// A picture that the reader fetches from another server.
#[derive(Debug, JsonSchema, Serialize)]
pub struct WebcamInNetwork {
    /// How it is called.
    pub name: String,
    /// Address of the picture.
    pub url: String,
    /// The site that it shows.
    pub site_id: Chunk,
    /// The telescope that it shows; absent for all of the site.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub telescope_id: Option<Chunk>,
    /// It is worth fetching again after this, s.
    pub period_s: f64,
}

impl WebcamInNetwork {
    /// Whether it shows a telescope, alone or with all of its site.
    pub fn shows(&self, address: &Address) -> bool {
        self.site_id == address.site && self.telescope_id.as_ref().is_none_or(|id| *id == address.telescope)
    }
}

/// The webcams of the file of this server that a caller may see: who may see a telescope of a site may see the site.
pub fn webcams(server: &Server, caller: &Principal) -> Vec<WebcamInNetwork> {
    let model = server.network.read();
    let place = &server.config.place;
    let seen: Vec<&Address> = model.telescopes.keys().filter(|address| caller.right_at(address).is_some()).collect();
    let webcams = server.config.web.webcam.iter().map(|webcam| WebcamInNetwork {
        name: webcam.name.clone(),
        url: webcam.url.clone(),
        site_id: webcam.site.clone().unwrap_or_else(|| place.site.clone()),
        telescope_id: webcam.telescope.clone(),
        period_s: webcam.period_s,
    });
    webcams.filter(|webcam| seen.iter().any(|address| webcam.shows(address))).collect()
}

/// A telescope with its nodes.
#[derive(Debug, JsonSchema, Serialize)]
pub struct TelescopeInNetwork {
    /// In short.
    #[serde(flatten)]
    pub summary: Summary,
    /// Its nodes.
    pub nodes: Vec<NodeSummary>,
}

/// Everything known of one telescope.
#[derive(Debug, JsonSchema, Serialize)]
pub struct TelescopeAnswer {
    /// Sky time of this server.
    pub server_time_utc: Utc,
    /// How many times faster than real time the sky goes; 1 except in a simulation.
    pub speed: f64,
    /// In short.
    pub summary: Summary,
    /// The newest payload of each key of the bus, by the key without `starmesh/v1/`.
    pub states: BTreeMap<String, StateNow>,
    /// The last lines of its nodes' logs.
    pub log: Vec<Line>,
}

/// A payload as it was received.
#[derive(Debug, JsonSchema, Serialize)]
pub struct StateNow {
    /// Sky time of its sender.
    pub at_utc: Utc,
    /// How old it is by the clock of this server, s.
    pub age_s: f64,
    /// It is published again within so many seconds; absent for what is not repeated.
    pub period_s: Option<f64>,
    /// The payload, as the AsyncAPI document of the bus describes it.
    pub body: Value,
}

impl StateNow {
    /// As a payload is now, for this caller.
    pub fn of(entry: &Entry, network: &Network, caller: &Principal) -> Self {
        Self {
            at_utc: entry.at_utc,
            age_s: entry.age(network.clock().machine()).as_secs_f64(),
            period_s: entry.period().map(|period| period.as_secs_f64()),
            body: body_for(entry, caller),
        }
    }
}

/// A payload without the address of a device's server, where the caller may only look.
pub fn body_for(entry: &Entry, caller: &Principal) -> Value {
    let mut body = Value::clone(&entry.body);
    if matches!(entry.key, Key::Capabilities(_))
        && caller.right_at(entry.key.address()) <= Some(Right::Viewer)
        && let Some(fields) = body.as_object_mut()
    {
        fields.remove("server");
    }
    body
}

/// All telescopes that the caller may see, with their nodes; the devices that a site shares are under `shared`.
pub async fn network(State(server): State<Arc<Server>>, Extension(caller): Extension<Principal>) -> Response {
    let network = &server.network;
    let (now, utc) = (network.clock().machine(), network.clock().utc());
    let of = |is_shared: bool| -> Vec<TelescopeInNetwork> {
        let model = network.read();
        let is_wanted = |address: &Address| {
            (address.telescope.as_str() == Address::SHARED) == is_shared && caller.right_at(address).is_some()
        };
        let wanted = model.telescopes.iter().filter(|(address, _)| is_wanted(address));
        let telescopes = wanted.map(|(address, telescope)| TelescopeInNetwork {
            summary: Summary::of(&model, address, telescope, now, utc),
            nodes: nodes(telescope, now),
        });
        telescopes.collect()
    };
    let answer = NetworkAnswer {
        server_time_utc: utc,
        speed: network.clock().speed(),
        telescopes: of(false),
        shared: of(true),
        webcams: webcams(&server, &caller),
    };
    (NEVER_CACHED, Json(answer)).into_response()
}

/// The address that a path names, if anything of it publishes on the bus.
///
/// # Errors
/// Where nothing does.
pub fn known(network: &Network, site: &str, telescope: &str) -> Result<Address, Problem> {
    let address = Address::new(site, telescope).ok().filter(|address| network.read().telescopes.contains_key(address));
    address.ok_or_else(|| Problem::not_found(format!("No telescope {site}/{telescope} publishes on the bus.")))
}

/// Everything known of one telescope.
pub async fn telescope(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    Path((site, telescope)): Path<(String, String)>,
) -> Result<Response, Problem> {
    let network = &server.network;
    let address = known(network, &site, &telescope)?;
    let (now, utc) = (network.clock().machine(), network.clock().utc());
    let model = network.read();
    let known = model.telescopes.get(&address).ok_or_else(|| Problem::not_found("It has just been forgotten."))?;
    let answer = TelescopeAnswer {
        server_time_utc: utc,
        speed: network.clock().speed(),
        summary: Summary::of(&model, &address, known, now, utc),
        states: known
            .states
            .iter()
            .map(|(name, entry)| (name.clone(), StateNow::of(entry, network, &caller)))
            .collect(),
        log: known.diary.after(0).cloned().collect(),
    };
    Ok((NEVER_CACHED, Json(answer)).into_response())
}
