//! Connects the guard to its inputs and to the shutter, in parallel with the dome's own loop and never waiting for it.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use alpaca::{Alpaca, AlpacaError};
use audit::GUARD;
use bus::{Catch, MachineTime, Node, Quality, Subscriber};
use contract::audit::Outcome;
use contract::device::dome::{Guard as Said, Shutter};
use contract::device::telescope;
use contract::observatory::{AlertKind, Permit};
use contract::{Address, CommandId, Device, DeviceState, Key, Kind};
use interlock::guard::{Alarm, Deed, FRESH};
use interlock::{DomeReport, Dropped, Guard, MountsUnder, Taken};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep_until};

use crate::accounts::{Accounts, Asked};
use crate::guard_process::link::GuardLink;
use crate::guard_process::places::nanos;
use crate::shutter_status::shutter_status;
use crate::watchdog::Watchdog;

/// The guard looks at least so often; it looks at once when a permit or a shutter reading comes.
const BEAT: Duration = Duration::from_secs(1);
const LOOK: Duration = Duration::from_millis(250);
/// The guard asks the shutter itself when the dome's own loop is silent for so long.
const SILENT: Duration = Duration::from_millis(2500);
/// An impostor that published nothing for so long is gone.
const GONE: Duration = Duration::from_secs(10);

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
    /// The audit log of the guard's actions.
    pub accounts: Accounts,
    /// What the dome's own loop reads.
    pub seen: watch::Receiver<Seen>,
    /// The guard needs the states of the mounts under the dome, because the shutter waits for their park.
    pub heeds_mounts: bool,
    /// The dome's own watchdog.
    pub watchdog: Watchdog,
    /// The guard process around this node, where there is one.
    pub link: Option<GuardLink>,
    /// Whether the shutter is verified closed.
    pub closed: watch::Sender<bool>,
}

/// What the guard's own calls came to.
enum Hand {
    Looked(Result<(Shutter, MachineTime), AlpacaError>),
    Acted(Result<(), AlpacaError>),
    Fed(Result<(), AlpacaError>),
}

/// The mounts under the dome, by their states.
struct Mounts {
    heard: Subscriber<DeviceState<telescope::Fields>>,
    under: MountsUnder,
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
        // The last guard action.
        let mut asked = Asked { from: GUARD.to_owned(), id: CommandId::default(), token: None };
        let mut done = "";
        let mut impostor: Option<MachineTime> = None;
        let mut was_closed = false;
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
                    {
                        let taken = self.guard().hear(telescope, &heard.said);
                        if let Some(why) = suspicion(taken) {
                            let cause = format!("{why}, for telescope {telescope}; it names itself {}", heard.said.body.commander);
                            self.node.alerts.raise(AlertKind::Impostor, format!("permit/{}", self.device.name), &cause);
                            impostor = Some(clock.machine());
                        }
                        if let Err(why) = taken {
                            tracing::debug!(dome = %self.device.name, %telescope, ?why, "permit dropped");
                        }
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
                Some(hand) = hands.join_next() => {
                    match hand {
                        Ok(Hand::Looked(read)) => {
                            looking = false;
                            own = read.ok().or(own);
                        }
                        Ok(Hand::Acted(result)) => {
                            acting = false;
                            // Without an answer it may have arrived all the same.
                            if !result.as_ref().is_err_and(AlpacaError::is_unknown_outcome) {
                                self.guard().close_answered(result.is_ok(), clock.machine());
                            }
                            let outcome = match result {
                                Ok(()) => Outcome::Done,
                                Err(error) => {
                                    tracing::warn!(dome = %self.device.name, %error, "the guard's command failed");
                                    Outcome::Failed { detail: error.to_string() }
                                }
                            };
                            self.accounts.note(asked.clone(), &done, outcome);
                        }
                        Ok(Hand::Fed(result)) => self.watchdog.fed(&self.node, &self.device, result),
                        // A hand that panicked must not stay raised.
                        Err(_) => (looking, acting) = (false, false),
                    }
                    false
                }
            };
            let now = clock.machine();
            let seen = [*self.seen.borrow_and_update(), own].into_iter().flatten().max_by_key(|(_, at)| *at);
            let seen_lately = seen.filter(|(_, at)| now.since(*at) <= FRESH);
            let parked = mounts.as_ref().is_none_or(|mounts| mounts.under.all_parked(now));
            let deeds = self.guard().look(now, seen_lately, parked);
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
                done = word(&deed);
                hands.spawn(act(self.alpaca.at_once(), deed, self.connect));
                // After the hand was sent, so that whatever noting takes, closing does not wait for it.
                asked = Asked { from: GUARD.to_owned(), id: CommandId::fresh(), token: None };
                self.accounts.note(asked.clone(), &done, Outcome::Accepted);
            }
            let silent = seen.is_none_or(|(_, at)| now.since(at) > SILENT);
            if beaten && !looking && silent {
                looking = true;
                hands.spawn(read(self.alpaca.at_once(), now));
            }
            // Only a beat of this loop with a living permit feeds it: a thread of its own would feed it for the dead.
            let lives = beaten && self.guard().may_be_open(now) && !self.guard().is_closing();
            if let Some(feed) = self.watchdog.due(lives, now, &self.alpaca) {
                hands.spawn(async move { Hand::Fed(feed.await) });
            }
            if impostor.is_some_and(|at| now.since(at) > GONE) {
                impostor = None;
                self.node.alerts.clear(AlertKind::Impostor, format!("permit/{}", self.device.name));
            }
            // A conclusion that is newly proven, or no longer, is published at once.
            let is_closed = self.guard().is_closed(now);
            if std::mem::replace(&mut was_closed, is_closed) != is_closed {
                next_beat = Instant::now();
            }
            self.closed.send_if_modified(|closed| std::mem::replace(closed, is_closed) != is_closed);
            if beaten && let Some(link) = &self.link {
                let guard = self.guard();
                let report = DomeReport {
                    at_ns: nanos(now),
                    may_be_open_ms: u64::try_from(guard.may_be_open_for(now).as_millis()).unwrap_or(0),
                    sees: seen_lately.is_some(),
                    is_closed,
                    waits_for_mounts: guard.needs_help_with_mounts(now, parked),
                };
                link.say(self.device.name.as_str(), report, guard.tokens());
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
        let (config, telescopes) = (&self.node.config, self.guard().telescopes().to_vec());
        // Its own telescope's mounts are in the same file; those of others are known by their states alone.
        let is_own = telescopes.as_slice() == [config.place.telescope.clone()];
        let own = || config.telescope.iter().map(|mount| config.address().device(Kind::Telescope, &mount.common.name));
        Ok(Mounts { heard, under: MountsUnder::new(telescopes, is_own.then(|| own().collect())) })
    }

    fn raise(&self, alarm: Alarm) {
        let name = &self.device.name;
        let cause = match alarm {
            Alarm::NotClosed => format!("dome {name} should be closed and is not verified closed"),
            Alarm::Uncommanded => format!("dome {name} opened and nobody had commanded it"),
            Alarm::MountNotParked => format!("dome {name} must close and waits for its mount to park"),
            Alarm::Contradicts(what) => format!("dome {name}: {}", what.cause()),
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
        Alarm::Contradicts(_) => AlertKind::DomeContradicts,
    }
}

