//! Builds what a node's devices need, and starts one task for each.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use alpaca::{Alpaca, http_client};
use anyhow::Context as _;
use audit::Audit;
use config::{CloseWithMount, Device as _, EquatorialChoice};
use contract::device::telescope::Command as MountCommand;
use contract::observatory::AlertKind;
use contract::{Chunk, Device, DeviceKind as _, Kind, Link, Name};
use interlock::guard::Settings;
use interlock::{Calls, Guard, MountWatch, RoofCall};
use node::Node;
use sky::{EarthOrientation, Observer, Place};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinSet;
use units::Angle;

use crate::audit_log::AuditLog;
use crate::command_check::CommandCheck;
use crate::command_server::CommandServer;
use crate::deadline::machine_limit;
use crate::driver::Driver;
use crate::driver::camera::{Camera, frame_properties};
use crate::driver::cover_calibrator::CoverCalibrator;
use crate::driver::dome::Dome;
use crate::driver::filter_wheel::FilterWheel;
use crate::driver::focuser::Focuser;
use crate::driver::observing_conditions::ObservingConditions;
use crate::driver::rotator::Rotator;
use crate::driver::safety_monitor::SafetyMonitor;
use crate::driver::switch::Switch;
use crate::driver::telescope::Telescope;
use crate::guard_process::link::{GuardLink, deadline_of};
use crate::guard_task::GuardTask;
use crate::mount_clock;
use crate::mount_limits::{Alarm, LimitWatch};
use crate::mount_sight::MountSight;
use crate::node_part::NodePart;
use crate::permits;
use crate::serve::Serve;
use crate::spool::Spool;
use crate::token::Tokens;
use crate::watchdog::Feeder;
use crate::{announce, second_writer, shared_dome, spool_http};

type Tasks = JoinSet<anyhow::Result<()>>;

/// What all devices of a node share.
struct SharedParts<'a> {
    node: &'a Node,
    tokens: Arc<Tokens>,
    tasks: &'a mut Tasks,
    http: reqwest::Client,
    audit: &'a Audit,
    index: u32,
    link: Option<&'a GuardLink>,
    /// The tokens that the guard process remembers.
    remembered: BTreeMap<String, u64>,
    enclosures: Vec<Enclosure>,
}

/// What must be closed before the node may end.
pub struct Enclosure {
    /// The dome's name.
    pub name: Name,
    /// Its guard.
    pub guard: Arc<Mutex<Guard>>,
    /// Whether it is verified closed.
    pub closed: watch::Receiver<bool>,
}

/// Starts every device of the node's part; returns the spool where there is a camera, and the enclosures. A node in a guard
/// process has a link to it, and the tokens that it remembers.
pub async fn all(
    node: &Node,
    part: &NodePart<'_>,
    audit: &Audit,
    (link, remembered): (Option<&GuardLink>, BTreeMap<String, u64>),
    tasks: &mut Tasks,
) -> anyhow::Result<(Option<Arc<Spool>>, Vec<Enclosure>)> {
    let data = &node.config.folders.data;
    std::fs::create_dir_all(data).with_context(|| format!("cannot make the folder {}", data.display()))?;
    let tokens =
        Arc::new(Tokens::open(&data.join(format!("tokens-{}-{}.json", node.config.place.telescope, node.id)))?);
    if part.has_enclosure() {
        tokens.adopt_from_siblings(data, node.config.place.telescope.as_str())?;
    }
    let (bus, site) = (node.bus.clone(), node.config.place.site.clone());
    let (followed, stop) = (tokens.clone(), node.stop.clone());
    tasks.spawn(async move {
        stop.or(permits::listen(bus, site, followed)).await.transpose()?;
        Ok(())
    });
    let http = http_client().context("no HTTP client")?;
    let (index, enclosures) = (0, Vec::new());
    let mut shared = SharedParts { node, tokens, tasks, http, audit, index, link, remembered, enclosures };
    let config = &node.config;
    // Enclosures first: what closes must not wait for anything else to start.
    for dome in config.dome.iter().filter(|dome| part.serves(Kind::Dome, &dome.common)) {
        shared.dome(dome)?;
    }
    for monitor in config.safetymonitor.iter().filter(|device| part.serves(Kind::SafetyMonitor, &device.common)) {
        shared.plain(&monitor.common, SafetyMonitor::new(monitor.common.period_s))?;
    }
    for mount in config.telescope.iter().filter(|device| part.serves(Kind::Telescope, &device.common)) {
        shared.telescope(mount)?;
    }
    for station in
        config.observingconditions.iter().filter(|device| part.serves(Kind::ObservingConditions, &device.common))
    {
        shared.plain(&station.common, ObservingConditions)?;
    }
    for wheel in config.filterwheel.iter().filter(|device| part.serves(Kind::FilterWheel, &device.common)) {
        shared.plain(&wheel.common, FilterWheel::default())?;
    }
    for focuser in config.focuser.iter().filter(|device| part.serves(Kind::Focuser, &device.common)) {
        let (settle_s, tolerance_steps) = (focuser.settle_s, focuser.tolerance_steps);
        let driver = Focuser { settle_s, tolerance_steps, ..Focuser::default() };
        shared.plain(&focuser.common, driver)?;
    }
    for cover in config.covercalibrator.iter().filter(|device| part.serves(Kind::CoverCalibrator, &device.common)) {
        shared.plain(&cover.common, CoverCalibrator)?;
    }
    for switch in config.switch.iter().filter(|device| part.serves(Kind::Switch, &device.common)) {
        shared.plain(&switch.common, Switch::new(&switch.limit))?;
    }
    for rotator in config.rotator.iter().filter(|device| part.serves(Kind::Rotator, &device.common)) {
        shared.plain(&rotator.common, Rotator::new(rotator.tolerance_deg))?;
    }
    let spool = shared.cameras(part).await?;
    Ok((spool, shared.enclosures))
}

