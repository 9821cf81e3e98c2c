//! World, bus, folder and node processes of one test.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use bus::{Bus, Catch, Clock, Latest};
use contract::archive::Stored;
use contract::device::dome::{Fields as DomeFields, Guard, Shutter};
use contract::device::telescope::Fields as MountFields;
use contract::observatory::{NightState, SafetyState, ScheduleState};
use contract::{Address, DeviceState, Key, Kind, Part, Payload, Role};
use simulator::Simulator;
use tempfile::TempDir;

use crate::lateness::Lateness;
use crate::night::{Rows, configuration, jsonl, long_row};
use crate::private_bus::private_bus;

/// A `Harness` is five processes, which together take some 0.1 of a core; many more at once would measure the machine at
/// their start, not Starmesh.
static SEATS: tokio::sync::Semaphore = tokio::sync::Semaphore::const_new(7);

/// Site of every test.
pub const SITE: &str = "test";
/// Telescope of every test.
pub const TELESCOPE: &str = "alpha";

/// The choices of a test.
pub struct HarnessOptions {
    /// The simulated observatory; it starts in the night, with a small camera.
    pub world: simulator::Options,
    /// Length of every row's window, sky seconds.
    pub window_s: f64,
    /// How long a permit of the dome is valid, machine seconds.
    pub permit_valid_s: f64,
    /// The sky must have been good for so long by the weather station's limit, sky minutes.
    pub weather_dwell_min: f64,
    /// More of the mount's block.
    pub mount_block: &'static str,
    /// More of the focuser's block.
    pub focuser_block: &'static str,
    /// More of the dome's block.
    pub dome_block: &'static str,
    /// More of the configuration, after the devices.
    pub more: String,
}

impl Default for HarnessOptions {
    fn default() -> Self {
        let mut world = simulator::Options {
            // An hour after nautical dusk on Paranal.
            start: units::Utc::from_seconds(1_795_228_200.0),
            speed: 10.0,
            ..Default::default()
        };
        // A night without faults feeds the watchdog; it is short, so that a test notices one that is not fed.
        world.dome.watchdog_s = Some(60.0);
        world.camera.pixel_um *= 8.0;
        (world.camera.width, world.camera.height) = (256, 256);
        Self {
            world,
            window_s: 3600.0,
            permit_valid_s: 5.0,
            weather_dwell_min: 0.5,
            mount_block: "",
            focuser_block: "",
            dome_block: "",
            more: String::new(),
        }
    }
}

/// One test's telescope. Dropping it kills its own processes and nothing else.
pub struct Harness {
    /// The simulated observatory.
    pub simulator: Simulator,
    /// Its options.
    pub world: simulator::Options,
    /// The test's own session on the bus.
    pub bus: Bus,
    folder: TempDir,
    endpoint: String,
    device_nodes: Vec<String>,
    nodes: HashMap<Role, Vec<Child>>,
    standby: Option<Child>,
    _seat: tokio::sync::SemaphorePermit<'static>,
    /// The dome's state.
    pub dome: Latest<DeviceState<DomeFields>>,
    /// The dome's guard.
    pub guard: Latest<Guard>,
    /// The mount's state.
    pub mount: Latest<DeviceState<MountFields>>,
    /// The verdict.
    pub safety: Latest<SafetyState>,
    /// The activity.
    pub night: Latest<NightState>,
    /// The rows.
    pub schedule: Latest<ScheduleState>,
}

impl Harness {
    /// Starts the world and the bus, writes configuration and schedule; no node runs yet.
    pub async fn new(options: HarnessOptions, rows: impl FnOnce(&simulator::Options) -> Rows) -> anyhow::Result<Self> {
        let world = options.world.clone();
        let address = Address::new(SITE, TELESCOPE)?;
        let permit_valid_s = options.permit_valid_s;
        let watchdog = "watchdog_s = 60.0\nwatchdog_action = \"feedwatchdog\"\n";
        let dome = format!("permit_valid_s = {permit_valid_s:?}\n{watchdog}{}", options.dome_block);
        let dwell_min = options.weather_dwell_min;
        let weather = format!("limit = [{{ parameter = \"Humidity\", upper = 99.5, dwell_min = {dwell_min:?} }}]\n");
        let blocks = [options.mount_block, options.focuser_block, &dome, &weather];
        Self::of_files(options.world, |simulator| {
            let text = configuration(&address, simulator.address(), &world, blocks) + &options.more;
            (text, jsonl(&rows(&world), simulator.world().now(), options.window_s))
        })
        .await
    }

