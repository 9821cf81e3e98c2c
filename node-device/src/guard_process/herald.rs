//! Publishes alerts on the bus while the device node cannot: with a session of its own, on threads of its own, so that
//! nothing that closes waits for it. The session is opened with the first alert and not before, unless a guard process
//! that has died left alerts on the bus: whoever received them holds them until its successor takes them back.

use std::time::Duration;

use bus::{Bus, Clock};
use contract::observatory::{AlertKind, Alerts};
use contract::{NodeTopic, Role};
use node::{Node, NodeOptions};
use tokio::sync::{mpsc, watch};

use super::copy::Copy;
use super::places::Places;

/// A bus that could not be joined is tried again so often.
const AGAIN: Duration = Duration::from_secs(10);

/// Alerts are published again so often.
const REPEATED: Duration = Duration::from_secs(10);

/// That there are none has reached everybody after this.
const RECEIVED: Duration = Duration::from_secs(60);

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
    places: Places,
}

impl Herald {
    /// For the domes of a device node; silent until something is raised or taken back.
    pub fn new(id: &str, options: &NodeOptions, places: &Places) -> Self {
        Self { changes: None, id: id.to_owned(), options: options.clone(), places: places.clone() }
    }

    /// Takes back the alerts of a guard process before this one that died with them: publishes that there are none. `copy`
    /// has the address of the bus. Reads the disk.
    pub fn take_back(&mut self, copy: &Copy) {
        if self.places.has_alerts() {
            self.start(copy);
        }
    }

    fn start(&mut self, copy: &Copy) {
        let (changes, received) = mpsc::unbounded_channel();
        let (id, copy) = (self.id.clone(), copy.clone());
        let (options, places) = (self.options.clone(), self.places.clone());
        let started = std::thread::Builder::new()
            .name("herald".to_owned())
            .spawn(move || run(&id, &copy, &options, places, received));
        match started {
            Ok(_) => self.changes = Some(changes),
            Err(error) => tracing::error!(%error, "alerts of the guard process cannot be published: no thread"),
        }
    }

    /// Raises or clears an alert. `copy` has the address of the bus. Never waits.
    pub fn report(&mut self, copy: &Copy, kind: AlertKind, instance: &str, cause: Option<String>) {
        if self.changes.is_none() && cause.is_some() {
            self.start(copy);
        }
        if let Some(changes) = &self.changes {
            // Without its thread the error is in the log.
            let _ = changes.send(Change { kind, instance: instance.to_owned(), cause });
        }
    }
}

fn run(id: &str, copy: &Copy, options: &NodeOptions, places: Places, received: mpsc::UnboundedReceiver<Change>) {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let ended = match runtime {
        Ok(runtime) => runtime.block_on(publish(id, copy, options, places, received)),
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
    places: Places,
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
        () = keep_noted(places, alerts.watch()) => Ok(()),
        ended = line.follow(alerts.watch(), REPEATED) => Ok(ended?),
    }
}

/// Notes on disk whether alerts are on the bus. The disk may hang: nothing else waits for it.
async fn keep_noted(places: Places, mut alerts: watch::Receiver<Alerts>) {
    loop {
        let are_some = !alerts.borrow_and_update().alerts.is_empty();
        if !are_some && tokio::time::timeout(RECEIVED, alerts.changed()).await.is_ok_and(|changed| changed.is_ok()) {
            continue;
        }
        let places = places.clone();
        let note = move || if are_some { places.note_alerts() } else { places.forget_alerts() };
        // A note that was not made leaves an alert that a person acknowledges.
        let _ = tokio::task::spawn_blocking(note).await;
        if alerts.changed().await.is_err() {
            return;
        }
    }
}
