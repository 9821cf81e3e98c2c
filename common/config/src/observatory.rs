//! The checked configuration of one telescope, or of a site's shared devices.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;

use contract::{Address, Chunk, Kind, Name};
use serde::Deserialize;

use crate::alerts::Alerting;
use crate::delivery::Delivery;
use crate::device::{
    Camera, Common, CoverCalibrator, Device, Dome, FilterWheel, Focuser, ObservingConditions, Rotator, SafetyMonitor,
    Switch, Telescope,
};
use crate::faults::Faults;
use crate::focusing::Focusing;
use crate::guiding::Guiding;
use crate::hooks::Hooks;
use crate::imaging::Imaging;
use crate::names::Names;
use crate::network_archive::NetworkArchive;
use crate::pointing::Pointing;
use crate::visibility::ScheduleCheck;
use crate::web::Web;

/// One `observatory.toml`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Observatory {
    /// The site's identity and place.
    #[serde(rename = "observatory")]
    pub place: Place,
    /// Where files go.
    #[serde(default)]
    pub folders: Folders,
    /// How the nodes meet.
    #[serde(default = "Bus::of_this_host")]
    pub bus: Bus,
    /// Where sky time comes from.
    #[serde(default)]
    pub clock: ClockSource,
    /// What the verdict rests on in addition to monitors and weather.
    #[serde(default)]
    pub safety: Safety,
    /// What becomes of the night when a device fails.
    #[serde(default)]
    pub faults: Faults,
    /// How fields are held in their place.
    #[serde(default)]
    pub guiding: Guiding,
    /// What frames are solved with.
    #[serde(default)]
    pub imaging: Imaging,
    /// Where names of targets are looked up.
    #[serde(default)]
    pub names: Names,
    /// How telescopes are brought onto their targets.
    #[serde(default)]
    pub pointing: Pointing,
    /// How the focus is looked after.
    #[serde(default)]
    pub focusing: Focusing,
    /// The site's own script.
    #[serde(default)]
    pub hooks: Hooks,
    /// What is observed.
    #[serde(default)]
    pub schedule: Schedule,
    /// How device nodes serve their frames.
    #[serde(default)]
    pub spool: Spool,
    /// How frames are named and kept.
    #[serde(default)]
    pub archive: Archive,
    /// Where nights are handed over to.
    #[serde(default)]
    pub delivery: Vec<Delivery>,
    /// The receivers of alerts.
    #[serde(default)]
    pub alerts: Alerting,
    /// Where the page is served, and who is let in.
    #[serde(default)]
    pub web: Web,
    /// Shared devices of the site that this telescope relies on.
    #[serde(default)]
    pub shared: Shared,
    /// Mounts.
    #[serde(default)]
    pub telescope: Vec<Telescope>,
    /// Cameras.
    #[serde(default)]
    pub camera: Vec<Camera>,
    /// Filter wheels.
    #[serde(default)]
    pub filterwheel: Vec<FilterWheel>,
    /// Focusers.
    #[serde(default)]
    pub focuser: Vec<Focuser>,
    /// Domes and roofs.
    #[serde(default)]
    pub dome: Vec<Dome>,
    /// Safety monitors.
    #[serde(default)]
    pub safetymonitor: Vec<SafetyMonitor>,
    /// Weather stations.
    #[serde(default)]
    pub observingconditions: Vec<ObservingConditions>,
    /// Covers and flat panels.
    #[serde(default)]
    pub covercalibrator: Vec<CoverCalibrator>,
    /// Switches.
    #[serde(default)]
    pub switch: Vec<Switch>,
    /// Rotators.
    #[serde(default)]
    pub rotator: Vec<Rotator>,
}

impl Observatory {
    /// Where this telescope stands in the key tree.
    pub fn address(&self) -> Address {
        Address { site: self.place.site.clone(), telescope: self.place.telescope.clone() }
    }

    /// What all devices have in common, with their kinds.
    pub fn devices(&self) -> Vec<(Kind, &Common)> {
        fn of<D: Device>(list: &[D]) -> impl Iterator<Item = (Kind, &Common)> {
            list.iter().map(|device| (D::KIND, device.common()))
        }
        of(&self.telescope)
            .chain(of(&self.camera))
            .chain(of(&self.filterwheel))
            .chain(of(&self.focuser))
            .chain(of(&self.dome))
            .chain(of(&self.safetymonitor))
            .chain(of(&self.observingconditions))
            .chain(of(&self.covercalibrator))
            .chain(of(&self.switch))
            .chain(of(&self.rotator))
            .collect()
    }

    /// The bus key part of a device of this file or, for a name listed under `[shared]`, of the site.
    pub fn device(&self, kind: Kind, name: &Name) -> contract::Device {
        let own = self.devices().iter().any(|(k, common)| *k == kind && common.name == *name);
        let address = if own { self.address() } else { self.address().shared() };
        address.device(kind, name)
    }

