//! The web node: the whole telescope network on one page, and the same as JSON.
//!
//! It subscribes to every site and telescope on the bus (`receive`), stores the newest payload of each key with its
//! time of arrival (`model`), and shows that: a page with everything it needs built in (`routes::page`), updated over
//! one WebSocket (`socket`), the newest image of each telescope (`preview`), the heartbeat document that monitoring scripts
//! know (`routes::heartbeat`), and native JSON (`routes::network`). Ages are judged by this machine's clock at arrival
//! (`freshness`), so that a silent node is shown as silent.
//!
//! Drafts of schedules are checked, forecast and put in force by the observatory node (`schedules`).
//!
//! Each request gets the principal who asks, or is refused (`authentication`).
//!
//! It is never in the safety path: it decides nothing, and nothing waits for it.
//!
//! # Invariants
//!
//! - Every payload that is shown was decoded as the type of its key: `a_required_field_of_a_wrong_type_is_not_taken`,
//!   `a_field_of_a_wrong_type_is_reported_and_never_displayed`.
//! - A silent node is shown as silent: `a_value_grows_stale_after_two_periods_and_is_lost_after_five`,
//!   `a_silent_observatory_is_an_error_and_never_safe`.
//! - Payloads of unknown programs push no telescope of the configuration off the page (decision 0050):
//!   `a_million_keys_of_a_stranger_leave_room_for_the_telescope_of_the_file`.
//! - Without a proof of who asks, nothing is answered that is not for everybody (decision 0110):
//!   `with_users_everybody_is_asked_and_each_proof_opens_what_it_should`.
//! - Whatever is changed about users over HTTP leaves a record, without a secret:
//!   `every_change_of_users_leaves_a_record_that_holds_no_secret`.
//! - Whatever is changed over HTTP, somebody remains who can change users: `somebody_who_can_change_users_always_remains`,
//!   `the_first_user_is_an_engineer_and_is_made_on_the_servers_host`.
//! - A draft is never overwritten unseen, and an activation replaces the schedule that its caller saw:
//!   `of_two_who_edit_one_draft_the_second_is_asked_to_look_again`,
//!   `a_schedule_that_somebody_else_put_meanwhile_is_not_replaced`.
//! - A slow page delays nobody: `a_slow_page_gets_the_newest_value_of_each_key_once`.

mod addresses;
mod alerts;
mod api;
mod authentication;
mod command_store;
mod commands;
mod diary;
mod domes;
mod drafts;
mod edge;
mod forecast_store;
mod freshness;
mod gate;
mod host;
mod in_words;
mod json_body;
mod model;
mod network;
mod place;
mod plain_errors;
mod preview;
mod problem;
mod push;
mod receive;
mod ring;
mod router;
mod routes;
mod safety;
mod schedules;
mod server;
mod shrink;
mod socket;
mod stopped;
mod summary;
mod tls;
mod user_audit;

use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use audit::Audit;
use bus::Bus;
use contract::Scalar;
use contract::observatory::AlertKind;
use local_http::{Limits, Places, Room};
use orders::RecentStates;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio_rustls::TlsAcceptor;

pub use crate::api::readable_paths;
use crate::authentication::Authentication;
pub use crate::authentication::may_listen;
use crate::gate::Gate;
use crate::server::Server;
pub use crate::tls::CertificateFiles;

/// Sockets of pages that are open are counted apart (`socket`).
const LIMITS: Limits = Limits {
    room: Room { total: 400, per_address: 64, trusted: 80 },
    header: Duration::from_secs(5),
    total: Duration::from_secs(120),
};
/// An address that is taken is tried again after this.
const LISTEN_AGAIN: Duration = Duration::from_secs(5);
const FORGET_EVERY: Duration = Duration::from_secs(600);
const SECOND: Duration = Duration::from_secs(1);

