//! One zenoh session per node, with measured settings.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use contract::{BootId, Key};
use serde_json::json;
use tokio::sync::Semaphore;

use crate::transit::Transit;
use crate::writers::Writers;
use crate::{Clock, history, listening};

/// The largest payload that is sent; what receivers take has some room for zenoh's own headers.
pub const MOST_BYTES: usize = 4 << 20;
const MOST_MESSAGE: usize = MOST_BYTES + (64 << 10);

/// Why the bus could not be joined or used.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The session did not open.
    #[error("cannot join the bus (listen {listen:?}, connect {connect:?}): {source}")]
    Open {
        /// Where it should listen.
        listen: Vec<String>,
        /// Whom it should meet.
        connect: Vec<String>,
        /// The error of zenoh.
        source: zenoh::Error,
    },
    /// A declaration failed.
    #[error("cannot declare {what} on {key}: {source}")]
    Declare {
        /// What was declared.
        what: &'static str,
        /// On which key.
        key: String,
        /// The error of zenoh.
        source: zenoh::Error,
    },
    /// A payload could not be sent.
    #[error("cannot publish on {key}: {detail}")]
    Publish {
        /// On which key.
        key: String,
        /// Why.
        detail: String,
    },
}

/// How often an address is tried that was free when it was looked at and taken when it was used.
const TRIES: u32 = 5;
const PAUSE: Duration = Duration::from_millis(200);

/// A node's place on the bus. Cheap to clone.
#[derive(Clone)]
pub struct Bus {
    pub(crate) session: zenoh::Session,
    pub(crate) writers: Writers,
    boot_id: Arc<BootId>,
    clock: Clock,
    pub(crate) transit: Arc<Mutex<Transit>>,
    /// Turns to be answered with all that publishers hold.
    pub(crate) turns: Arc<Semaphore>,
}

/// A liveliness token; others see it go when this is dropped or the process dies.
pub struct Alive {
    _token: zenoh::liveliness::LivelinessToken,
}

impl Bus {
    /// Joins the bus. An address of `listen` that another program holds is met instead of listened on.
    pub async fn open(config: &config::Bus, clock: Clock) -> Result<Self, BusError> {
        Self::open_as(true, config, clock).await
    }

    /// As [`Self::open`], for a program that may look at several networks at once: it meets the peers of each, and introduces
    /// none to another.
    pub async fn visit(config: &config::Bus, clock: Clock) -> Result<Self, BusError> {
        Self::open_as(false, config, clock).await
    }

    async fn open_as(introduces: bool, config: &config::Bus, clock: Clock) -> Result<Self, BusError> {
        let mut tries = 0;
        loop {
            // Roles of one file are started together: an address that was free may be taken a moment later.
            let config = listening::share(config);
            let opened = match zenoh::Config::from_json5(&settings(introduces, &config).to_string()) {
                Ok(settings) => zenoh::open(settings).await,
                Err(error) => Err(error),
            };
            tries += 1;
            match opened {
                Ok(session) => {
                    let boot_id = Arc::new(BootId::fresh());
                    let (writers, transit) = Default::default();
                    let turns = Arc::new(Semaphore::new(history::AT_ONCE));
                    return Ok(Self { session, writers, boot_id, clock, transit, turns });
                }
                Err(_) if tries < TRIES && !config.listen.is_empty() => tokio::time::sleep(PAUSE).await,
                Err(source) => {
                    return Err(BusError::Open { listen: config.listen, connect: config.connect, source });
                }
            }
        }
    }

    /// The clock of this node.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// This incarnation of this node.
    pub fn boot_id(&self) -> &BootId {
        &self.boot_id
    }

    /// Shows that this node lives, under the given key.
    pub async fn show_alive(&self, key: &Key) -> Result<Alive, BusError> {
        let token = self.session.liveliness().declare_token(key.to_string()).await;
        let declare = |source| BusError::Declare { what: "a liveliness token", key: key.to_string(), source };
        Ok(Alive { _token: token.map_err(declare)? })
    }

    /// Number of peers that this node is connected to.
    pub async fn peers(&self) -> usize {
        self.session.info().peers_zid().await.count()
    }

    /// Where others can reach this node, such as `tcp/127.0.0.1:41234`.
    pub async fn locators(&self) -> Vec<String> {
        self.session.info().locators().await.iter().map(ToString::to_string).collect()
    }

    /// Leaves the bus; at most 2 s, since closing can hang under packet loss.
    pub async fn close(self) {
        if tokio::time::timeout(Duration::from_secs(2), self.session.close()).await.is_err() {
            tracing::warn!("the bus took longer than 2 s to close");
        }
    }
}

/// Of a session that only introduces others to each other: nobody dials it, and it dials nobody of whom it hears.
pub(crate) fn introducing(connect: Vec<String>) -> serde_json::Value {
    let mut settings = settings(true, &config::Bus { listen: Vec::new(), connect, multicast: false });
    settings["listen"]["endpoints"] = json!([]);
    settings["scouting"]["gossip"]["autoconnect"] = json!({ "peer": [] });
    settings
}

fn settings(introduces: bool, config: &config::Bus) -> serde_json::Value {
    // Whom it tells of the others. There is no router, so a list of routers is nobody.
    let told = if introduces { ["router", "peer"].as_slice() } else { &["router"] };
    let listen = match (config.listen.is_empty(), config.multicast) {
        (false, _) => config.listen.clone(),
        (true, true) => vec!["tcp/0.0.0.0:0".to_owned()],
        (true, false) => vec!["tcp/127.0.0.1:0".to_owned()],
    };
    json!({
        "mode": "peer",
        // Without a time zenoh tries no address twice, also none that is to be tried again.
        "listen": { "endpoints": listen, "timeout_ms": 300 },
        "connect": {
            "endpoints": config.connect,
            // -1: never give a peer up. zenoh tries in the background, so opening does not wait; 0 would try just once.
            "timeout_ms": -1, "exit_on_failure": false,
            "retry": { "period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5 },
        },
        // Peers do not relay: gossip is what connects those that met through a third.
        "scouting": { "delay": 200, "multicast": { "enabled": config.multicast }, "gossip": { "enabled": true, "target": { "peer": told } } },
        "timestamping": { "enabled": true },
        "queries_default_timeout": 3000,
        "transport": {
            "unicast": { "open_timeout": 3000, "accept_timeout": 3000 },
            "link": {
                // zenoh's own limit is 1 GiB: one message of 400 MB took a node from 33 to 854 MB.
                "rx": { "max_message_size": MOST_MESSAGE },
                "tx": {
                // No safety decision depends on the lease; each keep-alive wakes both ends of a link, and an idle
                // node does little else.
                "lease": 4000, "keep_alive": 3,
                // Messages that block (queries, declarations) may stall the others for 0.3 s, not for zenoh's 5 s.
                    "queue": { "congestion_control": { "block": { "wait_before_close": 300_000 } } },
                },
            },
        },
    })
}
