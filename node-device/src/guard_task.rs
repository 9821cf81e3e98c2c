//! Connects the guard to its inputs and to the shutter, in parallel with the dome's own loop and never waiting for it.
//! `interlock::GuardLoop` decides.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use alpaca::{Alpaca, AlpacaError};
use audit::GUARD;
use bus::{Catch, MachineTime, Subscriber};
use contract::audit::AuditOutcome;
use contract::device::dome::Guard as PublishedGuard;
use contract::device::telescope;
use contract::observatory::{AlertKind, Permit};
use contract::{Address, CommandId, Device, DeviceState, Key, Kind, Topic};
use interlock::guard::Alarm;
use interlock::{
    Answer, Guard, GuardEffect, GuardEvent, GuardLoop, MountsUnder, ParkReading, Request, ShutterReading, Watchdog,
};
use node::Node;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep_until};

use crate::audit_log::{AuditLog, CommandOrigin};
use crate::close_request;
use crate::guard_process::link::GuardLink;
use crate::shutter_status::shutter_status;
use crate::watchdog::Feeder;

/// The guard looks at least so often; it looks at once when a permit or a shutter reading comes.
const BEAT: Duration = Duration::from_secs(1);
const LOOK: Duration = Duration::from_millis(250);

/// The shutter as it was read, and when.
pub type Seen = Option<ShutterReading>;

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
    pub audit_log: AuditLog,
    /// What the dome's own loop reads.
    pub seen: watch::Receiver<Seen>,
    /// The guard needs the states of the mounts under the dome, because the shutter waits for their park.
    pub waits_for_mounts: bool,
    /// Feeds the dome's own watchdog.
    pub feeder: Feeder,
    /// The guard process around this node, where there is one.
    pub link: Option<GuardLink>,
    /// Whether the shutter is verified closed.
    pub closed: watch::Sender<bool>,
}

/// What the guard's own calls came to.
enum Hand {
    Looked(Result<ShutterReading, AlpacaError>),
    Acted(Result<(), AlpacaError>),
    Fed(Result<(), AlpacaError>),
}

/// What this task has under way.
struct Hands {
    calls: JoinSet<Hand>,
    next_beat: Instant,
    /// The last request, for the audit log.
    sent: Option<(CommandOrigin, Request)>,
}

impl GuardTask {
    /// Guards until the node is stopped.
    pub async fn run(mut self) -> anyhow::Result<()> {
        let bus = self.node.bus.clone();
        let clock = bus.clock().clone();
        let publisher = bus.publisher::<PublishedGuard>(&Key::Guard(self.device.clone())).await?;
        let keys = Topic::Permit.on_site(&self.device.address.site).named(&self.device.name);
        let permits = bus.subscribe::<Permit>(keys, Catch::Newest, 64).await?;
        let (mounts, under) = self.mounts().await?.unzip();
        let mut state = GuardLoop::new(under, Watchdog::new(self.feeder.limit_s()));

        let mut look = interval(LOOK);
        look.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut hands = Hands { calls: JoinSet::new(), next_beat: Instant::now(), sent: None };
        self.feeder.report(&self.node, &self.device);
        loop {
            let event = tokio::select! {
                () = self.node.stop.wait() => return Ok(()),
                () = sleep_until(hands.next_beat) => {
                    hands.next_beat = Instant::now() + clock.machine().to_tick(BEAT);
                    GuardEvent::Beat
                }
                _ = look.tick() => GuardEvent::Tick,
                received = permits.recv() => match received.key {
                    Key::Permit(Address { telescope, .. }, _) => GuardEvent::Permit { telescope, sample: received.sample },
                    _ => GuardEvent::Tick,
                },
                changed = self.seen.changed() => {
                    if changed.is_err() && self.node.stop.is_stopped() {
                        return Ok(());
                    } else if changed.is_err() {
                        anyhow::bail!("the loop of dome {} has ended", self.device.name);
                    }
                    GuardEvent::Tick
                }
                event = next_mount_state(mounts.as_ref()) => event,
                Some(hand) = hands.calls.join_next() => match hand {
                    Ok(Hand::Looked(read)) => GuardEvent::Looked(read.ok()),
                    Ok(Hand::Acted(result)) => GuardEvent::Answered(self.note_answer(result, &hands)),
                    Ok(Hand::Fed(result)) => {
                        self.feeder.fed(&self.node, &self.device, result);
                        GuardEvent::Tick
                    }
                    // A hand that panicked must not stay raised.
                    Err(_) => GuardEvent::Lost,
                },
            };
            if let Some(reading) = *self.seen.borrow_and_update() {
                state.read(reading);
            }
            let effects = state.step(&mut self.guard(), event, clock.machine());
            for effect in effects {
                if let GuardEffect::Publish(number) = effect {
                    let payload = self.guard().published(number, clock.machine(), permits.malformed());
                    let watchdog_s = Some(self.feeder.limit_s().unwrap_or(0.0));
                    publisher.put(PublishedGuard { watchdog_s, ..payload }).await?;
                } else {
                    self.perform(effect, &mut hands);
                }
            }
        }
    }