/// What makes a permit that of an impostor, if anything does.
fn suspicion(taken: Result<Taken, Dropped>) -> Option<&'static str> {
    match taken {
        Ok(Taken::Contested) => Some("permits of one lease and one name contradict each other's numbers"),
        Err(Dropped::NeverGranted) => Some("a permit carries a token that was never granted"),
        Err(Dropped::OtherLife) => Some("a permit carries a lease that was granted to another process"),
        Ok(Taken::Next)
        | Err(
            Dropped::Stranger | Dropped::OtherBoot | Dropped::UnknownNumber | Dropped::Replayed | Dropped::OldToken,
        ) => None,
    }
}

async fn hear_mounts(mounts: &mut Option<Mounts>) {
    let Some(mounts) = mounts else { return std::future::pending().await };
    let heard = mounts.heard.hear().await;
    if let Key::State(device) = heard.key {
        let parked = heard.said.body.fields.at_park.known() == Some(&true);
        // A state that repeats an old reading is as old as that.
        let age_s = heard.said.body.age_s("AtPark").unwrap_or(0.0);
        let read = heard.arrived.minus(Duration::try_from_secs_f64(age_s).unwrap_or(Duration::MAX));
        mounts.under.hear(device, heard.said.boot_id, parked, read);
    }
}

/// The name of a guard action in the audit log.
fn word(deed: &Deed) -> &'static str {
    match deed {
        Deed::AbortThenClose => "abort_then_close_shutter",
        Deed::Close | Deed::Raise(_) | Deed::Clear(_) => "close_shutter",
    }
}

async fn read(alpaca: Alpaca, asked: MachineTime) -> Hand {
    let shutter = alpaca.get("shutterstatus").await.and_then(|answer| shutter_status(&answer));
    Hand::Looked(shutter.map(|shutter| (shutter, asked)))
}

async fn act(alpaca: Alpaca, deed: Deed, connect: bool) -> Hand {
    if deed == Deed::AbortThenClose {
        // Closing follows whether it stopped or not.
        let _ = alpaca.put("abortslew", &[]).await;
    }
    let mut closed = alpaca.put("closeshutter", &[]).await;
    if connect && closed.as_ref().is_err_and(AlpacaError::is_not_connected) {
        // The device was restarted, and its own loop has not come round yet.
        let _ = alpaca.put("connected", &[("Connected", "True")]).await;
        closed = alpaca.put("closeshutter", &[]).await;
    }
    Hand::Acted(closed)
}