    /// Safety monitors that this telescope uses: its own and the shared ones.
    pub fn used_safety_monitors(&self) -> Vec<contract::Device> {
        self.used(Kind::SafetyMonitor, self.safetymonitor.iter().map(|d| &d.common.name), &self.shared.safetymonitor)
    }

    /// Weather stations that this telescope uses: its own and the shared ones.
    pub fn used_weather(&self) -> Vec<contract::Device> {
        self.used(
            Kind::ObservingConditions,
            self.observingconditions.iter().map(|d| &d.common.name),
            &self.shared.observingconditions,
        )
    }

    /// Enclosures of this telescope: its own and the shared ones.
    pub fn enclosures(&self) -> Vec<contract::Device> {
        self.used(Kind::Dome, self.dome.iter().map(|d| &d.common.name), &self.shared.dome)
    }

    fn used<'a>(&self, kind: Kind, own: impl Iterator<Item = &'a Name>, shared: &[Name]) -> Vec<contract::Device> {
        let own = own.map(|name| self.address().device(kind, name));
        own.chain(shared.iter().map(|name| self.address().shared().device(kind, name))).collect()
    }
}

/// `[observatory]`: who and where.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Place {
    /// The site's id, first chunk of every key.
    pub site: Chunk,
    /// The telescope's id, second chunk; `shared` for the file of a site's shared devices.
    pub telescope: Chunk,
    /// Geodetic latitude, degrees, north positive.
    pub latitude_deg: f64,
    /// Longitude, degrees, east positive.
    pub longitude_deg: f64,
    /// Height above sea level, metres.
    pub elevation_m: f64,
    /// UT1 - UTC, s; without it directions are off by up to 15 arcsec per second of it.
    #[serde(default)]
    pub dut1_s: f64,
    /// Polar motion x, arcsec.
    #[serde(default)]
    pub polar_x_arcsec: f64,
    /// Polar motion y, arcsec.
    #[serde(default)]
    pub polar_y_arcsec: f64,
}

impl Place {
    /// A name of the telescope that no other telescope of a network has.
    pub fn telescope_in_network(&self) -> String {
        format!("{}-{}", self.site, self.telescope)
    }

    /// A name of one of its cameras that no other camera of a network has.
    pub fn camera_in_network(&self, camera: &str) -> String {
        format!("{}-{}-{camera}", self.site, self.telescope)
    }

    /// The same as the sky is worked out for it: a place on an Earth that turns as it does.
    ///
    /// # Errors
    /// No place on Earth, or an orientation beyond anything the Earth does.
    pub fn on_earth(&self) -> Result<(sky::Place, sky::EarthOrientation), sky::SkyError> {
        let [latitude, longitude] = [self.latitude_deg, self.longitude_deg].map(units::Angle::from_degrees);
        let &Self { dut1_s, polar_x_arcsec, polar_y_arcsec, .. } = self;
        let orientation = sky::EarthOrientation { dut1_s, polar_x_arcsec, polar_y_arcsec };
        Ok((sky::Place::new(latitude, longitude, self.elevation_m)?, orientation.checked()?))
    }
}

/// `[folders]`: where files go; relative paths start at the configuration's own folder.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Folders {
    /// Spool, journal, tokens, learned values.
    pub data: PathBuf,
    /// FITS files.
    pub images: PathBuf,
}

impl Default for Folders {
    fn default() -> Self {
        Self { data: "data".into(), images: "images".into() }
    }
}

/// `[bus]`: how the nodes meet. Where the file has no such table, on this host alone: [`Bus::of_this_host`].
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Bus {
    /// Zenoh endpoints to listen on, such as `tcp/10.0.0.5:7447`; a free port of every interface where empty
    /// and multicast is on, a free loopback port where it is off.
    pub listen: Vec<String>,
    /// Zenoh endpoints of peers to connect to; needed where multicast does not reach.
    pub connect: Vec<String>,
    /// Find peers on the local network by multicast, and be found there by everybody.
    pub multicast: bool,
}

/// `[clock]`: where sky time comes from.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClockSource {
    /// `http://host:port` of a Starmesh simulator whose clock all nodes follow; every device must then be
    /// served by a simulator. Absent: the machine's own clock, at speed 1.
    pub simulator: Option<String>,
}

/// `[schedule]`: what is observed.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Schedule {
    /// JSONL file.
    pub file: PathBuf,
    /// Robotic switch at start.
    pub robotic: bool,
    /// What its rows are held against.
    pub check: ScheduleCheck,
}

impl Default for Schedule {
    fn default() -> Self {
        Self { file: "schedule.jsonl".into(), robotic: false, check: ScheduleCheck::default() }
    }
}

