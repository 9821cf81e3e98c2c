//! The simulator as a server: start, address, stop.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::StatusCode;
use axum::routing::{any, get, put};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tracing::info;

use crate::connection::{Listener, Scissors, listen};
use crate::options::Options;
use crate::world::World;
use crate::{alpaca, control, discovery, management};

/// How often the world moves by itself, machine time; requests move it too.
const TICK: Duration = Duration::from_millis(100);

/// Why a simulator did not start.
#[derive(Debug, thiserror::Error)]
pub enum SimulatorError {
    /// The Alpaca address is taken, or belongs to another host.
    #[error("cannot listen on {address}")]
    Bind {
        /// As asked for.
        address: SocketAddr,
        /// The error of the system.
        #[source]
        source: std::io::Error,
    },
    /// The discovery port is taken.
    #[error("cannot listen on UDP port {port} for discovery")]
    Discovery {
        /// As asked for.
        port: u16,
        /// The error of the system.
        #[source]
        source: std::io::Error,
    },
    /// Site or start of the options.
    #[error("no sky for this site and time")]
    Sky(#[from] sky::SkyError),
    /// A speed that is no positive number.
    #[error("speed {0} is not a positive number")]
    Speed(f64),
    /// A transit of a star that the sky does not have.
    #[error(
        "no star is within 5 arcsec of ra={ra_deg},dec={dec_deg}; the place of a transit is that of a star of the simulated sky"
    )]
    NoStar {
        /// As asked for, degrees.
        ra_deg: f64,
        /// As asked for, degrees.
        dec_deg: f64,
    },
}

/// A running simulator; dropping it ends it.
pub struct Simulator {
    world: Arc<World>,
    address: SocketAddr,
    stop: watch::Sender<bool>,
    tasks: JoinSet<()>,
}

impl Simulator {
    /// Starts a simulator; it answers as soon as this returns.
    ///
    /// # Errors
    /// [`SimulatorError`] when an address is taken or the options make no sense.
    pub async fn start(options: Options) -> Result<Self, SimulatorError> {
        if !(options.speed > 0.0 && options.speed.is_finite()) {
            return Err(SimulatorError::Speed(options.speed));
        }
        if let Some(transit) = options.transits.iter().find(|transit| !transit.has_star(options.seed)) {
            let (ra_deg, dec_deg) = (transit.place.ra.degrees(), transit.place.dec.degrees());
            return Err(SimulatorError::NoStar { ra_deg, dec_deg });
        }
        let bound = listen(options.bind).await;
        let (listener, address) = bound.map_err(|source| SimulatorError::Bind { address: options.bind, source })?;
        let mut tasks = JoinSet::new();
        if let Some(port) = options.discovery_port {
            let socket = discovery::bind(port).await;
            let socket = socket.map_err(|source| SimulatorError::Discovery { port, source })?;
            tasks.spawn(discovery::answer(socket, address.port()));
        }
        let world = Arc::new(World::new(&options)?);
        let (stop, stopped) = watch::channel(false);
        let routes = routes(world.clone());
        tasks.spawn(async move {
            let service = routes.into_make_service_with_connect_info::<Scissors>();
            let _ = axum::serve(Listener::new(listener, stopped), service).await;
        });
        tasks.spawn(tick(world.clone()));
        info!(%address, speed = options.speed, start = %options.start, "simulator answers");
        Ok(Self { world, address, stop, tasks })
    }

    /// Where the Alpaca server listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The world behind it: its clock, its truth, its faults, its log.
    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// Ends it: no connection survives, and the port is free when this returns.
    pub async fn stop(mut self) {
        let _ = self.stop.send(true);
        self.tasks.shutdown().await;
    }
}

/// Runs a simulator until `stop` is done.
///
/// # Errors
/// As [`Simulator::start`].
pub async fn run(options: Options, stop: impl Future<Output = ()>) -> Result<(), SimulatorError> {
    let simulator = Simulator::start(options).await?;
    stop.await;
    simulator.stop().await;
    Ok(())
}

/// Lets the world move while no client asks.
async fn tick(world: Arc<World>) {
    let mut ticks = tokio::time::interval(TICK);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        world.advance();
    }
}

fn routes(world: Arc<World>) -> Router {
    Router::new()
        .route("/api/v1/{kind}/{number}/{member}", any(alpaca::device))
        .route("/management/apiversions", get(management::versions))
        .route("/management/v1/description", get(management::description))
        .route("/management/v1/configureddevices", get(management::devices))
        .route("/simulator/v1/clock", get(control::clock))
        .route("/simulator/v1/world", get(control::world))
        .route("/simulator/v1/world/{thing}", put(control::change))
        .route("/simulator/v1/faults", get(control::faults).delete(control::clear))
        .route("/simulator/v1/faults/{kind}", put(control::set_fault))
        .route("/simulator/v1/log", get(control::log))
        .fallback(async || alpaca::text(StatusCode::BAD_REQUEST, "there is no such address".to_owned()))
        .layer(DefaultBodyLimit::max(1 << 16))
        .with_state(world)
}