impl SharedParts<'_> {
    fn device<D: Driver>(&self, common: &config::Common) -> Device {
        self.node.config.address().device(D::Kind::KIND, &common.name)
    }

    fn command_check(&self, guard: Option<Arc<Mutex<Guard>>>, is_arbiter: bool) -> CommandCheck {
        CommandCheck {
            telescope: self.node.config.place.telescope.to_string(),
            tokens: self.tokens.clone(),
            clock: self.node.bus.clock().clone(),
            alerts: self.node.alerts.clone(),
            guard,
            is_arbiter,
            roof: Mutex::default(),
        }
    }

    fn plain<D: Driver>(&mut self, common: &config::Common, driver: D) -> anyhow::Result<()> {
        let authorization = self.command_check(None, false);
        self.serve(common, driver, authorization)?;
        Ok(())
    }

    fn serve<D: Driver>(
        &mut self,
        common: &config::Common,
        driver: D,
        authorization: CommandCheck,
    ) -> anyhow::Result<(Arc<CommandServer<D>>, Alpaca)> {
        let (driver, kind) = (Arc::new(driver), D::Kind::KIND);
        let alpaca = Alpaca::new(self.http.clone(), &common.server, kind, common.number)
            .with_context(|| format!("{kind} \"{}\": no HTTP client", common.name))?;
        let device = self.device::<D>(common);
        let (command_server, orders) =
            CommandServer::new(driver.clone(), authorization, AuditLog::of(&device, self.audit.clone()));
        let command_server = Arc::new(command_server);
        let serve = Serve {
            node: self.node.clone(),
            device: device.clone(),
            common: common.clone(),
            index: self.index,
            driver,
            alpaca: alpaca.clone(),
            command_server: command_server.clone(),
            polled: self.node.header.properties(kind, false),
            fixed: fixed_properties(self.node, kind),
        };
        self.index += 1;
        self.tasks.spawn(serve.run(orders));
        self.tasks.spawn(second_writer::watch(self.node.clone(), device));
        Ok((command_server, alpaca))
    }

    fn dome(&mut self, dome: &config::Dome) -> anyhow::Result<()> {
        let clock = self.node.bus.clock().clone();
        let own = self.node.config.place.telescope.clone();
        let telescopes = if dome.telescopes.is_empty() { vec![own] } else { dome.telescopes.clone() };
        for telescope in telescopes.iter().map(Chunk::as_str) {
            self.tokens.arbitrate(telescope);
            self.tokens.show(telescope, self.remembered.get(telescope).copied().unwrap_or_default());
        }
        let known: BTreeMap<Chunk, u64> =
            telescopes.iter().map(|one| (one.clone(), self.tokens.highest(one.as_str()))).collect();
        let seconds = |s: f64| Duration::from_secs_f64(s.clamp(0.0, 86_400.0));
        let settings = Settings {
            boot_id: self.node.bus.boot_id().clone(),
            telescopes,
            permit_valid: seconds(dome.permit_valid_s),
            policy: dome.close_with_mount,
            parked_within: seconds(dome.parked_within_s),
            travel: machine_limit(&clock, seconds(dome.travel_timeout_s)),
        };
        let holders: Vec<_> =
            known.iter().map(|(one, token)| (one.clone(), *token, self.tokens.holder(one.as_str()))).collect();
        let mut guard = Guard::new(settings, known, clock.machine());
        for (telescope, token, holder) in holders {
            guard.grant(telescope.as_str(), token, holder.as_ref());
        }
        if self.link.is_some()
            && let Some(until) = deadline_of(dome.common.name.as_str())
        {
            guard = guard.with_grace_until(until);
        }
        let guard = Arc::new(Mutex::new(guard));
        let (eye, seen) = watch::channel(None);
        let driver = Dome {
            travel_timeout_s: dome.travel_timeout_s,
            tolerance_deg: dome.slit.arrived_deg(),
            guard: guard.clone(),
            clock,
            eye,
            vendor_commands: dome.vendor_commands.clone(),
            vendor_commands_to_close: dome.vendor_commands_to_close.clone(),
        };
        let authorization = self.command_check(Some(guard.clone()), true);
        let (command_server, alpaca) = self.serve(&dome.common, driver, authorization)?;
        let (node, stop, block) = (self.node.clone(), self.node.stop.clone(), dome.clone());
        self.tasks.spawn(async move {
            stop.or(shared_dome::keep_noticing(node, block, command_server)).await.transpose()?;
            Ok(())
        });
        let device = self.device::<Dome>(&dome.common);
        let (closed, is_closed) = watch::channel(false);
        self.enclosures.push(Enclosure { name: dome.common.name.clone(), guard: guard.clone(), closed: is_closed });
        let task = GuardTask {
            guard,
            link: self.link.cloned(),
            closed,
            node: self.node.clone(),
            audit_log: AuditLog::of(&device, self.audit.clone()),
            device,
            alpaca,
            connect: dome.common.connect,
            seen,
            waits_for_mounts: dome.close_with_mount != CloseWithMount::Alongside,
            feeder: Feeder::of(dome),
        };
        self.tasks.spawn(task.run());
        Ok(())
    }

    fn telescope(&mut self, mount: &config::Telescope) -> anyhow::Result<()> {
        let driver = Telescope::new(mount, self.node.bus.clock().clone());
        let enclosures = self.node.config.enclosures();
        if enclosures.is_empty() {
            self.tokens.arbitrate(self.node.config.place.telescope.as_str());
        }
        let authorization = self.command_check(None, enclosures.is_empty());
        let (command_server, alpaca) = self.serve(mount.common(), driver, authorization)?;
        let (name, server) = (mount.common().name.clone(), mount.common().server.clone());
        self.tasks.spawn(mount_clock::watch(self.node.clone(), name, server, alpaca));
        let park =
            machine_limit(self.node.bus.clock(), Duration::from_secs_f64(mount.slew_timeout_s.clamp(1.0, 86_400.0)));
        let watch = LimitWatch::new(mount.limits.clone(), park);
        let (name, choice) = (mount.common().name.clone(), mount.equatorial_system);
        self.tasks.spawn(watch_limits(self.node.clone(), command_server.clone(), name, choice, watch));
        if !enclosures.is_empty() {
            self.tasks.spawn(watch_mount(self.node.clone(), self.tokens.clone(), command_server, enclosures));
        }
        Ok(())
    }

    async fn cameras(&mut self, part: &NodePart<'_>) -> anyhow::Result<Option<Arc<Spool>>> {
        let node = self.node;
        let cameras: Vec<_> =
            node.config.camera.iter().filter(|camera| part.serves(Kind::Camera, &camera.common)).collect();
        if cameras.is_empty() {
            return Ok(None);
        }
        let asked = node.config.spool.listen;
        let listener = TcpListener::bind(asked).await.with_context(|| {
            format!(
                "spool.listen: the spool cannot listen on {asked}; end the program that has this address, or choose another \
                 port"
            )
        })?;
        let bound = listener.local_addr()?;
        let base = match &node.config.spool.advertise {
            Some(host) if host.contains(':') => format!("http://{host}"),
            Some(host) => format!("http://{host}:{}", bound.port()),
            None => format!("http://{bound}"),
        };
        let folder = format!("spool-{}-{}", node.config.place.telescope, node.id);
        let folder = node.config.folders.data.join(folder);
        let (spool, stored) = Spool::open(&folder, base, (&node.config.place.telescope, &node.config.archive.nodes))?;
        let spool = Arc::new(spool);
        let names = cameras.iter().map(|camera| camera.common.name.clone()).collect();
        self.tasks.spawn(announce::run(node.clone(), spool.clone(), names, stored));
        let (served, stop) = (spool.clone(), node.stop.clone());
        self.tasks.spawn(async move {
            spool_http::serve(listener, served, stop).await;
            Ok(())
        });
        for camera in cameras {
            let fixed = frame_properties(node.header.properties(Kind::Camera, true));
            let clock = node.bus.clock().clone();
            let driver = Camera::new(camera.common.name.clone(), clock, spool.clone(), fixed);
            self.plain(&camera.common, driver)?;
        }
        Ok(Some(spool))
    }
}