    /// Starts the world and the bus, writes the configuration and the schedule that are made for this simulator; no
    /// node runs yet. The devices are called mount and dome, and so on.
    pub async fn of_files(
        world: simulator::Options,
        files: impl FnOnce(&Simulator) -> (String, String),
    ) -> anyhow::Result<Self> {
        let seat = SEATS.acquire().await?;
        let simulator = Simulator::start(world.clone()).await?;
        let folder = tempfile::tempdir()?;
        let (text, rows) = files(&simulator);
        let config = config::parse(&text, folder.path())?;
        let device_nodes = config.device_nodes().into_iter().map(str::to_owned).collect();
        let address = config.address();
        std::fs::write(folder.path().join("observatory.toml"), text)?;
        std::fs::write(folder.path().join("schedule.jsonl"), rows)?;
        let clock = Clock::of_simulator(&format!("http://{}", simulator.address())).await?;
        let bus = private_bus(clock).await;
        let endpoint = bus.locators().await.into_iter().find(|locator| locator.contains("127.0.0.1"));
        let endpoint = endpoint.context("the private bus listens nowhere")?;
        let device =
            |kind, name: &str| -> anyhow::Result<contract::Device> { Ok(address.device(kind, &name.parse()?)) };
        let part = |part| Key::Observatory(address.clone(), part);
        Ok(Self {
            dome: bus.latest(&Key::State(device(Kind::Dome, "dome")?)).await?,
            guard: bus.latest(&Key::Guard(device(Kind::Dome, "dome")?)).await?,
            mount: bus.latest(&Key::State(device(Kind::Telescope, "mount")?)).await?,
            safety: bus.latest(&part(Part::Safety)).await?,
            night: bus.latest(&part(Part::Night)).await?,
            schedule: bus.latest(&part(Part::Schedule)).await?,
            simulator,
            world,
            bus,
            folder,
            endpoint,
            device_nodes,
            nodes: HashMap::new(),
            standby: None,
            _seat: seat,
        })
    }

    /// A night of one long row, which a device node and an observatory node have opened the dome for.
    pub async fn at_open_dome() -> anyhow::Result<Self> {
        Self::at_open_dome_with(HarnessOptions::default()).await
    }

    /// As [`Self::at_open_dome`], with other options.
    pub async fn at_open_dome_with(options: HarnessOptions) -> anyhow::Result<Self> {
        let mut harness = Self::new(options, long_row).await?;
        for role in [Role::Device, Role::Observatory] {
            harness.start(role)?;
        }
        harness.until("the dome opens on a safe sky", 60.0, Self::is_open).await?;
        Ok(harness)
    }

    /// Starts all four nodes.
    pub fn start_all(&mut self) -> anyhow::Result<()> {
        Role::ALL.into_iter().try_for_each(|role| self.start(role))
    }

    /// Starts one node as a process that ends with this one; of device nodes all that the configuration has.
    pub fn start(&mut self, role: Role) -> anyhow::Result<()> {
        let ids = if role == Role::Device { self.device_nodes.clone() } else { vec!["main".to_owned()] };
        for id in ids {
            let child = self.spawn(role, &id)?;
            self.nodes.entry(role).or_default().push(child);
        }
        Ok(())
    }

    /// Starts a second observatory node for the same telescope.
    pub fn start_standby(&mut self) -> anyhow::Result<()> {
        self.start_second(Role::Observatory)
    }

    /// Starts another node of a role, with the name `second`.
    pub fn start_second(&mut self, role: Role) -> anyhow::Result<()> {
        self.standby = Some(self.spawn(role, "second")?);
        Ok(())
    }

    /// Starts one more observatory node of the first one's very name.
    pub fn start_twin(&mut self) -> anyhow::Result<()> {
        self.standby = Some(self.spawn(Role::Observatory, "main")?);
        Ok(())
    }

    /// Starts a second observatory node with a data folder of its own, as on another host; returns the folder. It has
    /// no rights beyond those of the folder's owner, so that what is read-only is read-only.
    pub fn start_standby_apart(&mut self) -> anyhow::Result<PathBuf> {
        let text = std::fs::read_to_string(self.path("observatory.toml"))?;
        std::fs::write(self.path("second.toml"), text + "[folders]\ndata = \"second\"\n")?;
        self.standby = Some(self.spawn_at(Role::Observatory, "second", "second.toml")?);
        Ok(self.path("second"))
    }

    fn spawn(&self, role: Role, id: &str) -> anyhow::Result<Child> {
        self.spawn_at(role, id, "observatory.toml")
    }

