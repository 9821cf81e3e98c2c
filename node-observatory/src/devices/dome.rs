//! A dome or roof: opening it with the guard's consent, and knowing whether it is closed.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use bus::{Latest, MachineTime};
use config::{CloseWithMount, Follow};
use contract::device::dome::{self, Command, Guard, Shutter};
use contract::{CommandOutcome, Device, Key, Reason};
use tokio::time::Sleep;
use units::seconds;

use super::guards::Guards;
use super::instrument::{CommandSender, Instrument};
use crate::action_error::ActionError;
use crate::command_timeout::command_timeout;

/// A dome.
pub struct Dome {
    /// The device.
    pub instrument: Instrument<dome::Dome>,
    /// The state of its guard.
    pub guard: Latest<Guard>,
    /// All that publish in the guard's name.
    pub guards: Guards,
    /// How closing waits for the mount.
    pub policy: CloseWithMount,
    /// For the two waiting policies, machine time.
    pub parked_within: Duration,
    /// A shutter that moves longer is stuck, sky time.
    pub travel: Duration,
    /// It serves this telescope alone.
    pub is_own: bool,
    /// The part that turns it.
    pub follow: Follow,
    /// Its slit.
    pub slit: config::Slit,
    /// It is parked when it is closed.
    parks: bool,
    turning_fails: AtomicBool,
    stands_deg: Mutex<Option<f64>>,
    /// This node had it opened, and it was not proven closed since.
    was_opened: AtomicBool,
    /// In the opening that began last, whoever let the guard close had the time to ask this node, too.
    was_asked: AtomicBool,
    /// How it waits.
    sleep: fn(Duration) -> Sleep,
}

/// The parking of a dome as it is seen now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ParkSight {
    /// At its park position.
    pub parked: Option<bool>,
    /// Its newest command is a park that is being done.
    pub parking: bool,
    /// No sky calls for closing, so that the shutter may wait for the park a little.
    pub may_wait: bool,
}

/// A guard that published nothing for so long is not there.
const GUARD_AGE: Duration = Duration::from_secs(5);
/// An order to close that a guard took while no observatory node answered is given to this one within so long, machine
/// time: no hold is ended before that.
const ASKED_WITHIN: Duration = Duration::from_secs(5);
/// What may pass is looked at again after this time.
const AGAIN: Duration = Duration::from_millis(300);

impl Dome {
    /// Subscribes to a dome; `own` is its block, if it is in this telescope's own file.
    pub async fn listen(
        command_sender: &CommandSender,
        device: Device,
        own: Option<&config::Dome>,
    ) -> anyhow::Result<Self> {
        let guard = command_sender.bus.latest(&Key::Guard(device.clone())).await?;
        let guards = Guards::listen(&command_sender.bus, &device).await?;
        let instrument = Instrument::listen(command_sender, device).await?;
        Ok(Self {
            instrument,
            guard,
            guards,
            policy: own.map_or(CloseWithMount::Alongside, |own| own.close_with_mount),
            parked_within: seconds(own.map_or(120.0, |own| own.parked_within_s)),
            travel: seconds(own.map_or(90.0, |own| own.travel_timeout_s)),
            is_own: own.is_some(),
            // A dome over several telescopes has no slit for one of them.
            follow: own.filter(|own| own.telescopes.len() < 2).map_or(Follow::Off, |own| own.follow),
            slit: own.map(|own| own.slit).unwrap_or_default(),
            parks: own.is_some_and(|own| own.park_at_close),
            turning_fails: AtomicBool::new(false),
            stands_deg: Mutex::new(None),
            was_opened: AtomicBool::new(false),
            was_asked: AtomicBool::new(false),
            sleep: tokio::time::sleep,
        })
    }

    /// How far its parking is, where it is to be parked when it is closed and can be.
    pub fn park(&self, may_wait: bool) -> Option<ParkSight> {
        if !self.parks || self.instrument.can().is_some_and(|can| !can.park) {
            return None;
        }
        let state = self.instrument.fresh();
        let last = state.as_ref().and_then(|state| state.last_command.as_ref());
        Some(ParkSight {
            parked: state.as_ref().and_then(|state| state.fields.at_park.known().copied()),
            parking: last.is_some_and(|last| last.verb == "park" && last.outcome == contract::CommandOutcome::Running),
            may_wait,
        })
    }

