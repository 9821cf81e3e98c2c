//! The state that the routes share.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use axum::body::Bytes;
use bus::{Bus, MachineTime, Stop};
use contract::Address;
use local_http::Places;

use crate::host::Host;
use crate::network::Network;
use crate::preview::Previews;

/// The state that the routes share.
pub struct Server {
    /// Everything that was received.
    pub network: Arc<Network>,
    /// Images.
    pub previews: Arc<Previews>,
    /// This machine.
    pub host: Arc<Host>,
    /// The bus, for its health.
    pub bus: Bus,
    /// Ends the sockets too.
    pub stop: Stop,
    /// Heartbeat documents that were made a moment ago.
    pub heartbeats: Mutex<BTreeMap<Option<Address>, (MachineTime, Bytes)>>,
    /// Sockets open now.
    pub sockets: Arc<Places>,
}