/// `[safety]`: what the verdict rests on in addition to monitors and weather.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Safety {
    /// Unsafe while the Sun is higher than this, degrees; 90 for a dome that may be open by day.
    pub sun_altitude_max_deg: f64,
    /// Unsafe while all values of a weather station have been the same for so long, machine minutes, and reported after
    /// half of it; 0: never.
    pub frozen_after_min: f64,
    /// Nothing is exposed while the clock of an observatory or device node is off by more, s.
    pub clock_offset_max_s: f64,
    /// Nothing is exposed while the data folder of an observatory or device node has less room, GB.
    pub disk_free_min_gb: f64,
    /// Where not to point in a wind; anywhere where absent.
    pub wind_sector: Option<WindSector>,
}

/// `[safety] wind_sector`: no pointing near the direction that a strong wind comes from.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WindSector {
    /// From this wind or gust on, m/s.
    pub above_mps: f64,
    /// So far to both sides of where it comes from, degrees.
    pub half_width_deg: f64,
}

impl Default for Safety {
    fn default() -> Self {
        Self {
            sun_altitude_max_deg: 0.0,
            frozen_after_min: 60.0,
            clock_offset_max_s: 2.0,
            disk_free_min_gb: 1.0,
            wind_sector: None,
        }
    }
}

/// `[spool]`: how device nodes serve the frames that wait for the archive.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Spool {
    /// Address and port (0: a free one); loopback serves an archive on the same host only.
    pub listen: SocketAddr,
    /// Host name or address that others reach this host by; the listening address where absent.
    pub advertise: Option<String>,
    /// Device nodes hold the states of the last so many minutes in memory for archives that are away.
    pub hold_min: f64,
}

impl Default for Spool {
    fn default() -> Self {
        Self { listen: SocketAddr::from(([127, 0, 0, 1], 0)), advertise: None, hold_min: 15.0 }
    }
}

/// Whose files new files look like.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FileProfile {
    /// Names of plain words, in the order of exposure.
    #[default]
    Plain,
    /// As the predecessor names them.
    Astra,
}

/// `[archive]`: how frames are named and kept.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Archive {
    /// SQLite file.
    pub database: PathBuf,
    /// FITS-header table (CSV); the built-in rows where absent.
    pub fits_header: Option<PathBuf>,
    /// How files are named where `filename` does not say.
    pub profile: FileProfile,
    /// File name templates by action type: `object`, `calibration`, `flats`, `autofocus`, `calibrate_guiding`,
    /// `pointing_model`, `default`.
    pub filename: BTreeMap<String, String>,
    /// Days of which every polled value is kept; of older ones each minute's extremes, mean and last value stay.
    pub raw_days: u32,
    /// Folder of the daily copies of the database; `backups` in the folder of the database where absent.
    pub backups: Option<PathBuf>,
    /// Daily copies that are kept; 0 makes none.
    pub backup_count: u32,
    /// Folder or bucket of the network's archive, to which each night is written as Parquet; none is written where absent.
    pub parquet: Option<NetworkArchive>,
    /// Whether new files hold their image in compressed tiles (`.fits.fz`), without loss.
    pub compress: bool,
    /// An alert is raised while the folder of images has less room, GB; 0: never.
    pub disk_warn_gb: f64,
    /// Files leave the folder of images so many days after their night, once every destination has them; never where
    /// absent.
    pub remove_delivered_after_days: Option<u32>,
    /// Ids of the archive nodes that must all have a frame before the camera's spool removes it; where empty, one archive
    /// node is enough, whichever it is.
    pub nodes: Vec<Name>,
}

impl Archive {
    /// The folder of the daily copies.
    pub fn backups(&self) -> PathBuf {
        self.backups.clone().unwrap_or_else(|| self.database.with_file_name("backups"))
    }
}

impl Default for Archive {
    fn default() -> Self {
        Self {
            database: "data/archive.db".into(),
            fits_header: None,
            profile: FileProfile::default(),
            filename: BTreeMap::new(),
            raw_days: 90,
            backups: None,
            backup_count: 7,
            parquet: None,
            compress: false,
            disk_warn_gb: 5.0,
            remove_delivered_after_days: None,
            nodes: Vec::new(),
        }
    }
}

/// `[shared]`: names of the site's shared devices that this telescope relies on.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Shared {
    /// Safety monitors.
    pub safetymonitor: Vec<Name>,
    /// Weather stations.
    pub observingconditions: Vec<Name>,
    /// Enclosures over several telescopes.
    pub dome: Vec<Name>,
    /// Limits that this telescope puts on the shared weather stations.
    pub limit: Vec<crate::Limit>,
    /// Dwell time of the shared safety monitors, minutes.
    #[serde(default = "crate::device::default_dwell_min")]
    pub dwell_min: f64,
    /// Readings of the shared safety monitors that are older than this are unsafe, s; by default five times the period
    /// at which their node asks them, 5 to 60.
    pub max_age_s: Option<f64>,
}
