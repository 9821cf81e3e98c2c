//! The web node: the whole telescope network on one page, and the same as JSON.
//!
//! It subscribes to every site and telescope on the bus (`hear`), stores the newest payload of each key with its time
//! of arrival (`model`), and shows that: a page with everything it needs built in (`routes::page`), updated over one
//! WebSocket (`ws`), the newest image of each telescope (`preview`), the heartbeat document that monitoring scripts
//! know (`routes::heartbeat`), and native JSON (`routes::network`). Ages are judged by this machine's clock at arrival
//! (`freshness`), so that a silent node is shown as silent.
//!
//! It is never in the safety path: it decides nothing, and nothing waits for it.
//!
//! # Invariants
//!
//! - Every payload that is shown was decoded as the type of its key: `a_required_field_of_a_wrong_type_is_not_taken`,
//!   `a_field_of_a_wrong_type_is_told_and_never_shown`.
//! - A silent node is shown as silent: `a_value_grows_stale_after_two_periods_and_is_lost_after_five`,
//!   `a_silent_observatory_is_an_error_and_never_safe`.
//! - Payloads of unknown programs push no telescope of the configuration off the page (decision 0050):
//!   `a_million_keys_of_a_stranger_leave_room_for_the_telescope_of_the_file`.
//! - A slow page delays nobody: `a_slow_page_gets_the_newest_value_of_each_key_once`.

mod alerts;
mod diary;
mod edge;
mod freshness;
mod gate;
mod hear;
mod host;
mod model;
mod network;
mod preview;
mod problem;
mod router;
mod routes;
mod server;
mod shrink;
mod stretch;
mod summary;
mod ws;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use contract::Scalar;
use contract::observatory::AlertKind;
use local_http::{Limits, Places, Room};
use tokio::net::TcpListener;
use tokio::task::JoinSet;

use crate::gate::Gate;
use crate::server::Server;

/// Sockets of pages that are open are counted apart (`ws`).
const LIMITS: Limits = Limits {
    room: Room { total: 400, per_address: 64, trusted: 80 },
    header: Duration::from_secs(5),
    total: Duration::from_secs(120),
};
/// An address that is taken is tried again after this.
const LISTEN_AGAIN: Duration = Duration::from_secs(5);
const FORGET_EVERY: Duration = Duration::from_secs(600);

/// Serves the page until the node is stopped.
pub async fn run(node: bus::Node) -> anyhow::Result<()> {
    let listen = node.config.web.listen;
    let Some(listener) = listen_on(&node, listen).await else { return Ok(()) };
    let address = listener.local_addr()?;

    let network = Arc::new(network::Network::new(node.bus.clock().clone(), node.config.address()));
    let previews = Arc::new(preview::Previews::new(network.clone())?);
    let host = Arc::new(host::Host::default());
    let mut tasks = JoinSet::new();
    hear::everything(&node.bus, &network, &previews, &mut tasks).await?;
    tasks.spawn(previews.clone().make());
    tasks.spawn(host.clone().measure(node.config.folders.data.clone()));
    tasks.spawn(forget(network.clone()));
    tasks.spawn(notify::keep_standing_in(node.clone()));

    let server = Server {
        network,
        previews,
        host,
        bus: node.bus.clone(),
        stop: node.stop.clone(),
        heartbeats: Default::default(),
        sockets: Places::new(ws::ROOM),
    };
    let app = router::router(Arc::new(server), Gate::new(address, host_name()));
    let url = format!("http://{}/", reachable(address));
    node.figure("page_url", Scalar::Text(url.clone()));
    tracing::info!("page: {url}");

    let stop = node.stop.clone();
    tokio::select! {
        () = local_http::serve(listener, app, LIMITS, async move { stop.wait().await }) => Ok(()),
        Some(ended) = tasks.join_next() => ended.context("a task of the web node failed")?,
    }
}

/// Takes the page's address, again and again until it is free; absent when the node is stopped before.
async fn listen_on(node: &bus::Node, listen: SocketAddr) -> Option<TcpListener> {
    loop {
        let why = match TcpListener::bind(listen).await {
            Ok(listener) => {
                node.alerts.clear(AlertKind::Configuration, "web.listen");
                return Some(listener);
            }
            Err(error) => error,
        };
        let why = format!(
            "web.listen: the page cannot be served on {listen}: {why}; end the program that has this address, or choose \
             another port; it is tried again each 5 s"
        );
        node.alerts.raise(AlertKind::Configuration, "web.listen", &why);
        node.stop.or(tokio::time::sleep(LISTEN_AGAIN)).await?;
    }
}

async fn forget(network: Arc<network::Network>) -> anyhow::Result<()> {
    loop {
        tokio::time::sleep(FORGET_EVERY).await;
        network.forget();
    }
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
