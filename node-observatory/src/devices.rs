//! The devices of one telescope, as this node receives and commands them.

pub mod camera;
pub mod cover_calibrator;
pub mod dome;
pub mod filter_wheel;
pub mod focuser;
pub mod guards;
pub mod instrument;
pub mod telescope;

use std::time::Duration;

use contract::device::dome::Shutter;
use contract::{Device, DeviceKind, Kind, Name};
use node::Node;
use schedule::horizon_limits::HorizonLimits;
use tokio::sync::watch;
use tokio::task::JoinSet;

use self::camera::Camera;
use self::cover_calibrator::Cover;
use self::dome::Dome;
use self::filter_wheel::FilterWheel;
use self::focuser::Focuser;
use self::instrument::{CommandSender, Instrument};
use self::telescope::Mount;
use crate::action_error::ActionError;
use crate::focus_learned::LearnedFocus;

/// All devices that this telescope moves.
pub struct Devices {
    /// Domes and roofs, own and shared.
    pub domes: Vec<Dome>,
    /// Mounts.
    pub mounts: Vec<Mount>,
    /// Mirror covers.
    pub covers: Vec<Cover>,
    /// Cameras.
    pub cameras: Vec<Camera>,
    /// Filter wheels.
    pub wheels: Vec<FilterWheel>,
    /// Focusers.
    pub focusers: Vec<Focuser>,
    stirred: watch::Receiver<u64>,
    _watchers: JoinSet<()>,
}

/// The devices that work with one camera.
#[derive(Clone, Copy)]
pub struct Chain<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// Its mount.
    pub mount: Option<&'a Mount>,
    /// Its filter wheel.
    pub wheel: Option<&'a FilterWheel>,
    /// Its focuser.
    pub focuser: Option<&'a Focuser>,
}

impl Devices {
    /// Subscribes to all devices of the configuration.
    pub async fn listen(
        node: &Node,
        command_sender: &CommandSender,
        focus: watch::Receiver<LearnedFocus>,
    ) -> anyhow::Result<Self> {
        let config = &node.config;
        let mut devices = Self {
            domes: Vec::new(),
            mounts: Vec::new(),
            covers: Vec::new(),
            cameras: Vec::new(),
            wheels: Vec::new(),
            focusers: Vec::new(),
            stirred: watch::channel(0).1,
            _watchers: JoinSet::new(),
        };
        for device in config.enclosures() {
            let own =
                config.dome.iter().find(|own| device.address == config.address() && own.common.name == device.name);
            devices.domes.push(Dome::listen(command_sender, device, own).await?);
        }
        let own = |kind: Kind, name: &Name| config.address().device(kind, name);
        for block in &config.telescope {
            let horizon_limits = HorizonLimits::of(config, block).unwrap_or_else(|(without, why)| {
                tracing::error!(mount = %block.common.name, why, "the horizon of the site cannot be read; its rows are not held against it");
                without
            });
            let device = own(Kind::Telescope, &block.common.name);
            devices.mounts.push(Mount::listen(command_sender, device, block.clone(), horizon_limits).await?);
        }
        for block in &config.covercalibrator {
            let device = own(Kind::CoverCalibrator, &block.common.name);
            devices.covers.push(Cover { instrument: Instrument::listen(command_sender, device).await? });
        }
        for block in &config.camera {
            devices
                .cameras
                .push(Camera::listen(command_sender, own(Kind::Camera, &block.common.name), block.clone()).await?);
        }
        for block in &config.filterwheel {
            let device = own(Kind::FilterWheel, &block.common.name);
            let instrument = Instrument::listen(command_sender, device).await?;
            devices.wheels.push(FilterWheel { instrument, filters: block.filters.clone() });
        }
        for block in &config.focuser {
            let device = own(Kind::Focuser, &block.common.name);
            devices.focusers.push(Focuser::listen(command_sender, device, block.clone(), focus.clone()).await?);
        }
        devices.watch_what_must_close();
        Ok(devices)
    }

    /// Changes whenever a dome, a mount or a cover publishes something new.
    pub fn stirred(&self) -> watch::Receiver<u64> {
        self.stirred.clone()
    }

