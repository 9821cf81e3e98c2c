//! The real thing in one process: the simulated observatory, a device node that speaks Alpaca with it, and the
//! observatory node, on a bus of their own.

use std::path::{Path, PathBuf};
use std::time::Duration;

use bus::{Bus, Catch, Clock, Latest, Subscriber};
use contract::device::telescope::PierSide;
use contract::node::NodeState;
use contract::observatory::{
    Correction, GuideCalibration, GuideStage, GuidingState, NightState, PointingPoint, ScheduleState,
};
use contract::{Address, Key, NodeTopic, Part, Role};
use node::Node;
use node_observatory::guiding::calibrated;
use node_observatory::guiding::learned::LearnedGuiding;
use node_observatory::pointing::learned::PointingModels;
use node_observatory::replicated::Replicate as _;
use simulator::Simulator;
use tempfile::TempDir;
use test_support::{RunningNode, block, join, private, private_bus, schedule_line, section, within};
use units::Utc;

use crate::MOST;

/// An hour after nautical dusk on Paranal.
pub const NIGHT: f64 = 1_795_228_200.0;

/// A parameter that no device knows, which marks what was done by hand.
const BY_HAND: &str = "ByHand=True";

/// The skies of these tests run up to 20 times as fast as real time, with images that this very process makes, measures
/// and solves, which takes a quarter of a core: many more at once would show what the machine cannot do, not what Starmesh
/// does.
static SEATS: tokio::sync::Semaphore = tokio::sync::Semaphore::const_new(8);

/// The simulated observatory with its nodes.
pub struct Sim {
    pub simulator: Simulator,
    pub options: simulator::Options,
    pub clock: Clock,
    pub bus: Bus,
    pub folder: TempDir,
    pub schedule: Latest<ScheduleState>,
    pub night: Latest<NightState>,
    pub guiding: Latest<GuidingState>,
    pub corrections: Subscriber<Correction>,
    config: config::Observatory,
    nodes: Vec<RunningNode>,
    _seat: tokio::sync::SemaphorePermit<'static>,
}

/// A small camera behind a long telescope: 1 arcsec per pixel, stars some 3 px wide, a sky without clouds.
pub fn telescope(speed: f64) -> simulator::Options {
    let mut options = simulator::Options { start: Utc::from_seconds(NIGHT), speed, ..Default::default() };
    let camera = &mut options.camera;
    (camera.width, camera.height, camera.pixel_um) = (400, 400, 13.5);
    (camera.focal_length_mm, camera.aperture_mm) = (206_264.8 * 13.5e-3, 600.0);
    (camera.optics_fwhm_arcsec, camera.faint_stars) = (2.0, Some(true));
    options.dome.slit = None;
    options
}

/// A field of 1.5 deg with stars of 2.4 px, all of the shipped catalogue, and a mount that errs by nothing but what a
/// test does to it.
pub fn wide_field(speed: f64) -> simulator::Options {
    let mut options = simulator::Options { start: Utc::from_seconds(NIGHT), speed, ..Default::default() };
    let camera = &mut options.camera;
    (camera.width, camera.height, camera.pixel_um, camera.optics_fwhm_arcsec) = (512, 512, 13.5 * 4.0, 25.0);
    let mount = &mut options.mount;
    (mount.pointing_error_arcmin, mount.periodic_error_arcsec) = (0.0, 0.0);
    (mount.scatter_arcsec, mount.slew_deg_per_s) = (2.0, 20.0);
    options.dome.slit = None;
    options
}

/// What pulses do to the stars of the simulator's camera with the tube east of the pier, by its geometry.
pub fn by_geometry(camera: &simulator::CameraOptions) -> GuideCalibration {
    let (sin, cos) = camera.position_angle.radians().sin_cos();
    let s = camera.pixel_scale().degrees();
    let rate = 0.5 * 15.041_067 / 3600.0;
    let cd_deg_px = [[-s * cos, s * sin], [s * sin, s * cos]];
    calibrated::of_solution(cd_deg_px, [rate; 2], 1, Some(PierSide::East), Utc::from_seconds(NIGHT)).unwrap()
}

