//! HTTP inside an observatory: a client that uses no proxy, and a server whose connections no single client can use up.
//!
//! [`client_builder`] makes every client that talks to hardware, to a spool or to another of our own addresses.
//! [`serve()`] serves the spool, and [`serve_tls`] the page, with TLS or without: it limits connections in all, connections of one address ([`Places`]), and
//! the time that a request may take.
//!
//! # Invariants
//!
//! - What an unknown client can use up is limited where it connects (decision 0050):
//!   `one_address_has_its_share_and_strangers_leave_room_for_the_trusted`,
//!   `half_requests_hold_the_places_of_one_address_and_give_them_back`.
//! - No other place in the workspace makes an HTTP client for hardware or for our own addresses:
//!   `clients_for_hardware_and_our_own_addresses_are_made_in_one_place`.

mod places;
mod serve;

pub use places::{Place, Places, Room, network};
pub use serve::{Limits, Peer, serve, serve_tls};

/// A client for hardware and for our own addresses. It uses no proxy, whatever the environment contains: `http_proxy`
/// is meant for the internet, and a proxy does not know an observatory's network. It follows no redirection either,
/// because none of these servers has a reason to send a client elsewhere.
pub fn client_builder() -> reqwest::ClientBuilder {
    #[allow(clippy::disallowed_methods, reason = "this is the place that all others use")]
    let builder = reqwest::Client::builder();
    builder.no_proxy().redirect(reqwest::redirect::Policy::none())
}

/// The same, ready to use.
///
/// # Errors
/// Only where the system gives no client at all.
pub fn client() -> reqwest::Result<reqwest::Client> {
    client_builder().build()
}