    /// Is every dome known to be open?
    pub fn are_domes_open(&self) -> bool {
        self.domes.iter().all(|dome| dome.shutter() == Some(Shutter::Open))
    }

    /// The devices that work with a camera, as the configuration pairs them.
    pub fn chain(&self, camera: &Name) -> Result<Chain<'_>, ActionError> {
        let camera = find(&self.cameras, |camera| &camera.instrument.device, Some(camera))
            .ok_or_else(|| ActionError::Impossible(format!("there is no camera {camera}")))?;
        let config = &camera.config;
        Ok(Chain {
            camera,
            mount: find(&self.mounts, |mount| &mount.instrument.device, config.telescope.as_ref()),
            wheel: find(&self.wheels, |wheel| &wheel.instrument.device, config.filterwheel.as_ref()),
            focuser: find(&self.focusers, |focuser| &focuser.instrument.device, config.focuser.as_ref()),
        })
    }

    /// The cover or panel of a camera.
    pub fn cover_of(&self, camera: &Name) -> Option<&Cover> {
        let camera = find(&self.cameras, |camera| &camera.instrument.device, Some(camera))?;
        find(&self.covers, |cover| &cover.instrument.device, Some(camera.config.covercalibrator.as_ref()?))
    }

    /// The mount that looks out of a dome: of a camera that is paired with both, else the only one.
    pub fn mount_under(&self, dome: &Dome) -> Option<&Mount> {
        let name = &dome.instrument.device.name;
        let mut cameras = self.cameras.iter().filter(|camera| camera.config.dome.as_ref() == Some(name));
        let paired = cameras.find_map(|camera| camera.config.telescope.as_ref());
        match self.mounts.as_slice() {
            [only] => Some(only),
            several => find(several, |mount| &mount.instrument.device, Some(paired?)),
        }
    }

    /// Is what this device (`site/telescope/kind/name`) published last still true? False for one that it does not move.
    pub fn is_heard(&self, device: &str) -> bool {
        fn has<K: DeviceKind>(instrument: &Instrument<K>, device: &str) -> bool {
            instrument.device.to_string() == device && instrument.fresh().is_some()
        }
        self.domes.iter().any(|dome| has(&dome.instrument, device))
            || self.mounts.iter().any(|mount| has(&mount.instrument, device))
            || self.covers.iter().any(|cover| has(&cover.instrument, device))
            || self.cameras.iter().any(|camera| has(&camera.instrument, device))
            || self.wheels.iter().any(|wheel| has(&wheel.instrument, device))
            || self.focusers.iter().any(|focuser| has(&focuser.instrument, device))
    }

    fn watch_what_must_close(&mut self) {
        let (stir, stirred) = watch::channel(0);
        let stir = std::sync::Arc::new(stir);
        self.stirred = stirred;
        let watchers = &mut self._watchers;
        self.domes.iter().for_each(|dome| watch(&dome.instrument, &stir, watchers));
        self.mounts.iter().for_each(|mount| watch(&mount.instrument, &stir, watchers));
        self.covers.iter().for_each(|cover| watch(&cover.instrument, &stir, watchers));
    }
}

fn watch<K: DeviceKind>(
    instrument: &Instrument<K>,
    stir: &std::sync::Arc<watch::Sender<u64>>,
    watchers: &mut JoinSet<()>,
) {
    let (mut states, stir) = (instrument.follow(), stir.clone());
    watchers.spawn(async move {
        loop {
            states.changed().await;
            stir.send_modify(|count| *count = count.wrapping_add(1));
        }
    });
}

fn find<'a, T>(list: &'a [T], device: impl Fn(&T) -> &Device, name: Option<&Name>) -> Option<&'a T> {
    list.iter().find(|item| Some(&device(item).name) == name)
}

/// A state older than this does not show what is true now: 5 s, or 2.5 of its periods where those are longer.
pub fn freshness(period_s: f64) -> Duration {
    units::seconds((2.5 * period_s).clamp(5.0, 60.0))
}
