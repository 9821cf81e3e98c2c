//! A site of fake devices on a real bus: what a device node publishes and answers, without hardware behind it.

mod keeper;

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bus::{AskError, Bus, Clock, Latest, Publisher, Quality, Service};
use contract::device::camera::{self, Activity, Exposure, Frame, Pixel, Purpose};
use contract::device::dome::{self, Shutter};
use contract::device::{DeviceDescription, safety_monitor, telescope};
use contract::node::NodeState;
use contract::observatory::{Alerts, NightState, SafetyState, ScheduleState};
use contract::{
    Accepted, Address, Command, CommandId, CommandOutcome, Datum, DeviceKind, DeviceState, Key, Kind, LastCommand,
    Link, NodeTopic, Order, OrderKind, Part, Payload, Reply, Role,
};
use node::Node;
use tempfile::TempDir;
use test_support::{LIMIT, PARANAL, RunningNode, block, join, private, private_bus, schedule_line, within};
use tokio::sync::watch;

use keeper::Keeper;

/// One fake device.
pub struct Device<K: DeviceKind> {
    pub key: contract::Device,
    pub state: watch::Sender<DeviceState<K::Fields>>,
    /// Every command with the moment it came.
    pub log: Mutex<Vec<(Instant, K::Command)>>,
}

impl<K: DeviceKind> Device<K> {
    pub fn new(address: &Address, name: &str, fields: K::Fields) -> Arc<Self> {
        let state = DeviceState {
            link: Link::Connected,
            busy: false,
            period_s: 0.2,
            poll_s: None,
            last_command: None,
            fields,
            readings: Default::default(),
        };
        let key = address.device(K::KIND, &name.parse().unwrap());
        Arc::new(Self { key, state: watch::channel(state).0, log: Mutex::default() })
    }

    pub async fn appear(self: &Arc<Self>, bus: &Bus, can: K::Capabilities) {
        let states: Publisher<DeviceState<K::Fields>> =
            bus.publisher_as(&Key::State(self.key.clone()), Quality::State { cache: 10 }).await.unwrap();
        let mut values = self.state.subscribe();
        values.mark_changed();
        tokio::spawn(async move { states.follow(values, Duration::from_millis(200)).await });
        let about: Publisher<DeviceDescription<K::Capabilities>> =
            bus.publisher(&Key::Capabilities(self.key.clone())).await.unwrap();
        let words = String::new();
        let can = DeviceDescription {
            server: words.clone(),
            number: 0,
            device_name: words.clone(),
            driver: words,
            interface_version: 1,
            simulated: true,
            can,
            unread: Default::default(),
        };
        tokio::spawn(async move { about.follow(watch::channel(can).1, Duration::from_secs(1)).await });
    }

    /// Takes a command, begins `start`, and is done after `takes` with `end`.
    fn take(
        self: &Arc<Self>,
        command: Command<K::Command>,
        takes: Duration,
        start: impl FnOnce(&mut K::Fields),
        end: impl FnOnce(&mut K::Fields) + Send + 'static,
    ) -> Reply {
        self.take_until(command, tokio::time::sleep(takes), start, end)
    }

    /// As [`Self::take`], and is done when something has happened.
    fn take_until(
        self: &Arc<Self>,
        command: Command<K::Command>,
        over: impl Future<Output = ()> + Send + 'static,
        start: impl FnOnce(&mut K::Fields),
        end: impl FnOnce(&mut K::Fields) + Send + 'static,
    ) -> Reply {
        let id = command.id.clone();
        self.log.lock().unwrap().push((Instant::now(), command.action));
        self.state.send_modify(|state| {
            state.busy = true;
            start(&mut state.fields);
            state.last_command = Some(LastCommand {
                id: id.clone(),
                from: command.from,
                verb: "verb".to_owned(),
                taken_utc: units::Utc::EPOCH,
                outcome: CommandOutcome::Running,
                answer: None,
            });
        });
        let (device, mine) = (self.clone(), id.clone());
        tokio::spawn(async move {
            over.await;
            device.state.send_if_modified(|state| {
                let Some(last) = state.last_command.as_mut().filter(|last| last.id == mine) else { return false };
                last.outcome = CommandOutcome::Done;
                state.busy = false;
                end(&mut state.fields);
                true
            });
        });
        accept(id, None)
    }
}

