//! Gives the guard its eyes and hands, beside the dome's own loop and never waiting for it.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bus::{Catch, MachineTime, Node, Quality, Subscriber};
use contract::device::dome::{Guard as Said, Shutter};
use contract::device::telescope;
use contract::observatory::{AlertKind, Permit};
use contract::{Address, Device, DeviceState, Key, Kind};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep_until};

use crate::alpaca::{Alpaca, AlpacaError, value};
use crate::driver::dome::SHUTTER;
use crate::guard::{Alarm, Deed, Guard};
use crate::watchdog::Watchdog;

/// The guard looks at least so often; it looks at once when a permit or a shutter reading comes.
const BEAT: Duration = Duration::from_secs(1);
const LOOK: Duration = Duration::from_millis(250);
/// A shutter reading that is older proves nothing.
const FRESH: Duration = Duration::from_secs(5);
/// The guard asks the shutter itself when the dome's own loop is silent for so long.
const SILENT: Duration = Duration::from_millis(2500);
/// A mount that was not heard for so long is not known to be parked.
const MOUNT_FRESH: Duration = Duration::from_secs(10);

/// The shutter as it was read, and when.
pub type Seen = Option<(Shutter, MachineTime)>;

/// The guard of one dome at work.
pub struct GuardTask {
    /// The guard, shared with those who take commands.
    pub guard: Arc<Mutex<Guard>>,
    /// The node.
    pub node: Node,
    /// The dome.
    pub device: Device,
    /// The dome's server.
    pub alpaca: Alpaca,
    /// False: never send Connected = true.
    pub connect: bool,
    /// What the dome's own loop reads.
    pub seen: watch::Receiver<Seen>,
    /// The mounts under the dome must be heard, because the shutter waits for their park.
    pub heeds_mounts: bool,
    /// The dome's own watchdog.
    pub watchdog: Watchdog,
}

/// What the guard's own calls came to.
enum Hand {
    Looked(Result<Shutter, AlpacaError>),
    Acted(Result<(), AlpacaError>),
    Fed(Result<(), AlpacaError>),
}

/// What was heard of the mounts under the dome.
struct Mounts {
    heard: Subscriber<DeviceState<telescope::Fields>>,
    parked: Vec<(Device, bool, MachineTime)>,
}

impl GuardTask {
    /// Guards until the node is stopped.
    pub async fn run(mut self) -> anyhow::Result<()> {
        let bus = self.node.bus.clone();
        let clock = bus.clock().clone();
        let says = bus.publisher::<Said>(&Key::Guard(self.device.clone()), Quality::Urgent).await?;
        let keys =
            format!("{}/{}/*/observatory/permit/{}", contract::key::ROOT, self.device.address.site, self.device.name);
        let permits = bus.subscribe::<Permit>(&keys, Catch::Newest, 64).await?;
        let mut mounts = if self.heeds_mounts { Some(self.mounts().await?) } else { None };

        let mut next_beat = Instant::now();
        let mut look = interval(LOOK);
        look.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut hands = JoinSet::new();
        let mut own: Seen = None;
        let (mut looking, mut acting) = (false, false);
        let mut waiting: Option<Deed> = None;
        self.watchdog.tell(&self.node, &self.device);
        loop {
            let beaten = tokio::select! {
                () = self.node.stop.wait() => return Ok(()),
                () = sleep_until(next_beat) => {
                    next_beat = Instant::now() + clock.machine().to_tick(BEAT);
                    true
                }
                _ = look.tick() => false,
                heard = permits.hear() => {
                    if let Key::Permit(Address { telescope, .. }, _) = &heard.key
                        && let Err(why) = self.guard().hear(telescope, &heard.said)
                    {
                        tracing::debug!(dome = %self.device.name, %telescope, ?why, "permit dropped");
                    }
                    false
                }
                changed = self.seen.changed() => {
                    if changed.is_err() && self.node.stop.is_stopped() {
                        return Ok(());
                    } else if changed.is_err() {
                        anyhow::bail!("the loop of dome {} has ended", self.device.name);
                    }
                    false
                }
                () = hear_mounts(&mut mounts) => false,
                Some(done) = hands.join_next() => {
                    match done {
                        Ok(Hand::Looked(read)) => {
                            looking = false;
                            own = read.ok().map(|shutter| (shutter, clock.machine())).or(own);
                        }
                        Ok(Hand::Acted(result)) => {
                            acting = false;
                            if let Err(error) = result {
                                tracing::warn!(dome = %self.device.name, %error, "the guard's command failed");
                            }
                        }
                        Ok(Hand::Fed(result)) => self.watchdog.fed(&self.node, &self.device, result),
                        // a hand that panicked must not stay raised
                        Err(_) => (looking, acting) = (false, false),
                    }
                    false
                }
            };
            let now = clock.machine();
            let seen = [*self.seen.borrow_and_update(), own].into_iter().flatten().max_by_key(|(_, at)| *at);
            let shutter = seen.filter(|(_, at)| now.since(*at) <= FRESH).map(|(shutter, _)| shutter);
            let parked = mounts.as_ref().is_none_or(|mounts| mounts.all_parked(now));
            let deeds = self.guard().look(now, shutter, parked);
            for deed in deeds {
                match deed {
                    Deed::Raise(alarm) => self.raise(alarm),
                    Deed::Clear(alarm) => self.node.alerts.clear(kind(alarm), &self.device.name),
                    Deed::Close | Deed::AbortThenClose => waiting = Some(deed),
                }
            }
            if !acting && let Some(deed) = waiting.take() {
                acting = true;
                tracing::warn!(dome = %self.device.name, ?deed, "the guard acts");
                hands.spawn(act(self.alpaca.at_once(), deed, self.connect));
            }
            let silent = seen.is_none_or(|(_, at)| now.since(at) > SILENT);
            if beaten && !looking && silent {
                looking = true;
                hands.spawn(read(self.alpaca.at_once()));
            }
            // only a beat of this loop with a living permit feeds it: a thread of its own would feed it for the dead
            let lives = beaten && self.guard().may_be_open(now) && !self.guard().is_closing();
            if let Some(feed) = self.watchdog.due(lives, now, &self.alpaca) {
                hands.spawn(async move { Hand::Fed(feed.await) });
            }
            if beaten {
                let number = self.guard().beat(clock.machine());
                let said = self.guard().says(number, clock.machine(), permits.malformed());
                says.put(said).await?;
            }
        }
    }

