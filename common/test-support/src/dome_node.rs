//! The device node of a dome whose telescope has no observatory node any more, as others see it on the bus.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bus::{Bus, Service};
use contract::device::dome::{self, Guard, GuardAction, ReceivedPermit, Shutter};
use contract::node::NodeState;
use contract::observatory::{AlertKind, Alerts};
use contract::{Accepted, Command, Datum, Device, DeviceState, Key, Link, NodeTopic, Reply, Role};
use tokio::sync::watch;
use tokio::task::JoinSet;

/// It publishes a shutter in error, a permit that ran out 24 s ago, and an alert; it closes when it is commanded to.
pub struct DomeNode {
    /// The commands that it took.
    pub commands: Arc<Mutex<Vec<Command<dome::Command>>>>,
    /// The shutter as it reports it; the guard vouches for one that is closed.
    pub shutter: watch::Sender<Shutter>,
    /// Commands to close are taken, and the shutter stays where it is.
    pub sticks: Arc<AtomicBool>,
    _tasks: JoinSet<()>,
    _service: Service,
}

impl DomeNode {
    /// Starts it for a dome over this telescope.
    pub async fn start(bus: &Bus, dome: Device, telescope: &str) -> Self {
        let (shutter, commands) = (watch::channel(Shutter::Error).0, Arc::<Mutex<Vec<_>>>::default());
        let mut tasks = JoinSet::new();
        let node = |topic| Key::Node(dome.address.clone(), Role::Device, "enclosure".parse().unwrap(), topic);
        let about = NodeState {
            role: Role::Device,
            version: "0.1.0".to_owned(),
            host: "dome-pc".to_owned(),
            pid: 1,
            uptime_s: 100.0,
            speed: 1.0,
            figures: Default::default(),
            stopped: None,
        };
        let states = bus.publisher::<NodeState>(&node(NodeTopic::State)).await.unwrap();
        let alert = AlertKind::DomeNotClosed.alert(&dome.name, bus.clock().utc(), "it is half open");
        let alerts = bus.publisher::<Alerts>(&node(NodeTopic::Alerts)).await.unwrap();
        let domes = bus.publisher::<DeviceState<dome::Fields>>(&Key::State(dome.clone())).await.unwrap();
        let guards = bus.publisher::<Guard>(&Key::Guard(dome.clone())).await.unwrap();
        let (seen, telescope) = (shutter.subscribe(), telescope.to_owned());
        tasks.spawn(async move {
            for number in 0.. {
                let shutter = *seen.borrow();
                states.put(about.clone()).await.unwrap();
                alerts.put(Alerts { alerts: vec![alert.clone()], ..Alerts::default() }).await.unwrap();
                domes.put(dome_state(shutter)).await.unwrap();
                guards.put(guard(number, &telescope, shutter)).await.unwrap();
                tokio::time::sleep(Duration::from_millis(200)).await;
            }
        });
        let (taken, closes, sticks) = (commands.clone(), shutter.clone(), Arc::<AtomicBool>::default());
        let is_stuck = sticks.clone();
        let key = Key::Command(dome);
        let service = bus.serve(&key, move |command: Result<Command<dome::Command>, String>| {
            let command = command.unwrap();
            let id = command.id.clone();
            if command.action == dome::Command::CloseShutter && !is_stuck.load(Ordering::Relaxed) {
                closes.send_replace(Shutter::Closed);
            }
            taken.lock().unwrap().push(command);
            async move { Reply::Accepted(Accepted { id, token: None, not_written: None }) }
        });
        Self { commands, shutter, sticks, _tasks: tasks, _service: service.await.unwrap() }
    }
}

/// The state of a dome that answers and whose shutter stands so; nothing else is known of it.
pub fn dome_state(shutter: Shutter) -> DeviceState<dome::Fields> {
    DeviceState {
        link: Link::Connected,
        busy: false,
        period_s: 1.0,
        poll_s: None,
        last_command: None,
        fields: dome::Fields { shutter: Datum::Known(shutter), ..dome::Fields::default() },
        readings: Default::default(),
    }
}

fn guard(number: u64, telescope: &str, shutter: Shutter) -> Guard {
    let is_closed = shutter == Shutter::Closed;
    let commander = format!("observatory/{telescope}/main");
    Guard {
        number,
        token: 1,
        permit_valid_s: 10.0,
        permits: vec![ReceivedPermit { telescope: telescope.to_owned(), commander, safe: true, left_s: -24.0 }],
        may_be_open: false,
        action: if is_closed { GuardAction::Watching } else { GuardAction::Closing },
        hold: is_closed,
        dropped: 0,
        verified_closed: Some(is_closed),
        waits_for_mounts: Some(false),
        watchdog_s: Some(120.0),
        granted: Vec::new(),
    }
}