/// What a test turns at the camera, so that it need not be quick to see an exposure under way.
pub struct ExposureControl {
    /// So many exposures end; the ones after them go on for ever.
    pub ends: AtomicUsize,
    /// Exposures end at once.
    pub hurries: AtomicBool,
    /// Exposures are this far when they begin, as the camera reports them, percent.
    pub is_done_percent: AtomicUsize,
}

impl ExposureControl {
    /// The exposures after so many go on until more may end.
    pub fn hold_after(&self, exposures: usize) {
        self.ends.store(exposures, Ordering::SeqCst);
    }

    /// Every exposure ends in its time.
    pub fn let_go(&self) {
        self.ends.store(usize::MAX, Ordering::SeqCst);
    }

    async fn over(self: Arc<Self>, takes: Duration, ended: impl Fn() -> usize) {
        let began = Instant::now();
        loop {
            let left = if self.hurries.load(Ordering::SeqCst) {
                Duration::ZERO
            } else {
                takes.saturating_sub(began.elapsed())
            };
            let is_held = ended() >= self.ends.load(Ordering::SeqCst);
            match (is_held, left) {
                (false, Duration::ZERO) => return,
                (true, _) => tokio::time::sleep(Duration::from_millis(5)).await,
                (false, left) => tokio::time::sleep(left.min(Duration::from_millis(20))).await,
            }
        }
    }
}

fn accept(id: CommandId, token: Option<u64>) -> Reply {
    Reply::Accepted(Accepted { id, token, not_written: None })
}

/// The whole site and its observatory node.
pub struct Site {
    pub clock: Clock,
    pub address: Address,
    pub folder: TempDir,
    pub dome: Arc<Device<dome::Dome>>,
    pub mount: Arc<Device<telescope::Telescope>>,
    pub camera: Arc<Device<camera::Camera>>,
    pub monitor: Arc<Device<safety_monitor::SafetyMonitor>>,
    pub purposes: Arc<Mutex<Vec<(CommandId, Purpose)>>>,
    /// The guard holds the dome until somebody sends `resume`.
    pub hold: Arc<AtomicBool>,
    /// The mount does not end its tracking when it is told to.
    pub tracks_on: Arc<AtomicBool>,
    /// Somebody else has the lease.
    pub lease_held: Arc<AtomicBool>,
    /// The newest token that was granted; a greater one is somebody else's.
    pub tokens: Arc<AtomicU64>,
    /// How fast the dome turns, degrees per sky second: at 0 it hangs. None for a roof.
    pub turn_deg_per_s: Arc<Mutex<Option<f64>>>,
    /// When each turn of the dome was over.
    pub turned: Arc<Mutex<Vec<Instant>>>,
    /// How the camera exposes.
    pub shutter_of_camera: Arc<ExposureControl>,
    /// More of the dome's block.
    pub dome_block: &'static str,
    /// More of the configuration.
    pub more: &'static str,
    pub bus: Bus,
    pub alerts: Latest<Alerts>,
    pub night: Latest<NightState>,
    pub schedule: Latest<ScheduleState>,
    pub safety: Latest<SafetyState>,
    _services: Vec<Service>,
}

impl Site {
    /// A site with a roof, whose sky is safe and whose sky time runs `speed` times as fast.
    pub async fn new(speed: f64) -> Self {
        Self::with_dome(speed, None).await
    }