/// Fixed rows of the FITS-header table, and what its computed rows (APTAREA, APTDIA, FOCALLEN) are made of.
fn fixed_properties(node: &Node, kind: Kind) -> Vec<String> {
    let mut names = node.header.properties(kind, true);
    if kind == Kind::Telescope {
        let optics = ["ApertureArea", "ApertureDiameter", "FocalLength"].map(str::to_owned);
        names.extend(optics.into_iter().filter(|name| !node.header.properties(kind, true).contains(name)));
    }
    names
}

/// Stops a mount that reaches its limits.
async fn watch_limits(
    node: Node,
    command_server: Arc<CommandServer<Telescope>>,
    name: Name,
    choice: EquatorialChoice,
    mut watch: LimitWatch,
) -> anyhow::Result<()> {
    let (clock, site) = (node.bus.clock().clone(), &node.config.place);
    let (latitude, longitude) = (Angle::from_degrees(site.latitude_deg), Angle::from_degrees(site.longitude_deg));
    let place = Place::new(latitude, longitude, site.elevation_m)?;
    loop {
        if node.stop.or(clock.tick(Duration::from_secs(1))).await.is_none() {
            return Ok(());
        }
        let sky = match Observer::new(&place, &EarthOrientation::default(), clock.utc()) {
            Ok(sky) => sky,
            Err(error) => {
                tracing::warn!(%error, "the mount's limits cannot be reckoned");
                continue;
            }
        };
        let (can_park, system) = {
            let status = command_server.status.lock().unwrap_or_else(PoisonError::into_inner);
            let can = status.can.as_ref();
            (can.is_some_and(|can| can.park), choice.of(can.map(|can| can.equatorial_system)))
        };
        let sight = MountSight { system, ..command_server.driver.sight() };
        let looked = watch.look(clock.machine(), &sight, &sky, can_park);
        let why = looked.beyond.as_ref().map(|beyond| beyond.why.clone());
        command_server.driver.set_beyond_limit(looked.beyond);
        for command in looked.commands {
            tracing::warn!(mount = %name, ?command, why, "a limit of the mount is reached");
            command_server.insist(&node.signature(), command);
        }
        match looked.alarm {
            Alarm::Raise(cause) => node.alerts.raise(AlertKind::MountLimit, &name, &format!("mount {name}: {cause}")),
            Alarm::Clear => node.alerts.clear(AlertKind::MountLimit, &name),
            Alarm::Leave => {}
        }
    }
}