/// A pointing model of a camera that everywhere looks this far from where its mount is sent, arcmin to the east and to
/// the north.
pub fn misses([east_arcmin, north_arcmin]: [f64; 2]) -> PointingModels {
    let (mut models, at_utc) = (PointingModels::default(), Utc::from_seconds(NIGHT - 86_400.0));
    for (side, west) in [(PierSide::West, -1.0), (PierSide::East, 1.0)] {
        for n in 0..12 {
            let hour_angle_deg = west * (14.0 + 12.0 * f64::from(n % 4));
            let dec_deg = -60.0 + 25.0 * f64::from(n / 4);
            let point = PointingPoint { at_utc, hour_angle_deg, dec_deg, east_arcmin, north_arcmin };
            models.learn("camera", Some(side), point);
        }
    }
    models
}

impl Sim {
    /// Starts the world; `more` are more blocks of the configuration, with `@simulator` for its address.
    pub async fn new(options: simulator::Options, more: &str) -> Self {
        Self::with(options, more, "", &[]).await
    }

    /// As [`Self::new`], with more lines in the mount's block.
    pub async fn with_mount(options: simulator::Options, more: &str, mount: &str) -> Self {
        Self::with_blocks(options, more, ["", mount], &[]).await
    }

    /// As [`Self::new`], with more of the camera's block, and more of the simulator's devices, by kind and name.
    pub async fn with(
        options: simulator::Options,
        more: &str,
        more_of_camera: &str,
        more_devices: &[(&str, &str)],
    ) -> Self {
        Self::with_blocks(options, more, [more_of_camera, ""], more_devices).await
    }

    async fn with_blocks(
        options: simulator::Options,
        more: &str,
        [more_of_camera, more_of_mount]: [&str; 2],
        more_devices: &[(&str, &str)],
    ) -> Self {
        let seat = SEATS.acquire().await.unwrap();
        let simulator = Simulator::start(options.clone()).await.unwrap();
        let at = simulator.address();
        let clock = Clock::of_simulator(&format!("http://{at}")).await.unwrap();
        let folder = tempfile::tempdir().unwrap();
        let address = Address::new("test", "alpha").unwrap();
        let more = more.replace("@simulator", &at.to_string());
        let mut text = format!("{}[schedule]\nrobotic = true\n{more}\n", section(&address, &options));
        let scale = options.camera.pixel_scale().arcseconds();
        let camera = &format!("telescope = \"mount\"\nscale_arcsec_px = {scale:?}\n{more_of_camera}");
        let mount = &format!("settle_s = 1.0\n{more_of_mount}");
        let more_devices = more_devices.iter().map(|(kind, name)| (*kind, *name, ""));
        let devices: [(&str, &str, &str); 4] = [
            ("telescope", "mount", mount),
            ("camera", "camera", camera),
            ("dome", "dome", "node = \"main\"\n"),
            ("safetymonitor", "monitor", "dwell_min = 0.0\n"),
        ];
        for (kind, name, extra) in devices.into_iter().chain(more_devices) {
            text.push_str(&block(kind, name, at, extra));
        }
        if options.guide_camera.is_some() {
            text.push_str(&block("camera", "guider", at, "number = 1\ntelescope = \"mount\""));
        }
        let mut config = config::parse(&text, folder.path()).unwrap();
        let bus = private_bus(clock.clone()).await;
        config.bus = private(bus.locators().await);
        let part = |part| Key::Observatory(address.clone(), part);
        let corrections = Key::Correction(address.clone()).to_string();
        Self {
            schedule: bus.latest(&part(Part::Schedule)).await.unwrap(),
            night: bus.latest(&part(Part::Night)).await.unwrap(),
            guiding: bus.latest(&part(Part::Guiding)).await.unwrap(),
            corrections: bus.subscribe(&corrections, Catch::All, 10_000).await.unwrap(),
            simulator,
            options,
            clock,
            bus,
            folder,
            config,
            nodes: Vec::new(),
            _seat: seat,
        }
    }

    /// A place this many hours west of the meridian at the start, at this declination, ICRS degrees.
    pub fn place(&self, hour_angle_h: f64, dec_deg: f64) -> (f64, f64) {
        let (latitude, longitude) = (self.options.latitude, self.options.longitude);
        let place = sky::Place::new(latitude, longitude, self.options.elevation_m).unwrap();
        let observer = sky::Observer::new(&place, &Default::default(), self.clock.utc()).unwrap();
        let ra = observer.sidereal_time().degrees() - 15.0 * hour_angle_h;
        (ra.rem_euclid(360.0), dec_deg)
    }