    /// Azimuth of the slit, degrees; if the dome does not report it right now, the last one at rest.
    pub fn azimuth_deg(&self) -> Option<f64> {
        let fields = self.instrument.newest()?.sample.body.fields;
        let mut stands = self.stands_deg.lock().unwrap_or_else(PoisonError::into_inner);
        let azimuth_deg = fields.azimuth_deg.known().copied().filter(|deg| deg.is_finite());
        if let Some(deg) = azimuth_deg {
            *stands = (fields.slewing.known() != Some(&true)).then_some(deg);
        }
        azimuth_deg.or(*stands)
    }

    /// Forgets where it was at rest: it is about to turn.
    pub fn forget_azimuth(&self) {
        *self.stands_deg.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// Did its last turn fail?
    pub fn turning_fails(&self) -> bool {
        self.turning_fails.load(Ordering::Relaxed)
    }

    /// Notes whether a turn failed.
    pub fn set_turning_fails(&self, fails: bool) {
        self.turning_fails.store(fails, Ordering::Relaxed);
    }

    /// The shutter as the dome itself reports it now; `None` where that is not known.
    pub fn shutter(&self) -> Option<Shutter> {
        self.instrument.fresh_reading("ShutterStatus").and_then(|state| state.fields.shutter.known().copied())
    }

    /// Is its status closed although that is not proven? Its guard publishes that, which knows what was asked of the
    /// shutter and how it followed; where no guard publishes, one that this node had opened is not closed until a
    /// command has closed it.
    pub fn is_doubted(&self) -> bool {
        let living = self.guards.living(self.instrument.clock().machine());
        let verified: Vec<bool> = living.iter().filter_map(|(_, guard)| guard.verified_closed).collect();
        let is_proven = if verified.is_empty() {
            let last = self.instrument.fresh().and_then(|state| state.last_command);
            let closed = last.is_some_and(|last| last.verb == "close_shutter" && last.outcome == CommandOutcome::Done);
            !self.was_opened.load(Ordering::Relaxed) || closed
        } else {
            verified.iter().all(|closed| *closed)
        };
        if is_proven && self.shutter() == Some(Shutter::Closed) {
            self.was_opened.store(false, Ordering::Relaxed);
        }
        !is_proven
    }

    /// Opens the shutter and waits until it is open; ends a hold of the guard first. Nothing is sent before `may` gives
    /// true, which is asked before each try; its error ends the opening.
    ///
    /// The permit that says "safe" may be a second behind the verdict, and a closing that has begun goes to its end first:
    /// such refusals are asked again.
    pub async fn open(&self, may: impl Fn() -> Result<bool, ActionError>) -> Result<(), ActionError> {
        let clock = self.instrument.clock();
        let most = command_timeout(clock, self.travel) + Duration::from_secs(15);
        let mut refusals = Refusals::default();
        let id = loop {
            // One that refuses may be open and about to close.
            if !refusals.had_any && self.shutter() == Some(Shutter::Open) {
                return Ok(());
            }
            if !may()? || !self.end_hold(&may).await? {
                refusals.pause();
            } else {
                self.was_opened.store(true, Ordering::Relaxed);
                match self.instrument.ask(Command::OpenShutter).await {
                    Err(ActionError::Refused {
                        reason: Reason::NoPermit | Reason::WrongState | Reason::Busy, ..
                    }) if refusals.may_go_on(clock.machine(), most) => {}
                    asked => break asked?,
                }
            }
            tokio::time::sleep(AGAIN).await;
        };
        let open = |received: &bus::Received<contract::DeviceState<dome::Fields>>| {
            let state = &received.sample.body;
            if let Some(last) = state.last_command.as_ref().filter(|last| last.id == id)
                && let contract::CommandOutcome::Failed { reason } = &last.outcome
            {
                let device = self.instrument.device.to_string();
                return Some(Err(ActionError::Failed {
                    device,
                    verb: "open_shutter".to_owned(),
                    reason: reason.clone(),
                }));
            }
            (state.fields.shutter.known() == Some(&Shutter::Open)).then_some(Ok(()))
        };
        self.instrument.until(command_timeout(clock, self.travel), "open", open).await?
    }

    /// Has its guard closed it, and opens it for nobody until the hold is ended?
    fn is_held(&self) -> bool {
        self.guard.fresh(GUARD_AGE).is_some_and(|guard| guard.sample.body.hold)
    }

    /// For the begin of an opening. Where a guard holds it shut, whoever let it close may ask this node, too: waits so long,
    /// and gives true. Nothing is to move before.
    pub async fn until_asked(&self) -> bool {
        let is_held = self.is_held();
        if is_held {
            tracing::info!(
                wait_s = ASKED_WITHIN.as_secs(),
                "opening waits, in case whoever let a guard close asks this node, too"
            );
            (self.sleep)(ASKED_WITHIN).await;
        }
        self.was_asked.store(is_held, Ordering::Relaxed);
        is_held
    }

    /// Ends a hold of the guard, whenever it began; false where something keeps the dome shut by then.
    async fn end_hold(&self, may: impl Fn() -> Result<bool, ActionError>) -> Result<bool, ActionError> {
        if !self.is_held() {
            return Ok(true);
        }
        if !self.was_asked.load(Ordering::Relaxed) {
            self.until_asked().await;
        }
        // What came in this time counts, and what comes while the hold is ended.
        if !may()? {
            return Ok(false);
        }
        tracing::info!(dome = %self.instrument.device.name, "the guard had closed; taking over again");
        self.instrument.ask(Command::Resume).await?;
        self.was_asked.store(false, Ordering::Relaxed);
        may()
    }
}

/// How a shutter has refused to open. Pure: time comes in.
#[derive(Debug, Default)]
struct Refusals {
    had_any: bool,
    since: Option<MachineTime>,
}

impl Refusals {
    /// It refused once more: is it to be asked again? Not where it has refused for longer than `most` without a pause.
    fn may_go_on(&mut self, now: MachineTime, most: Duration) -> bool {
        self.had_any = true;
        now.since(*self.since.get_or_insert(now)) < most
    }