/// Serves the page until the node is stopped.
pub async fn run(node: node::Node) -> anyhow::Result<()> {
    let web = &node.config.web;
    let network = Arc::new(network::Network::new(node.bus.clock().clone(), &node.config.place));
    let previews = Arc::new(preview::Previews::new(network.clone())?);
    let host = Arc::new(host::Host::default());
    let mut tasks = JoinSet::new();
    // Before the page has its address: a node that is stopped meanwhile says so once, and alerts are sent without a page.
    receive::everything(&node.bus, &network, &previews, &mut tasks).await?;
    tasks.spawn(previews.clone().make());
    tasks.spawn(host.clone().measure(node.config.folders.data.clone()));
    tasks.spawn(forget(network.clone()));
    let push = push::open(&node)?;
    tasks.spawn(notify::keep_substituting(node.clone(), Some(push.clone())));

    let Some(Ready { listener, tls, renewal }) = get_ready(&node).await else { return Ok(()) };
    let address = listener.local_addr()?;
    let authentication = Authentication::new(web)?;
    let audit = Audit::start(&node).await?;
    tasks.spawn(push::follow_users(push.clone(), authentication.clone(), node.config.address()));
    tasks.spawn(authentication.clone().follow(node.alerts.clone(), address));
    tasks.spawn(renewal);
    let seconds = Arc::new(RecentStates::default());
    tasks.spawn(count_seconds(node.bus.clone(), seconds.clone()));

    let server = Server {
        network,
        previews,
        host,
        bus: node.bus.clone(),
        stop: node.stop.clone(),
        heartbeats: Default::default(),
        commands: Default::default(),
        seconds,
        drafts: drafts::Drafts::of(&node.config),
        forecasts: Semaphore::new(server::FORECASTS),
        plans: Default::default(),
        tested: Default::default(),
        push,
        audit: audit.clone(),
        sockets: Places::new(socket::ROOM),
        config: node.config.clone(),
    };
    let gate = Gate::new(address, host_name(), web.names.clone(), &web.webcam);
    let app = router::router(Arc::new(server), gate, authentication);
    let scheme = if tls.is_some() { "https" } else { "http" };
    let url = format!("{scheme}://{}/", reachable(address));
    node.figure("page_url", Scalar::Text(url.clone()));
    tracing::info!("page: {url}");

    let stop = node.stop.clone();
    let ended = tokio::select! {
        () = local_http::serve_tls(listener, tls, app, LIMITS, async move { stop.wait().await }) => Ok(()),
        Some(ended) = tasks.join_next() => ended.context("a task of the web node failed").flatten(),
    };
    audit.end().await;
    ended
}

/// What the page is served with.
struct Ready {
    listener: TcpListener,
    tls: Option<TlsAcceptor>,
    /// Follows the files of the certificate, for ever.
    renewal: Pin<Box<dyn Future<Output = anyhow::Result<()>> + Send>>,
}

/// Takes the page's address, again and again until it may be served there and is free; absent when the node is stopped
/// before.
async fn get_ready(node: &node::Node) -> Option<Ready> {
    loop {
        let (key, why) = match try_once(node).await {
            Ok(ready) => {
                for key in ["web.listen", "web.certificate"] {
                    node.alerts.clear(AlertKind::Configuration, key);
                }
                return Some(ready);
            }
            Err(failed) => failed,
        };
        node.alerts.raise(AlertKind::Configuration, key, &format!("{why}; it is tried again each 5 s"));
        node.stop.or(tokio::time::sleep(LISTEN_AGAIN)).await?;
    }
}

/// The failed key, and why.
async fn try_once(node: &node::Node) -> Result<Ready, (&'static str, String)> {
    let web = &node.config.web;
    may_listen(web).map_err(|why| ("web.listen", why))?;
    let mut tls = None;
    let mut renewal: Pin<Box<dyn Future<Output = _> + Send>> = Box::pin(std::future::pending());
    if let Some(files) = CertificateFiles::of(web) {
        let (acceptor, follow) = files.serve(node.alerts.clone()).map_err(|why| ("web.certificate", why))?;
        (tls, renewal) = (Some(acceptor), Box::pin(follow));
    }
    let listen = web.listen;
    let listener = TcpListener::bind(listen).await.map_err(|why| {
        let why = format!(
            "web.listen: the page cannot be served on {listen}: {why}; end the program that has this address, or choose \
             another port"
        );
        ("web.listen", why)
    })?;
    Ok(Ready { listener, tls, renewal })
}

async fn forget(network: Arc<network::Network>) -> anyhow::Result<()> {
    loop {
        tokio::time::sleep(FORGET_EVERY).await;
        network.forget();
    }
}

/// Knows that this node runs.
async fn count_seconds(bus: Bus, seconds: Arc<RecentStates>) -> anyhow::Result<()> {
    for second in 0.. {
        seconds.note(second, bus.clock().machine());
        tokio::time::sleep(SECOND).await;
    }
    Ok(())
}

/// An address that a browser on this machine can open.
fn reachable(address: SocketAddr) -> SocketAddr {
    match (address.ip().is_unspecified(), address) {
        (true, SocketAddr::V4(_)) => SocketAddr::from(([127, 0, 0, 1], address.port())),
        (true, SocketAddr::V6(_)) => SocketAddr::from((std::net::Ipv6Addr::LOCALHOST, address.port())),
        (false, _) => address,
    }
}

fn host_name() -> String {
    sysinfo::System::host_name().unwrap_or_default()
}