    /// As [`Self::new`], with a dome that turns at so many degrees per sky second and whose slit is in the north.
    pub async fn with_dome(speed: f64, turns: Option<f64>) -> Self {
        let clock = Clock::simulated("2026-11-21T03:00:00Z".parse().unwrap(), speed);
        let address = Address::new("paranal", "callisto").unwrap();
        let bus = private_bus(clock.clone()).await;
        let mut dome_fields = dome::Fields { shutter: Datum::Known(Shutter::Closed), ..Default::default() };
        if turns.is_some() {
            (dome_fields.azimuth_deg, dome_fields.slewing) = (Datum::Known(0.0), Datum::Known(false));
            dome_fields.slaved = Datum::Known(false);
        }
        let turn_deg_per_s = Arc::new(Mutex::new(turns));
        let turned = Arc::<Mutex<Vec<Instant>>>::default();
        let shutter_of_camera = Arc::new(ExposureControl {
            ends: AtomicUsize::new(usize::MAX),
            hurries: AtomicBool::new(false),
            is_done_percent: AtomicUsize::new(0),
        });
        let mount_fields = telescope::Fields {
            tracking: Datum::Known(false),
            slewing: Datum::Known(false),
            at_park: Datum::Known(true),
            ..Default::default()
        };
        let camera_fields = camera::Fields {
            activity: Datum::Known(Activity::Idle),
            ccd_c: Datum::Known(15.0),
            cooler_on: Datum::Known(false),
            ..Default::default()
        };
        let monitor_fields = safety_monitor::Fields { is_safe: Datum::Known(true), gapless_safe_s: 1e6 };
        let dome = Device::new(&address, "dome", dome_fields);
        let mount = Device::new(&address, "mount", mount_fields);
        let camera = Device::new(&address, "cam", camera_fields);
        let monitor = Device::new(&address, "monitor", monitor_fields);
        let (set_azimuth, slave) = (turns.is_some(), turns.is_some());
        dome.appear(&bus, dome::Capabilities { set_shutter: true, set_azimuth, slave, park: false }).await;
        mount.appear(&bus, telescope::Capabilities { park: true, pulse_guide: true, ..Default::default() }).await;
        camera.appear(&bus, camera::Capabilities { width_px: 100, height_px: 100, ..Default::default() }).await;
        monitor.appear(&bus, safety_monitor::Capabilities {}).await;
        let purposes = Arc::default();
        let tracks_on = Arc::<AtomicBool>::default();
        let (hold, lease_held) = (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default());
        let tokens = Arc::<AtomicU64>::default();
        let keeper = Keeper {
            hold: hold.clone(),
            lease_held: lease_held.clone(),
            tokens: tokens.clone(),
            clock: clock.clone(),
            turn_deg_per_s: turn_deg_per_s.clone(),
            turned: turned.clone(),
        };
        let services = vec![
            keeper.serve(&bus, &dome, &address).await,
            serve_mount(&bus, &mount, &tracks_on).await,
            serve_camera(&bus, &camera, &clock, &purposes, &shutter_of_camera).await,
        ];
        let part = |part| Key::Observatory(address.clone(), part);
        Self {
            night: bus.latest(&part(Part::Night)).await.unwrap(),
            alerts: bus.latest(&part(Part::Alerts)).await.unwrap(),
            schedule: bus.latest(&part(Part::Schedule)).await.unwrap(),
            safety: bus.latest(&part(Part::Safety)).await.unwrap(),
            folder: tempfile::tempdir().unwrap(),
            clock,
            address,
            dome,
            mount,
            camera,
            monitor,
            purposes,
            hold,
            tracks_on,
            lease_held,
            tokens,
            turn_deg_per_s,
            turned,
            shutter_of_camera,
            dome_block: "",
            more: "",
            bus,
            _services: services,
        }
    }

    /// Writes the schedule.
    pub fn write_schedule(&self, rows: &[(&str, &str, &str, &str)]) {
        let line = |(action, value, start, end): &(&str, &str, &str, &str)| {
            let [start, end] = [start, end].map(|time| format!("2026-11-21 {time}"));
            schedule_line("cam", action, value, [&start, &end])
        };
        let text: String = rows.iter().map(line).collect();
        std::fs::write(self.folder.path().join("schedule.jsonl"), text).unwrap();
    }

    /// Starts an observatory node.
    pub async fn start(&self) -> RunningNode {
        self.start_as("main", "data").await
    }