    fn guard(&self) -> std::sync::MutexGuard<'_, Guard> {
        self.guard.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn perform(&mut self, effect: GuardEffect, hands: &mut Hands) {
        let (name, alerts) = (&self.device.name, &self.node.alerts);
        match effect {
            GuardEffect::Raise(alarm) => self.raise(alarm),
            GuardEffect::Clear(alarm) => alerts.clear(kind(alarm), name),
            GuardEffect::Send(request) => {
                tracing::warn!(dome = %name, ?request, "the guard acts");
                let (alpaca, connect) = (self.alpaca.at_once(), self.connect);
                hands.calls.spawn(async move { Hand::Acted(close_request::send(&alpaca, request, connect).await) });
                // After the request was sent, so that whatever noting takes, closing does not wait for it.
                let asked = CommandOrigin { from: GUARD.to_owned(), id: CommandId::fresh(), token: None };
                self.audit_log.note(asked.clone(), &request.name(), AuditOutcome::Accepted);
                hands.sent = Some((asked, request));
            }
            GuardEffect::Look { asked } => drop(hands.calls.spawn(read(self.alpaca.at_once(), asked))),
            GuardEffect::Feed => {
                if let Some(feed) = self.feeder.feed(&self.alpaca) {
                    hands.calls.spawn(async move { Hand::Fed(feed.await) });
                }
            }
            GuardEffect::Suspect { why, telescope, commander } => {
                let cause = format!("{why}, for telescope {telescope}; it names itself {commander}");
                alerts.raise(AlertKind::Impostor, format!("permit/{name}"), &cause);
            }
            GuardEffect::Trust => alerts.clear(AlertKind::Impostor, format!("permit/{name}")),
            GuardEffect::Drop(telescope, why) => {
                tracing::debug!(dome = %name, %telescope, ?why, "permit dropped");
            }
            GuardEffect::IsClosed(is_closed) => {
                hands.next_beat = Instant::now();
                self.closed.send_replace(is_closed);
            }
            GuardEffect::Report(report) => {
                if let Some(link) = &self.link {
                    link.publish(name.as_str(), report, self.guard().tokens());
                }
            }
            // It waits, and so the loop does it.
            GuardEffect::Publish(_) => {}
        }
    }

    fn note_answer(&self, result: Result<(), AlpacaError>, hands: &Hands) -> Answer {
        let answer = close_request::answer_of(&result);
        let outcome = match result {
            Ok(()) => AuditOutcome::Done,
            Err(error) => {
                tracing::warn!(dome = %self.device.name, %error, "the guard's command failed");
                AuditOutcome::Failed { detail: error.to_string() }
            }
        };
        if let Some((asked, request)) = &hands.sent {
            self.audit_log.note(asked.clone(), &request.name(), outcome);
        }
        answer
    }

    /// The states of the mounts under the dome, where its shutter waits for their park.
    async fn mounts(&self) -> anyhow::Result<Option<(Mounts, MountsUnder)>> {
        if !self.waits_for_mounts {
            return Ok(None);
        }
        let keys = Topic::State.on_site(&self.device.address.site).of_kind(Kind::Telescope);
        let received = self.node.bus.subscribe(keys, Catch::Newest, 64).await?;
        let (config, telescopes) = (&self.node.config, self.guard().telescopes().to_vec());
        // Its own telescope's mounts are in the same file; those of others are known by their states alone.
        let is_own = telescopes.as_slice() == [config.place.telescope.clone()];
        let own = || config.telescope.iter().map(|mount| config.address().device(Kind::Telescope, &mount.common.name));
        Ok(Some((received, MountsUnder::new(telescopes, is_own.then(|| own().collect())))))
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

type Mounts = Subscriber<DeviceState<telescope::Fields>>;

async fn next_mount_state(mounts: Option<&Mounts>) -> GuardEvent {
    let Some(mounts) = mounts else { return std::future::pending().await };
    let received = mounts.recv().await;
    let Key::State(device) = received.key else { return GuardEvent::Tick };
    let state = &received.sample.body;
    // A state that repeats an old reading is as old as that.
    let read = |property: &str| {
        let age_s = state.age_s(property).unwrap_or(0.0);
        received.arrived.minus(Duration::try_from_secs_f64(age_s).unwrap_or(Duration::MAX))
    };
    let reading = ParkReading::of(&state.fields, read);
    GuardEvent::Mount { device, boot_id: received.sample.boot_id.clone(), reading, read: read("AtPark") }
}

async fn read(alpaca: Alpaca, asked: MachineTime) -> Hand {
    let shutter = alpaca.get("shutterstatus").await.and_then(|answer| shutter_status(&answer));
    Hand::Looked(shutter.map(|shutter| (shutter, asked)))
}
