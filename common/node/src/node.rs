//! A node that has joined the bus, and what it publishes about itself.

use std::future::Future;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use bus::{Bus, Clock, MachineTime};
use config::Observatory;
use config::header::HeaderTable;
use contract::node::{DiaryLine, NodeState, Stopped};
use contract::{Key, Name, NodeTopic, Role, Scalar, printable};
use tokio::sync::mpsc;

use crate::alerts::NodeAlerts;
use crate::figures::Figures;
use crate::host::host_name;
use crate::stop::Stop;
use crate::{disk, flood, twin};

/// A node that has joined the bus.
#[derive(Clone)]
pub struct Node {
    /// The telescope's configuration.
    pub config: Arc<Observatory>,
    /// The site's FITS-header table.
    pub header: Arc<HeaderTable>,
    /// The bus.
    pub bus: Bus,
    /// This node's role.
    pub role: Role,
    /// This node's name.
    pub id: Name,
    /// Its alerts.
    pub alerts: NodeAlerts,
    /// Set when somebody asks the node to end. Observatory and device nodes first do what an end in good order needs,
    /// and then set [`Self::stop`] themselves; for the others both come together.
    pub ending: Stop,
    /// Set when it is time to end, at once.
    pub stop: Stop,
    figures: Figures,
    closed: Arc<OnceLock<bool>>,
}

/// The variable by which a supervisor names itself to its nodes, for what they publish when they end.
pub const SUPERVISOR: &str = "STARMESH_SUPERVISOR";
/// The last state is on its way for so long before the bus is left.
const LEAVES: Duration = Duration::from_millis(300);

impl Node {
    /// A node around a bus that is open already.
    pub fn new(role: Role, id: Name, config: Observatory, header: HeaderTable, bus: Bus) -> Self {
        let alerts = NodeAlerts::new(bus.clock().clone()).of(config.address());
        Self {
            config: Arc::new(config),
            header: Arc::new(header),
            bus,
            role,
            id,
            alerts,
            ending: Stop::default(),
            stop: Stop::default(),
            figures: Figures::default(),
            closed: Arc::default(),
        }
    }

    /// Notes, at an end in good order, whether what this node closes is verified closed; its last state publishes it.
    pub fn ends_closed(&self, is_closed: bool) {
        // The first one counts: a node ends once.
        let _ = self.closed.set(is_closed);
    }

    /// One of this node's own keys.
    pub fn key(&self, topic: NodeTopic) -> Key {
        Key::Node(self.config.address(), self.role, self.id.clone(), topic)
    }

    /// How this node signs commands and permits, such as `observatory/callisto/main`.
    pub fn signature(&self) -> String {
        format!("{}/{}/{}", self.role, self.config.place.telescope, self.id)
    }

    /// Sets a figure of this node's published state; its name ends in its unit.
    pub fn figure(&self, name: &str, value: Scalar) {
        self.figures.set(name, value);
    }

    /// Runs a node's work in parallel with its own publications (presence, health, alerts, diary) until it is stopped.
    pub async fn live<W>(self, diary: Option<mpsc::Receiver<DiaryLine>>, work: W) -> anyhow::Result<()>
    where
        W: Future<Output = anyhow::Result<()>>,
    {
        let _alive = self.bus.show_alive(&self.key(NodeTopic::Alive)).await?;
        let states = self.bus.publisher::<NodeState>(&self.key(NodeTopic::State)).await?;
        let alerts = self.bus.publisher(&self.key(NodeTopic::Alerts)).await?;
        let lines = self.bus.publisher(&self.key(NodeTopic::Diary)).await?;
        let (clock, state_key) = (self.bus.clock(), self.key(NodeTopic::State));
        let health = async {
            loop {
                let left_out = i64::try_from(flood::left_out()).unwrap_or(i64::MAX);
                self.figure("log_lines_left_out_count", Scalar::Int(left_out));
                states.put(self.state()).await?;
                clock.tick(Duration::from_secs(5)).await;
            }
        };
        let write = async {
            if let Some(mut diary) = diary {
                while let Some(line) = diary.recv().await {
                    lines.put(line).await?;
                }
            }
            std::future::pending::<anyhow::Result<()>>().await
        };
        let ended = tokio::select! {
            result = work => result,
            result = health => result,
            result = twin::leave_to_older(&state_key, &self.id, &self.bus, &self.alerts) => result,
            result = disk::keep_publishing(&self.config, self.role, &self.figures, &self.alerts, clock) => result,
            result = self.bus.keep_mending() => Ok(result?),
            result = write => result,
            () = self.alerts.keep_time() => Ok(()),
            result = alerts.follow(self.alerts.watch(), Duration::from_secs(10)) => Ok(result?),
        };
        if self.ending.is_stopped() && (ended.is_ok() || self.closed.get().is_some()) {
            // Others must not take the silence that follows for a fault.
            let last = NodeState { stopped: Some(self.stopped()), ..self.state() };
            if let Err(error) = states.put(last).await {
                tracing::warn!(%error, "the last state of this node was not published");
            }
            tokio::time::sleep(LEAVES).await;
        }
        ended
    }

    fn stopped(&self) -> Stopped {
        let who = std::env::var(SUPERVISOR).unwrap_or_else(|_| "a signal".to_owned());
        Stopped { by: printable(&format!("{who} on {}", host_name())).into_owned(), closed: self.closed.get().copied() }
    }

    fn state(&self) -> NodeState {
        let now = self.bus.clock().machine();
        NodeState {
            role: self.role,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            host: host_name(),
            pid: std::process::id(),
            uptime_s: now.since(started()).as_secs_f64(),
            speed: self.bus.clock().speed(),
            figures: self.figures.all(),
            stopped: None,
        }
    }
}

/// When this process started.
pub(crate) fn started() -> MachineTime {
    static STARTED: std::sync::OnceLock<MachineTime> = std::sync::OnceLock::new();
    *STARTED.get_or_init(|| Clock::machine_clock().machine())
}