/// Stops and parks a mount whose enclosure has no permit, or closes and waits for it.
async fn watch_mount(
    node: Node,
    tokens: Arc<Tokens>,
    command_server: Arc<CommandServer<Telescope>>,
    enclosures: Vec<Device>,
) -> anyhow::Result<()> {
    let clock = node.bus.clock().clone();
    let telescope = node.config.place.telescope.to_string();
    // The state of the roof in the own file is known, also while its guard has never published.
    let own_waits = node.config.dome.iter().any(|dome| dome.close_with_mount != CloseWithMount::Alongside);
    let mut watch = MountWatch::new(clock.machine());
    let mut second = tokio::time::interval(Duration::from_secs(1));
    loop {
        if node.stop.or(second.tick()).await.is_none() {
            return Ok(());
        }
        let now = clock.machine();
        let mut roofs = tokens.leases().roofs(&enclosures, now);
        if own_waits && !roofs.waits {
            (roofs.waits, roofs.closed) = (true, false);
        }
        let calls = Calls { permitted: tokens.leases().is_safe(&telescope, now), roofs };
        *command_server.command_check.roof.lock().unwrap_or_else(PoisonError::into_inner) = RoofCall::of(calls);
        let command = {
            let status = command_server.status.lock().unwrap_or_else(PoisonError::into_inner);
            let can_park = status.can.as_ref().is_some_and(|can| can.park);
            watch.look(now, calls, &status.fields, can_park, status.link == Link::Connected)
        };
        if let Some(command) = command {
            let word = if command == MountCommand::Park { "parks" } else { "stops tracking" };
            let why = if calls.permitted { "the roof over it closes" } else { "no permit" };
            tracing::warn!(telescope, why, "the mount {word}");
            command_server.insist(audit::GUARD, command);
        }
    }
}
