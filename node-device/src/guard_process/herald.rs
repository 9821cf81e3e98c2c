//! Publishes alerts on the bus while the device node cannot: with a session of its own, on threads of its own, so that
//! nothing that closes waits for it. The session is opened with the first alert and not before.

use std::time::Duration;

use bus::{Bus, Clock};
use contract::observatory::AlertKind;
use contract::{NodeTopic, Role};
use node::{Node, NodeOptions};
use tokio::sync::mpsc;

use super::copy::Copy;

/// A bus that could not be joined is tried again so often.
const AGAIN: Duration = Duration::from_secs(10);

/// Alerts are published again so often.
const REPEATED: Duration = Duration::from_secs(10);

/// One change of an alert.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Change {
    kind: AlertKind,
    instance: String,
    /// The cause; none where it has gone.
    cause: Option<String>,
}

/// Takes the alerts of the guard process.
pub struct Herald {
    changes: Option<mpsc::UnboundedSender<Change>>,
    id: String,
    options: NodeOptions,
}

impl Herald {
    /// For the domes of a device node; silent until something is raised.
    pub fn new(id: &str, options: &NodeOptions) -> Self {
        Self { changes: None, id: id.to_owned(), options: options.clone() }
    }

    /// Raises or clears an alert. `copy` has the address of the bus. Never waits.
    pub fn report(&mut self, copy: &Copy, kind: AlertKind, instance: &str, cause: Option<String>) {
        if self.changes.is_none() && cause.is_some() {
            let (changes, received) = mpsc::unbounded_channel();
            let (id, copy, options) = (self.id.clone(), copy.clone(), self.options.clone());
            let started = std::thread::Builder::new()
                .name("herald".to_owned())
                .spawn(move || run(&id, &copy, &options, received));
            match started {
                Ok(_) => self.changes = Some(changes),
                Err(error) => tracing::error!(%error, "alerts of the guard process cannot be published: no thread"),
            }
        }
        if let Some(changes) = &self.changes {
            // Without its thread the error is in the log.
            let _ = changes.send(Change { kind, instance: instance.to_owned(), cause });
        }
    }
}

fn run(id: &str, copy: &Copy, options: &NodeOptions, received: mpsc::UnboundedReceiver<Change>) {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let ended = match runtime {
        Ok(runtime) => runtime.block_on(publish(id, copy, options, received)),
        Err(error) => Err(error.into()),
    };
    if let Err(error) = ended {
        tracing::error!(%error, "alerts of the guard process cannot be published");
    }
}

async fn publish(
    id: &str,
    copy: &Copy,
    options: &NodeOptions,
    mut received: mpsc::UnboundedReceiver<Change>,
) -> anyhow::Result<()> {
    let connect = copy.connect.iter().chain(&options.connect).cloned().collect();
    let multicast = copy.multicast && !options.no_multicast;
    let meeting = config::Bus { listen: Vec::new(), connect, multicast };
    let place = serde_json::json!({ "observatory": {
        "site": copy.site, "telescope": copy.telescope, "latitude_deg": 0.0, "longitude_deg": 0.0, "elevation_m": 0.0,
    }});
    let config: config::Observatory = serde_json::from_value(place)?;
    let bus = loop {
        match Bus::open(&meeting, Clock::machine_clock()).await {
            Ok(bus) => break bus,
            Err(error) => tracing::warn!(%error, "the bus cannot be joined for an alert; tried again"),
        }
        tokio::time::sleep(AGAIN).await;
    };
    let node = Node::new(Role::Device, format!("{id}-guard").parse()?, config, Default::default(), bus);
    let alerts = node.alerts.clone();
    // Alerts and nothing else: it is no node whose clock and disk anything depends on.
    let line = node.bus.publisher(&node.key(NodeTopic::Alerts)).await?;
    let changing = async {
        while let Some(Change { kind, instance, cause }) = received.recv().await {
            match cause {
                Some(cause) => alerts.raise(kind, instance, &cause),
                None => alerts.clear(kind, instance),
            }
        }
        Ok(())
    };
    tokio::select! {
        ended = changing => ended,
        () = alerts.keep_time() => Ok(()),
        ended = line.follow(alerts.watch(), REPEATED) => Ok(ended?),
    }
}
