//! The state that the routes share.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use audit::Audit;
use axum::body::Bytes;
use bus::{Bus, MachineTime};
use contract::Address;
use local_http::Places;
use node::Stop;
use notify::push::Subscriptions;
use orders::RecentStates;
use tokio::sync::Semaphore;

use crate::command_store::Commands;
use crate::drafts::Drafts;
use crate::forecast_store::Forecasts;
use crate::host::Host;
use crate::network::Network;
use crate::preview::Previews;

/// Checks and forecasts of schedules that this node asks for at the same time.
pub const FORECASTS: usize = 4;

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
    /// Commands of the last day.
    pub commands: Commands,
    /// This node's own seconds: a request that waited in a node that was stopped orders nothing.
    pub seconds: Arc<RecentStates>,
    /// Drafts of schedules.
    pub drafts: Drafts,
    /// Checks and forecasts of schedules that may be made at the same time.
    pub forecasts: Semaphore,
    /// Forecasts of the schedules in force.
    pub plans: Forecasts,
    /// When a test message was sent last: nobody's telephone is to ring without an end.
    pub tested: Mutex<Option<MachineTime>>,
    /// Browsers that get alerts.
    pub push: Arc<Subscriptions>,
    /// Who changed which user.
    pub audit: Audit,
    /// Sockets open now.
    pub sockets: Arc<Places>,
    /// The file of this node: the place of its site, and the limits of its telescope.
    pub config: Arc<config::Observatory>,
}