    /// It is not asked for a while, which does not count.
    fn pause(&mut self) {
        self.since = None;
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::sync::Arc;
    use std::sync::atomic::AtomicUsize;

    use bus::Clock;
    use contract::{Accepted, Address, CommandId, DeviceState, Kind, Refusal, Reply};
    use test_support::{LIMIT, dome_state, join, private_bus};
    use tokio::sync::watch;

    use super::*;
    use crate::hold::Hold;

    thread_local! {
        /// How long the dome of the test on this thread had waited for orders.
        static WAITED: Cell<Duration> = const { Cell::new(Duration::ZERO) };
    }

    /// Joins `bus` as the one that commands a dome, which is shut, and whose node serves it already.
    async fn dome_on(bus: &bus::Bus, device: Device, states: &bus::Publisher<DeviceState<dome::Fields>>) -> Dome {
        let command_sender = CommandSender {
            bus: join(bus).await,
            signature: "observatory/alpha/main".to_owned(),
            lease: watch::channel(Hold::Standby).1,
            doubt: Arc::default(),
        };
        let mut dome = Dome::listen(&command_sender, device, None).await.unwrap();
        dome.sleep = |time| {
            WAITED.set(WAITED.get() + time);
            tokio::time::sleep(Duration::ZERO)
        };
        let meet = async {
            states.put(dome_state(Shutter::Closed)).await.unwrap();
            while dome.instrument.ask(Command::Abort).await.is_err() {
                states.put(dome_state(Shutter::Closed)).await.unwrap();
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        tokio::time::timeout(LIMIT, meet).await.unwrap();
        dome
    }

    #[test]
    fn a_time_in_which_it_is_not_asked_is_none_of_refusals() {
        let (at, most) = (|s| MachineTime::from_boot(Duration::from_secs(s)), Duration::from_secs(60));
        let mut refusals = Refusals::default();
        assert!(refusals.may_go_on(at(100), most) && refusals.may_go_on(at(159), most));
        refusals.pause();
        assert!(refusals.had_any, "one that has refused may be open and about to close");
        assert!(refusals.may_go_on(at(1500), most) && refusals.may_go_on(at(1559), most));
        assert!(!refusals.may_go_on(at(1560), most));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn what_comes_before_a_hold_is_ended_leaves_it_to_the_guard_also_where_it_began_late() {
        let bus = private_bus(Clock::machine_clock()).await;
        let device = Address::new("test", "alpha").unwrap().device(Kind::Dome, &"roof".parse().unwrap());
        let states = Arc::new(bus.publisher::<DeviceState<dome::Fields>>(&Key::State(device.clone())).await.unwrap());
        let guards = bus.publisher::<Guard>(&Key::Guard(device.clone())).await.unwrap();
        let sent = Arc::<Mutex<Vec<Command>>>::default();
        let taken = sent.clone();
        let answer = move |command: Result<contract::Command<Command>, String>| {
            let contract::Command { id, action, .. } = command.unwrap();
            taken.lock().unwrap().push(action);
            async move { Reply::Accepted(Accepted { id, token: None, not_written: None }) }
        };
        let _service = bus.serve(&Key::Command(device.clone()), answer).await.unwrap();
        let dome = dome_on(&bus, device, &states).await;
        let mut guard: Guard =
            serde_json::from_str(include_str!("../../../common/contract/golden/v1/dome.guard.json")).unwrap();
        guard.hold = true;
        let looks = AtomicUsize::default();
        let holding = async {
            while looks.load(Ordering::SeqCst) < 2 {
                guards.put(guard.clone()).await.unwrap();
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        // Whoever let the guard close asks this node before the second look.
        let may = || match looks.fetch_add(1, Ordering::SeqCst) {
            0 => Ok(true),
            _ => Err(ActionError::Unanswered { device: "roof".to_owned(), verb: "ordered to close".to_owned() }),
        };
        let opening = async {
            assert!(
                !dome.until_asked().await && WAITED.get().is_zero(),
                "nobody is waited for where no guard holds it"
            );
            while !dome.is_held() {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
            // Each opening waits anew at its begin, also after one that was given up.
            assert!(dome.until_asked().await && dome.until_asked().await && WAITED.take() == 2 * ASKED_WITHIN);
            dome.was_asked.store(false, Ordering::Relaxed);
            states.put(dome_state(Shutter::Closed)).await.unwrap();
            dome.open(may).await
        };
        let (opened, ()) = tokio::time::timeout(LIMIT, async { tokio::join!(opening, holding) }).await.unwrap();
        assert!(opened.is_err());
        assert_eq!(WAITED.get(), ASKED_WITHIN, "once");
        let moves = |command: &Command| matches!(command, Command::Resume | Command::OpenShutter);
        let sent = sent.lock().unwrap();
        assert!(!sent.iter().any(moves), "{sent:?}");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn what_comes_while_a_hold_is_ended_keeps_it_shut() {
        let bus = private_bus(Clock::machine_clock()).await;
        let device = Address::new("test", "alpha").unwrap().device(Kind::Dome, &"roof".parse().unwrap());
        let states = Arc::new(bus.publisher::<DeviceState<dome::Fields>>(&Key::State(device.clone())).await.unwrap());
        let guards = bus.publisher::<Guard>(&Key::Guard(device.clone())).await.unwrap();
        // The first end of a hold takes a moment, in which something begins to keep it shut, until the third look after it.
        let (kept, was_resumed) = (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default());
        let opened_while_kept = Arc::<Mutex<Vec<bool>>>::default();
        let (keeps, resumed, opened) = (kept.clone(), was_resumed.clone(), opened_while_kept.clone());
        let opens = states.clone();
        let answer = move |command: Result<contract::Command<Command>, String>| {
            let (command, opens) = (command.unwrap(), opens.clone());
            if command.action == Command::Resume && !resumed.swap(true, Ordering::SeqCst) {
                keeps.store(true, Ordering::SeqCst);
            }
            let is_opening = command.action == Command::OpenShutter;
            if is_opening {
                opened.lock().unwrap().push(keeps.load(Ordering::SeqCst));
            }
            async move {
                if is_opening {
                    opens.put(dome_state(Shutter::Open)).await.unwrap();
                }
                Reply::Accepted(Accepted { id: command.id, token: None, not_written: None })
            }
        };
        let _service = bus.serve(&Key::Command(device.clone()), answer).await.unwrap();
        let dome = dome_on(&bus, device, &states).await;
        let mut guard: Guard =
            serde_json::from_str(include_str!("../../../common/contract/golden/v1/dome.guard.json")).unwrap();
        guard.hold = true;
        let holding = async {
            while opened_while_kept.lock().unwrap().is_empty() {
                guards.put(guard.clone()).await.unwrap();
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        let looks = AtomicUsize::default();
        let may = || {
            if kept.load(Ordering::SeqCst) && looks.fetch_add(1, Ordering::SeqCst) == 2 {
                kept.store(false, Ordering::SeqCst);
            }
            Ok(!kept.load(Ordering::SeqCst))
        };
        let opening = async {
            while dome.guard.fresh(GUARD_AGE).is_none() {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
            states.put(dome_state(Shutter::Closed)).await.unwrap();
            dome.open(may).await.unwrap();
        };
        tokio::time::timeout(LIMIT, async { tokio::join!(opening, holding) }).await.unwrap();
        assert!(was_resumed.load(Ordering::SeqCst));
        let opened_while_kept = opened_while_kept.lock().unwrap();
        assert!(!opened_while_kept.is_empty() && !opened_while_kept.contains(&true), "{opened_while_kept:?}");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn while_something_keeps_it_shut_nothing_is_sent_also_after_a_refusal() {
        let bus = private_bus(Clock::machine_clock()).await;
        let device = Address::new("test", "alpha").unwrap().device(Kind::Dome, &"roof".parse().unwrap());
        let key = Key::State(device.clone());
        let states = Arc::new(bus.publisher::<DeviceState<dome::Fields>>(&key).await.unwrap());
        // How often was looked before each of the commands to open, of which it refuses the first.
        let (looks, sent) = (Arc::<AtomicUsize>::default(), Arc::<Mutex<Vec<(CommandId, usize)>>>::default());
        let (looked, taken, opens) = (looks.clone(), sent.clone(), states.clone());
        let answer = move |command: Result<contract::Command<Command>, String>| {
            let (command, opens) = (command.unwrap(), opens.clone());
            let (id, is_opening) = (command.id, command.action == Command::OpenShutter);
            let mut taken = taken.lock().unwrap();
            // One whose answer is late comes again.
            if is_opening && taken.iter().all(|(known, _)| *known != id) {
                taken.push((id.clone(), looked.load(Ordering::Relaxed)));
            }
            let is_refused = taken.first().is_some_and(|(first, _)| *first == id);
            drop(taken);
            async move {
                if is_refused {
                    return Reply::Refusal(Refusal { id, reason: Reason::Busy, detail: "it closes".to_owned() });
                }
                if is_opening {
                    opens.put(dome_state(Shutter::Open)).await.unwrap();
                }
                Reply::Accepted(Accepted { id, token: None, not_written: None })
            }
        };
        let _service = bus.serve(&Key::Command(device.clone()), answer).await.unwrap();
        let dome = dome_on(&bus, device, &states).await;
        states.put(dome_state(Shutter::Closed)).await.unwrap();
        // Each second look finds nothing that keeps it shut.
        let may = || Ok(looks.fetch_add(1, Ordering::Relaxed) % 2 == 1);
        tokio::time::timeout(LIMIT, dome.open(may)).await.unwrap().unwrap();
        let looks: Vec<usize> = sent.lock().unwrap().iter().map(|(_, looks)| *looks).collect();
        assert_eq!(looks, [2, 4]);
    }
}