    fn guard(&self) -> std::sync::MutexGuard<'_, Guard> {
        self.guard.lock().unwrap_or_else(PoisonError::into_inner)
    }

    async fn mounts(&self) -> anyhow::Result<Mounts> {
        let keys = format!("{}/{}/*/device/telescope/*/state", contract::key::ROOT, self.device.address.site);
        let heard = self.node.bus.subscribe(&keys, Catch::Newest, 64).await?;
        let telescopes = self.guard().telescopes().to_vec();
        let never = self.node.bus.clock().machine();
        // until it is heard, each telescope counts as one mount that is not parked
        let parked = telescopes.into_iter().filter_map(|telescope| {
            let address = Address { site: self.device.address.site.clone(), telescope };
            Some((address.device(Kind::Telescope, &"unheard".parse().ok()?), false, never))
        });
        Ok(Mounts { heard, parked: parked.collect() })
    }

    fn raise(&self, alarm: Alarm) {
        let name = &self.device.name;
        let cause = match alarm {
            Alarm::NotClosed => format!("dome {name} should be closed and is not verified closed"),
            Alarm::Uncommanded => format!("dome {name} opened and nobody had commanded it"),
            Alarm::MountNotParked => format!("dome {name} must close and waits for its mount to park"),
            Alarm::Hold => format!("the guard closed dome {name} because its permission was not renewed"),
        };
        self.node.alerts.raise(kind(alarm), name, &cause);
    }
}

fn kind(alarm: Alarm) -> AlertKind {
    match alarm {
        Alarm::NotClosed => AlertKind::DomeNotClosed,
        Alarm::Uncommanded => AlertKind::DomeUncommandedOpen,
        Alarm::MountNotParked => AlertKind::DomeWaitsForMount,
        Alarm::Hold => AlertKind::DomeHeld,
    }
}

async fn hear_mounts(mounts: &mut Option<Mounts>) {
    let Some(mounts) = mounts else { return std::future::pending().await };
    let heard = mounts.heard.hear().await;
    let Key::State(device) = heard.key else { return };
    let fresh = heard.said.body.fields.at_park.known() == Some(&true);
    if !mounts.parked.iter().any(|(known, ..)| known.address == device.address) {
        return;
    }
    let unheard = |known: &Device| known.address == device.address && known.name.as_str() == "unheard";
    mounts.parked.retain(|(known, ..)| *known != device && !unheard(known));
    mounts.parked.push((device, fresh, heard.arrived));
}

impl Mounts {
    fn all_parked(&self, now: MachineTime) -> bool {
        self.parked.iter().all(|(_, parked, at)| *parked && now.since(*at) <= MOUNT_FRESH)
    }
}

async fn read(alpaca: Alpaca) -> Hand {
    let shutter = alpaca.get("shutterstatus").await.and_then(|answer| {
        let number = value::whole(&answer).map_err(AlpacaError::Value)?;
        let found = SHUTTER.iter().find(|(n, _)| *n == number).map(|(_, shutter)| *shutter);
        found.ok_or_else(|| AlpacaError::Protocol(format!("ShutterStatus is {number}")))
    });
    Hand::Looked(shutter)
}

async fn act(alpaca: Alpaca, deed: Deed, connect: bool) -> Hand {
    if deed == Deed::AbortThenClose {
        // whether it stopped or not, closing follows
        let _ = alpaca.put("abortslew", &[]).await;
    }
    let mut closed = alpaca.put("closeshutter", &[]).await;
    if connect && closed.as_ref().is_err_and(AlpacaError::is_not_connected) {
        // the device was restarted, and its own loop has not come round yet
        let _ = alpaca.put("connected", &[("Connected", "True")]).await;
        closed = alpaca.put("closeshutter", &[]).await;
    }
    Hand::Acted(closed)
}