    fn spawn_at(&self, role: Role, id: &str, config: &str) -> anyhow::Result<Child> {
        let log = std::fs::OpenOptions::new().create(true).append(true).open(self.path(&format!("{role}.log")))?;
        let mut command = if config == "observatory.toml" { Command::new(binary()?) } else { as_owner(&binary()?)? };
        let child = command
            .args(["node", role.word(), "--id", id, "--with-parent", "--connect", &self.endpoint, "--config"])
            .arg(self.path(config))
            .stdin(Stdio::piped())
            .stdout(log.try_clone()?)
            .stderr(log)
            .spawn()?;
        Ok(child)
    }

    /// Starts `starmesh up` on this test's configuration, for tests of the supervisor; the caller ends it. Commands find it
    /// by the runtime directory `run` of the test's folder.
    pub fn up(&self) -> anyhow::Result<Child> {
        let log = std::fs::File::create(self.path("up.log"))?;
        std::fs::create_dir_all(self.path("run"))?;
        let mut command = Command::new(binary()?);
        command.arg("up").arg(self.path("observatory.toml")).args(["--", "--connect", &self.endpoint]);
        command.env("XDG_RUNTIME_DIR", self.path("run"));
        Ok(command.stdin(Stdio::null()).stdout(log.try_clone()?).stderr(log).spawn()?)
    }

    /// Runs one more node until it ends by itself with an error, and returns its last log lines.
    pub async fn run_to_end(&self, role: Role, id: &str, limit: Duration) -> anyhow::Result<String> {
        let mut child = self.spawn(role, id)?;
        let began = Instant::now();
        let ended = loop {
            match child.try_wait()? {
                None if began.elapsed() < limit => tokio::time::sleep(Duration::from_millis(50)).await,
                ended => break ended,
            }
        };
        if ended.is_none() {
            child.kill()?;
            child.wait()?;
        }
        let log = std::fs::read_to_string(self.path(&format!("{role}.log")))?;
        anyhow::ensure!(ended.is_some_and(|status| !status.success()), "{role} {id} ended with {ended:?}\n{log}");
        Ok(log)
    }

    /// Gives an order with the command line, as a person would; the error contains its output.
    pub async fn order(&self, words: &[&str]) -> anyhow::Result<()> {
        let mut command = tokio::process::Command::new(binary()?);
        command.args(["order", &format!("{SITE}/{TELESCOPE}"), "--no-multicast", "--connect", &self.endpoint]);
        let output = command.args(words).stdin(Stdio::null()).output().await?;
        anyhow::ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        Ok(())
    }

    /// Runs a subcommand of `starmesh` that needs no bus, or finds that of [`Self::up`]; returns what it printed. The error
    /// contains all its output.
    pub async fn starmesh(&self, words: &[&str]) -> anyhow::Result<String> {
        let mut command = tokio::process::Command::new(binary()?);
        command.env("XDG_RUNTIME_DIR", self.path("run")).args(words).stdin(Stdio::null());
        let output = command.output().await?;
        let printed = String::from_utf8_lossy(&output.stdout).into_owned();
        anyhow::ensure!(output.status.success(), "{printed}{}", String::from_utf8_lossy(&output.stderr));
        Ok(printed)
    }

    /// Kills one node, or all device nodes, as a power cut would: at once, without a message.
    pub fn kill(&mut self, role: Role) -> anyhow::Result<()> {
        let mut children = self.nodes.remove(&role).context("this node does not run")?;
        for child in &mut children {
            child.kill()?;
        }
        for child in &mut children {
            child.wait()?;
        }
        Ok(())
    }

    /// Asks one node, or all device nodes, to end, as `systemctl stop` does; returns whether all ended in good order.
    #[cfg(unix)]
    pub async fn ask_to_end(&mut self, role: Role, limit: Duration) -> anyhow::Result<bool> {
        let mut children = self.nodes.remove(&role).context("this node does not run")?;
        children.iter().try_for_each(|child| signal(child, "-TERM"))?;
        let (began, mut well) = (Instant::now(), true);
        for child in &mut children {
            let ended = loop {
                match child.try_wait()? {
                    None if began.elapsed() < limit => tokio::time::sleep(Duration::from_millis(20)).await,
                    ended => break ended,
                }
            };
            well &= ended.is_some_and(|status| status.success());
            // One that is late must not disturb another test.
            let _ = child.kill();
            child.wait()?;
        }
        Ok(well)
    }

    /// Stops one node without ending it: its sessions stay open, its loops do not run.
    #[cfg(unix)]
    pub fn stop_in_its_tracks(&self, role: Role) -> anyhow::Result<()> {
        self.signal(role, "-STOP")
    }

    /// Lets a stopped node go on.
    #[cfg(unix)]
    pub fn go_on(&self, role: Role) -> anyhow::Result<()> {
        self.signal(role, "-CONT")
    }