    /// Starts one by another name, or with a data folder of its own.
    pub async fn start_as(&self, id: &str, data: &str) -> RunningNode {
        let mut text = PARANAL.to_owned() + "[schedule]\nrobotic = true\n";
        for (kind, name, more) in [
            ("telescope", "mount", ""),
            ("camera", "cam", "temperature_c = -30"),
            ("dome", "dome", self.dome_block),
            ("safetymonitor", "monitor", ""),
        ] {
            text += &block(kind, name, "a:1", more);
        }
        let mut config = config::parse(&(text + self.more), self.folder.path()).unwrap();
        config.bus = private(self.bus.locators().await);
        config.folders.data = self.folder.path().join(data);
        let bus = join(&self.bus).await;
        let node = Node::new(Role::Observatory, id.parse().unwrap(), config, Default::default(), bus);
        RunningNode::live(node, node_observatory::run)
    }

    /// Waits until something is seen to be true.
    pub async fn until(&self, what: &str, most: Duration, mut holds: impl FnMut(&Self) -> bool) {
        if within(most, || holds(self).then_some(())).await.is_none() {
            let night = self.night.get().map(|received| received.sample.body);
            let rows = self.schedule.get().map(|received| received.sample.body);
            let safety = self.safety.get().map(|received| received.sample.body);
            panic!("not {what} within {most:?}\nnight: {night:#?}\nschedule: {rows:#?}\nsafety: {safety:#?}");
        }
    }

    pub fn shutter(&self) -> Option<Shutter> {
        self.dome.state.borrow().fields.shutter.known().copied()
    }

    pub fn is_parked(&self) -> bool {
        self.mount.state.borrow().fields.at_park.known() == Some(&true)
    }

    pub fn set_safe(&self, is_safe: bool) {
        self.monitor.state.send_modify(|state| {
            state.fields.is_safe = Datum::Known(is_safe);
            state.fields.gapless_safe_s = if is_safe { 1e6 } else { 0.0 };
        });
    }

    /// Waits until an observatory node with this id publishes.
    pub async fn until_up(&self, id: &str) {
        let key = Key::Node(self.address.clone(), Role::Observatory, id.parse().unwrap(), NodeTopic::State);
        let state = self.bus.latest::<NodeState>(&key).await.unwrap();
        self.until("up", LIMIT, |_| state.get().is_some()).await;
    }

    /// Whether an exposure is under way.
    pub fn is_exposing(&self) -> bool {
        self.camera.state.borrow().fields.exposure.is_some()
    }

    pub fn exposures(&self) -> usize {
        self.purposes.lock().unwrap().len()
    }

    pub async fn order(&self, kind: OrderKind) -> Reply {
        let order =
            Order { id: CommandId::fresh(), from: "test".to_owned(), reason: "a test".to_owned(), kind, seen: None };
        ask(&self.bus, &self.address, &order).await
    }
}

/// Gives an order as the command line does: again, under the same id, while nobody answers, as a node that has just
/// started may not yet.
pub async fn ask(bus: &Bus, address: &Address, order: &Order) -> Reply {
    let (key, began) = (Key::Order(address.clone()), Instant::now());
    while began.elapsed() < LIMIT {
        match bus.ask(&key, order, Duration::from_secs(20)).await {
            Err(AskError::Unknown { .. }) => tokio::time::sleep(Duration::from_millis(500)).await,
            answered => return answered.unwrap(),
        }
    }
    panic!("nobody answers {key}")
}

async fn serve<C: Payload>(
    bus: &Bus,
    device: &contract::Device,
    answer: impl Fn(Command<C>) -> Reply + Send + Sync + 'static,
) -> Service {
    let key = Key::Command(device.clone());
    let answer = Arc::new(answer);
    let service = bus.serve(&key, move |asked: Result<Command<C>, String>| {
        let answer = answer.clone();
        async move { answer(asked.unwrap()) }
    });
    service.await.unwrap()
}