    /// Writes the schedule: rows that may start one second after the other, and all end after so many sky seconds.
    pub fn write_schedule(&self, rows: &[(&str, &str)], length_s: f64) {
        let start = self.clock.utc();
        let line = |(index, (action, value)): (usize, &(&str, &str))| {
            schedule_line("camera", action, value, [&start.plus_seconds(index as f64), &start.plus_seconds(length_s)])
        };
        let text: String = rows.iter().enumerate().map(line).collect();
        std::fs::write(self.folder.path().join("schedule.jsonl"), text).unwrap();
    }

    /// Puts a calibration of a camera on disk, before the nodes start.
    pub fn keep_calibration(&self, camera: &str, calibration: GuideCalibration) {
        let mut learned = LearnedGuiding::default();
        learned.keep_calibration(camera, calibration);
        self.keep(&LearnedGuiding::path(&self.config), &learned);
    }

    /// Writes the learned pointing model to disk, before the nodes start.
    pub fn keep_pointing(&self, models: &PointingModels) {
        self.keep(&PointingModels::path(&self.config), models);
    }

    fn keep(&self, path: &Path, what: &impl serde::Serialize) {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, serde_json::to_vec(what).unwrap()).unwrap();
    }

    /// Writes the sky around a place as a catalogue, `sky.smcat` next to the configuration: real and invented stars.
    pub fn write_catalogue(&self, (ra_deg, dec_deg): (f64, f64)) {
        let (centre, radius) = (sky::Icrs::from_degrees(ra_deg, dec_deg), units::Angle::from_degrees(0.6));
        let sky = simulator::faint::written_out(self.options.seed, centre, radius, 2026.9);
        std::fs::write(self.folder.path().join("sky.smcat"), sky).unwrap();
    }

    /// Starts both nodes.
    pub async fn start(&mut self) {
        self.start_one(Role::Device, "main", self.config.clone()).await;
        self.start_one(Role::Observatory, "main", self.config.clone()).await;
    }

    /// As [`Self::start`], with another configuration of the observatory node than of the device node.
    pub async fn start_with(&mut self, change: impl FnOnce(&mut config::Observatory)) {
        let mut config = self.config.clone();
        change(&mut config);
        self.start_one(Role::Device, "main", self.config.clone()).await;
        self.start_one(Role::Observatory, "main", config).await;
    }

    /// Starts a second observatory node with a data folder of its own, as on another host; returns the folder.
    pub async fn start_standby(&mut self) -> PathBuf {
        let mut config = self.config.clone();
        config.folders.data = self.folder.path().join("second");
        let folder = config.folders.data.clone();
        self.start_one(Role::Observatory, "second", config).await;
        folder
    }

    /// Waits until an observatory node with this id publishes.
    pub async fn until_up(&self, id: &str) {
        let address = Address::new("test", "alpha").unwrap();
        let key = Key::Node(address, Role::Observatory, id.parse().unwrap(), NodeTopic::State);
        let state = self.bus.latest::<NodeState>(&key).await.unwrap();
        self.until("up", MOST, |_| state.get().is_some()).await;
    }

    /// Ends the first observatory node as a power cut would: without a message.
    pub async fn kill_commander(&mut self) {
        let is_it = |it: &RunningNode| it.node.role == Role::Observatory && it.node.id.as_str() == "main";
        self.nodes.remove(self.nodes.iter().position(is_it).unwrap()).kill().await;
    }

    /// Data folder of the first observatory node.
    pub fn data(&self) -> &Path {
        &self.config.folders.data
    }

    /// Does something to a device by hand, without the nodes: an Alpaca `PUT`.
    pub async fn by_hand(&self, device: &str, member: &str, form: &[(&str, String)]) {
        let url = format!("http://{}/api/v1/{device}/0/{member}", self.simulator.address());
        let mut body: Vec<String> = form.iter().map(|(key, value)| format!("{key}={value}")).collect();
        // The log keeps no clients' numbers, so that a hand shows itself otherwise.
        body.push(format!("ClientID=9&{BY_HAND}"));
        let put = reqwest::Client::new().put(url).header("content-type", "application/x-www-form-urlencoded");
        let answer = put.body(body.join("&")).send().await.unwrap().text().await.unwrap();
        assert!(answer.contains("\"ErrorNumber\":0"), "{member}: {answer}");
    }

    /// Somebody synchronises the parked mount wrongly: it looks this far from where it is sent from now on, arcmin to
    /// the east and to the north.
    pub async fn mislead(&self, [east_arcmin, north_arcmin]: [f64; 2]) {
        self.by_hand("telescope", "connected", &[("Connected", "True".to_owned())]).await;
        self.by_hand("telescope", "unpark", &[]).await;
        self.by_hand("telescope", "tracking", &[("Tracking", "True".to_owned())]).await;
        let here = self.simulator.world().looks_at();
        let ra_deg = here.ra.degrees() - east_arcmin / 60.0 / here.dec.cos();
        let dec_deg = here.dec.degrees() - north_arcmin / 60.0;
        let hours = (ra_deg.rem_euclid(360.0) / 15.0).to_string();
        let form = [("RightAscension", hours), ("Declination", dec_deg.to_string())];
        self.by_hand("telescope", "synctocoordinates", &form).await;
        self.by_hand("telescope", "park", &[]).await;
    }

    /// What the nodes have sent the mount since an entry of the simulator's log: members, with the parameters of each.
    pub fn sent_to_mount(&self, since: u64) -> Vec<(String, String)> {
        let puts = self.simulator.world().puts_since(since).into_iter();
        let by_nodes = puts.filter(|put| put.device == simulator::Kind::Telescope && !put.parameters.contains(BY_HAND));
        by_nodes.map(|put| (put.member, put.parameters)).collect()
    }

    /// The newest entry of the simulator's log.
    pub fn last_put(&self) -> u64 {
        self.simulator.world().puts_since(0).last().map_or(0, |put| put.seq)
    }

    /// Whether a field is held, on this many frames at least since guiding began.
    pub fn holds(&self, frames: u32) -> bool {
        let state = self.guiding.get().map(|received| received.sample.body).filter(|state| state.active);
        state.is_some_and(|state| state.stage == Some(GuideStage::Guide) && state.frames.unwrap_or(0) >= frames)
    }

    /// All corrections published until now that were not taken before.
    pub async fn corrections(&self) -> Vec<Correction> {
        let mut all = Vec::new();
        while let Ok(received) = tokio::time::timeout(Duration::from_millis(300), self.corrections.recv()).await {
            all.push(received.sample.body);
        }
        all
    }

    /// The next correction.
    pub async fn next_correction(&self) -> Correction {
        let received = tokio::time::timeout(MOST, self.corrections.recv()).await;
        received.unwrap_or_else(|_| panic!("no correction within {MOST:?}: {:#?}", self.guiding.get())).sample.body
    }

    /// Slews the mount by hand to where its encoders will report this, ICRS degrees.
    pub async fn slew_by_hand(&self, (ra_deg, dec_deg): (f64, f64)) {
        let form = [("RightAscension", (ra_deg / 15.0).to_string()), ("Declination", dec_deg.to_string())];
        self.by_hand("telescope", "slewtocoordinatesasync", &form).await;
    }

    async fn start_one(&mut self, role: Role, id: &str, config: config::Observatory) {
        let node = Node::new(role, id.parse().unwrap(), config, Default::default(), join(&self.bus).await);
        self.nodes.push(match role {
            Role::Device => RunningNode::live(node, node_device::run),
            _ => RunningNode::live(node, node_observatory::run),
        });
    }

    /// Starts the observatory node again.
    pub async fn start_observatory(&mut self) {
        self.start_one(Role::Observatory, "main", self.config.clone()).await;
    }

    /// Waits until something is seen to be true.
    pub async fn until(&self, what: &str, most: Duration, mut holds: impl FnMut(&Self) -> bool) {
        if within(most, || holds(self).then_some(())).await.is_none() {
            let rows = self.schedule.get().map(|received| received.sample.body);
            let night = self.night.get().map(|received| received.sample.body);
            let guiding = self.guiding.get().map(|received| received.sample.body);
            panic!("not {what} within {most:?}\n{night:#?}\n{rows:#?}\n{guiding:#?}");
        }
    }

    /// The summary of a row's end, once it has ended; panics when it did not end well.
    pub fn ended(&self, row: usize) -> Option<String> {
        let state = self.schedule.get()?.sample.body.rows.get(row)?.clone();
        use contract::observatory::RowStatus::{Failed, Finished};
        assert_ne!(state.status, Failed, "row {row} failed: {}", state.detail);
        (state.status == Finished).then_some(state.detail)
    }

    /// Ends the nodes.
    pub async fn stop(self) {
        for node in self.nodes.into_iter().rev() {
            node.stop().await;
        }
        self.simulator.stop().await;
    }
}