    #[cfg(unix)]
    fn signal(&self, role: Role, name: &str) -> anyhow::Result<()> {
        self.nodes.get(&role).context("this node does not run")?.iter().try_for_each(|child| signal(child, name))
    }

    /// A file of this test.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// All FITS files that the archive wrote.
    pub fn fits(&self) -> Vec<PathBuf> {
        let mut found = Vec::new();
        let mut folders = vec![self.path("images")];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
                let path = entry.path();
                if path.is_dir() {
                    folders.push(path);
                } else if path.extension().is_some_and(|extension| extension == "fits") {
                    found.push(path);
                }
            }
        }
        found
    }

    /// Subscribes to every frame that the archive stores from now on, and to those of before.
    pub async fn stored(&self) -> anyhow::Result<bus::Subscriber<Stored>> {
        let key = Key::Stored(Address::new(SITE, TELESCOPE)?);
        Ok(self.bus.subscribe(&key.to_string(), Catch::All, 4096).await?)
    }

    /// Waits until a condition holds, at most so long; the error shows the nodes' last log lines.
    pub async fn until(&self, what: &str, limit_s: f64, holds: impl Fn(&Self) -> bool) -> anyhow::Result<Duration> {
        let (began, lateness) = (Instant::now(), Lateness::begin());
        while began.elapsed() < lateness.bound(Duration::from_secs_f64(limit_s)) {
            if holds(self) {
                return Ok(began.elapsed());
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        anyhow::bail!("{what}: not within {limit_s} s\n{}", self.last_words());
    }

    /// The shutter, if its state was published within the last 5 s.
    pub fn shutter(&self) -> Option<Shutter> {
        self.dome.fresh(Duration::from_secs(5))?.sample.body.fields.shutter.known().copied()
    }

    /// Is the dome published as open?
    pub fn is_open(&self) -> bool {
        self.shutter() == Some(Shutter::Open)
    }

    /// Is the dome published as closed, and closed in truth?
    pub fn is_shut(&self) -> bool {
        self.shutter() == Some(Shutter::Closed) && self.simulator.world().dome_open() == 0.0
    }

    /// Is the mount published as parked?
    pub fn is_parked(&self) -> bool {
        body_of(&self.mount).is_some_and(|mount| mount.fields.at_park.known() == Some(&true))
    }

    /// The last log lines of the nodes.
    pub fn last_words(&self) -> String {
        let mut words = String::new();
        for state in
            [debug(&self.dome), debug(&self.guard), debug(&self.safety), debug(&self.night), debug(&self.schedule)]
        {
            words.push_str(&state.chars().take(1500).collect::<String>());
            words.push('\n');
        }
        for role in Role::ALL {
            let log = std::fs::read_to_string(self.path(&format!("{role}.log"))).unwrap_or_default();
            let tail: Vec<&str> = log.lines().rev().take(12).collect();
            words.push_str(&format!("--- {role}\n{}\n", tail.into_iter().rev().collect::<Vec<_>>().join("\n")));
        }
        words
    }
}

/// A command to which a file's permissions apply, also where the tests run as root.
fn as_owner(binary: &Path) -> anyhow::Result<Command> {
    let is_root = cfg!(unix) && Command::new("id").arg("-u").output()?.stdout == b"0\n";
    if !is_root {
        return Ok(Command::new(binary));
    }
    let mut command = Command::new("setpriv");
    command.args(["--bounding-set=-all", "--inh-caps=-all", "--"]).arg(binary);
    Ok(command)
}

#[cfg(unix)]
fn signal(child: &Child, signal: &str) -> anyhow::Result<()> {
    let output = Command::new("kill").args([signal, &child.id().to_string()]).status()?;
    anyhow::ensure!(output.success(), "kill {signal}: {output}");
    Ok(())
}

fn body_of<T: Payload>(latest: &Latest<T>) -> Option<T> {
    latest.get().map(|received| received.sample.body)
}

fn debug<T: Payload + std::fmt::Debug>(latest: &Latest<T>) -> String {
    format!("{}: {:?}", T::NAME, body_of(latest))
}

impl Drop for Harness {
    fn drop(&mut self) {
        for child in self.nodes.values_mut().flatten().chain(&mut self.standby) {
            // It may have ended by itself; the wait reaps it either way.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// The `starmesh` binary next to the test binary.
fn binary() -> anyhow::Result<PathBuf> {
    let test = std::env::current_exe()?;
    let folder = test.parent().and_then(Path::parent).context("a test binary lies in target/PROFILE/deps")?;
    let binary = folder.join(if cfg!(windows) { "starmesh.exe" } else { "starmesh" });
    anyhow::ensure!(binary.exists(), "{} is missing: run `cargo build --workspace` first", binary.display());
    Ok(binary)
}