async fn serve_mount(bus: &Bus, mount: &Arc<Device<telescope::Telescope>>, tracks_on: &Arc<AtomicBool>) -> Service {
    let (at, tracks_on) = (mount.clone(), tracks_on.clone());
    serve(bus, &mount.key, move |command: Command<telescope::Command>| {
        let tracks_on = tracks_on.load(Ordering::Relaxed);
        let action = command.action.clone();
        let slews = matches!(action, telescope::Command::Slew { .. } | telescope::Command::Park);
        at.take(
            command,
            Duration::from_millis(50),
            |fields| fields.slewing = Datum::Known(slews),
            move |fields| match action {
                telescope::Command::Park => {
                    fields.slewing = Datum::Known(false);
                    fields.at_park = Datum::Known(true);
                    fields.tracking = Datum::Known(false);
                }
                telescope::Command::Unpark => fields.at_park = Datum::Known(false),
                telescope::Command::Track { on: false } if tracks_on => {}
                telescope::Command::Track { on } => fields.tracking = Datum::Known(on),
                telescope::Command::Slew { ra_deg, dec_deg } => {
                    fields.slewing = Datum::Known(false);
                    (fields.ra_deg, fields.dec_deg) = (Datum::Known(ra_deg), Datum::Known(dec_deg));
                }
                _ => {}
            },
        )
    })
    .await
}

async fn serve_camera(
    bus: &Bus,
    camera: &Arc<Device<camera::Camera>>,
    clock: &Clock,
    purposes: &Arc<Mutex<Vec<(CommandId, Purpose)>>>,
    control: &Arc<ExposureControl>,
) -> Service {
    let frames = Arc::new(bus.publisher::<Frame>(&Key::Frame(camera.key.clone())).await.unwrap());
    let (at, clock, purposes, control) = (camera.clone(), clock.clone(), purposes.clone(), control.clone());
    serve(bus, &camera.key, move |command: Command<camera::Command>| {
        let id = command.id.clone();
        match command.action.clone() {
            camera::Command::Expose { exposure_s, purpose, .. } => {
                let done_s = exposure_s * control.is_done_percent.load(Ordering::SeqCst) as f64 / 100.0;
                let started_utc = clock.utc().plus_seconds(-done_s);
                let left = clock.machine_duration(Duration::from_secs_f64(exposure_s - done_s));
                let (ended, takes) = (purposes.clone(), left + Duration::from_millis(20));
                let over = control.clone().over(takes, move || ended.lock().unwrap().len());
                let exposure = Exposure { id: id.clone(), started_utc, exposure_s };
                let (purposes, frames) = (purposes.clone(), frames.clone());
                let start = |fields: &mut camera::Fields| fields.exposure = Some(exposure);
                at.take_until(command, over, start, move |fields| {
                    fields.exposure = None;
                    purposes.lock().unwrap().push((id.clone(), (*purpose).clone()));
                    let frame = frame(id, *purpose, started_utc, exposure_s);
                    tokio::spawn(async move { frames.put(frame).await });
                })
            }
            camera::Command::Abort => at.take(command, Duration::ZERO, |fields| fields.exposure = None, |_| {}),
            camera::Command::Cool { set_c } => at.take(
                command,
                Duration::ZERO,
                |_| {},
                move |fields| {
                    fields.set_c = Datum::Known(set_c);
                    fields.ccd_c = Datum::Known(set_c + 0.3);
                    fields.cooler_on = Datum::Known(true);
                },
            ),
            _ => at.take(command, Duration::ZERO, |_| {}, |_| {}),
        }
    })
    .await
}

fn frame(id: CommandId, purpose: Purpose, started_utc: units::Utc, exposure_s: f64) -> Frame {
    Frame {
        id,
        camera: Kind::Camera.word().to_owned(),
        purpose,
        width_px: 1,
        height_px: 1,
        planes: 1,
        pixel: Pixel::U16,
        bin: 1,
        origin_px: [0, 0],
        started_utc,
        exposure_s,
        url: String::new(),
        bytes: 2,
        sha256: String::new(),
        readings: Default::default(),
    }
}
