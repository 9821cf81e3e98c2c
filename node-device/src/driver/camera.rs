//! The camera; `exposure` takes a frame.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use alpaca::{Abilities, Alpaca, AlpacaError, value};
use bus::Clock;
use contract::device::camera::{self, Activity, Capabilities, Command, Exposure, Fields, Subframe};
use contract::{Accepted, CommandId, Datum, Name, NoData, Reason, Refusal, Reply};
use interlock::Need;

use super::camera_setting::Setting;
use super::{Driver, Executed, Progress, within};
use crate::readings::Readings;
use crate::spool::Spool;

const ACTIVITY: [(i64, Activity); 6] = [
    (0, Activity::Idle),
    (1, Activity::Waiting),
    (2, Activity::Exposing),
    (3, Activity::Reading),
    (4, Activity::Download),
    (5, Activity::Error),
];

/// Less free space than this and nothing is exposed any more: a frame that cannot be kept is a lie.
const LEAST_FREE_BYTES: u64 = 500_000_000;

/// A camera that has taken the command to abort an exposure, and reports another state than idle, is free after so long, sky s.
const ABORTED_S: f64 = 10.0;
/// A cooler that was switched is given so long to report it, sky s.
const COOLER_S: f64 = 3.0;

// Limits that a camera may report of itself. What is beyond cannot be, and would refuse every row.

/// No camera's shortest exposure is longer, and none counts its exposures in longer steps, s.
const LONGEST_MIN_S: f64 = 60.0;
/// No camera's longest exposure is shorter, s; one that reports 0 states none.
const SHORTEST_MAX_S: f64 = 0.001;
const MOST_BIN: i64 = 1024;
/// Pixels of a side of a sensor.
const MOST_PX: i64 = 100_000;
/// 32 bits.
const MOST_ADU: f64 = 4_294_967_295.0;

/// Drives a camera.
pub struct Camera {
    pub(super) name: Name,
    pub(super) clock: Clock,
    pub(super) spool: Arc<Spool>,
    /// Properties that are read for each exposure, by ASCOM name.
    pub(super) fixed: Vec<String>,
    pub(super) memory: Mutex<CameraMemory>,
}

/// What the driver knows between commands.
#[derive(Default)]
pub(super) struct CameraMemory {
    /// What the camera was last set to, and the part of the sensor that it reports to read since; absent where that is
    /// not sure.
    pub setting: Option<(Setting, Subframe)>,
    /// The exposure under way.
    pub exposure: Option<Exposure>,
    /// What it can do.
    pub can: Capabilities,
    /// The camera reports when its last exposure began.
    pub reports_start: bool,
}

impl Camera {
    /// A camera whose frames go to a spool; `fixed` properties are read for each exposure.
    pub fn new(name: Name, clock: Clock, spool: Arc<Spool>, fixed: Vec<String>) -> Self {
        Self { name, clock, spool, fixed, memory: Mutex::default() }
    }

    pub(super) fn memory<T>(&self, use_it: impl FnOnce(&mut CameraMemory) -> T) -> T {
        use_it(&mut self.memory.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Driver for Camera {
    type Kind = camera::Camera;

    fn polled(&self) -> Vec<String> {
        ["CameraState", "CCDTemperature", "SetCCDTemperature", "CoolerOn", "CoolerPower"].map(str::to_owned).to_vec()
    }

    fn moving(&self) -> &'static [&'static str] {
        &["CameraState"]
    }

    fn connected(&self) {
        self.memory(|memory| {
            *memory = CameraMemory { reports_start: true, ..CameraMemory::default() };
        });
    }

    async fn capabilities(&self, abilities: &mut Abilities) -> Result<Capabilities, AlpacaError> {
        let size = async |abilities: &mut Abilities, property: &str, most: i64| -> Result<u32, AlpacaError> {
            let answer = abilities.read(property, value::whole_in(1..=most)).await?;
            Ok(answer.ok().and_then(|size| u32::try_from(size).ok()).unwrap_or(0))
        };
        // Both axes are binned alike, so that the axis with the smaller factor decides.
        let bins = [size(abilities, "MaxBinX", MOST_BIN).await?, size(abilities, "MaxBinY", MOST_BIN).await?];
        let [exposure_min_s, exposure_max_s] = exposure_limits(abilities).await?;
        let step = abilities.read("ExposureResolution", value::number_in(0.0..=LONGEST_MIN_S)).await?;
        let can = Capabilities {
            width_px: size(abilities, "CameraXSize", MOST_PX).await?,
            height_px: size(abilities, "CameraYSize", MOST_PX).await?,
            pixel_width_um: abilities.read("PixelSizeX", value::number).await?.into(),
            pixel_height_um: abilities.read("PixelSizeY", value::number).await?.into(),
            max_bin: bins.into_iter().filter(|bin| *bin > 0).min().unwrap_or(0),
            max_adu: abilities.read("MaxADU", value::number_in(1.0..=MOST_ADU)).await?.into(),
            set_temperature: abilities.can("CanSetCCDTemperature").await?,
            abort: abilities.can("CanAbortExposure").await?,
            electrons_per_adu: abilities.read("ElectronsPerADU", value::number).await?.into(),
            exposure_min_s,
            exposure_max_s,
            // ASCOM: 0 where any length is possible.
            exposure_step_s: step.ok().filter(|step| *step > 0.0),
        };
        self.memory(|memory| memory.can = can.clone());
        Ok(can)
    }

    async fn stirred(&self) {
        self.spool.stirred().await;
    }

    fn fields(&self, readings: &Readings) -> Fields {
        Fields {
            activity: readings.choice("CameraState", &ACTIVITY),
            ccd_c: readings.number("CCDTemperature"),
            set_c: readings.number("SetCCDTemperature"),
            cooler_on: readings.flag("CoolerOn"),
            cooler_percent: readings.number("CoolerPower"),
            exposure: self.memory(|memory| memory.exposure.clone()),
            spooled: self.spool.waiting(&self.name),
            spool_free_bytes: self.spool.free_bytes(),
        }
    }

    fn is_busy(&self, fields: &Fields) -> bool {
        !matches!(fields.activity, Datum::Known(Activity::Idle | Activity::Error)) || fields.exposure.is_some()
    }

    fn works_at(&self, command: &Command, fields: &Fields) -> bool {
        match command {
            Command::Expose { .. } | Command::Abort => self.is_busy(fields),
            Command::Cool { .. } | Command::Warm | Command::Release { .. } => false,
        }
    }

    fn contradiction(&self, command: Option<&Command>, fields: &Fields) -> Option<String> {
        let activity = fields.activity.known().copied()?;
        let no_exposure = match &fields.exposure {
            None => !matches!(command, Some(Command::Abort)) && !matches!(activity, Activity::Idle | Activity::Error),
            Some(exposure) => {
                let left_s = exposure.exposure_s - self.clock.utc().seconds_since(exposure.started_utc);
                left_s > 0.0 && matches!(activity, Activity::Reading | Activity::Download)
            }
        };
        no_exposure.then(|| match fields.exposure {
            None => format!("CameraState stays {activity:?} although no exposure is under way"),
            Some(_) => format!("CameraState stays {activity:?} while the exposure collects light"),
        })
    }

    fn moves(&self, command: &Command) -> bool {
        match command {
            Command::Expose { .. } | Command::Abort | Command::Cool { .. } | Command::Warm => true,
            // The spool forgets a frame.
            Command::Release { .. } => false,
        }
    }

    fn need(&self, command: &Command) -> Need {
        match command {
            Command::Expose { .. } | Command::Cool { .. } | Command::Warm => Need::Token,
            Command::Abort | Command::Release { .. } => Need::Nothing,
        }
    }

    fn interrupts(&self, command: &Command) -> bool {
        *command == Command::Abort
    }

    fn answer(&self, (id, from): (&CommandId, &str), command: &Command) -> Option<Reply> {
        let accepted = || Some(Reply::Accepted(Accepted { id: id.clone(), token: None, not_written: None }));
        match command {
            Command::Release { frame, sha256 } => match self.spool.release(frame, sha256, from) {
                Ok(()) => accepted(),
                Err(detail) => Some(Reply::Refusal(Refusal { id: id.clone(), reason: Reason::Malformed, detail })),
            },
            // The frame of this id was taken before this node restarted.
            Command::Expose { .. } if self.spool.holds(id) => accepted(),
            Command::Expose { .. } | Command::Abort | Command::Cool { .. } | Command::Warm => None,
        }
    }

    fn refuse(&self, id: &CommandId, command: &Command, can: &Capabilities, _: &Fields) -> Option<(Reason, String)> {
        match command {
            Command::Expose { exposure_s, bin, subframe, .. } => {
                if id.0.parse::<Name>().is_err() {
                    return Some((Reason::Malformed, format!("{:?} cannot name a frame", id.0)));
                }
                if *bin < 1 || (can.max_bin > 0 && *bin > can.max_bin) {
                    return Some((Reason::Malformed, format!("bin {bin}: expected 1 to {}", can.max_bin.max(1))));
                }
                if let Some(free) = self.spool.free_bytes().known().filter(|free| **free < LEAST_FREE_BYTES) {
                    let detail = format!("the spool's disk has {} MB left: expected 500", free / 1_000_000);
                    return Some((Reason::NotNow, detail));
                }
                let too_large = subframe.filter(|part| !fits(part, can, *bin));
                let bad_part = too_large.map(|part| (Reason::Malformed, leaves(&part)));
                let too_long = || can.exposure_s(*exposure_s).err().map(|why| (Reason::Malformed, why));
                within("exposure_s", *exposure_s, 0.0, 86_400.0).or_else(too_long).or(bad_part)
            }
            Command::Cool { .. } | Command::Warm if !can.set_temperature => {
                Some((Reason::NotImplemented, "this camera has no cooler with a set point".to_owned()))
            }
            Command::Cool { set_c } => within("set_c", *set_c, -200.0, 60.0),
            Command::Abort | Command::Warm | Command::Release { .. } => None,
        }
    }

    async fn execute(
        &self,
        alpaca: &Alpaca,
        id: &CommandId,
        command: &Command,
        fields: &Fields,
    ) -> Result<Executed, AlpacaError> {
        match command {
            Command::Expose { exposure_s, light, bin, subframe, purpose } => {
                let can = self.memory(|memory| memory.can.clone());
                let setting = Setting::new((can.width_px, can.height_px), *bin, *subframe);
                // Beyond its limits it was refused before, or these were not known then: the camera decides.
                let exposure_s = can.exposure_s(*exposure_s).unwrap_or(*exposure_s);
                self.expose(alpaca, id, exposure_s, *light, setting, purpose).await?;
                Ok(Executed::Done)
            }
            Command::Abort => {
                match alpaca.put("abortexposure", &[]).await {
                    Err(error) if error.is_not_implemented() => alpaca.put("stopexposure", &[]).await?,
                    other => other?,
                }
                Ok(Executed::Watch)
            }
            Command::Cool { set_c } => {
                alpaca.put("setccdtemperature", &[("SetCCDTemperature", &set_c.to_string())]).await?;
                match alpaca.put("cooleron", &[("CoolerOn", "True")]).await {
                    // There are coolers that run by their set point alone: the sensor's temperature shows it.
                    Err(error) if error.is_not_implemented() => {}
                    Err(error) if error.is_ascom() && fields.cooler_on.known().is_none() => {
                        tracing::warn!(camera = %self.name, %error, "the set point is given; CoolerOn is refused, and cannot be read");
                    }
                    switched => switched?,
                }
                Ok(Executed::Watch)
            }
            Command::Warm => {
                alpaca.put("cooleron", &[("CoolerOn", "False")]).await?;
                Ok(Executed::Watch)
            }
            Command::Release { .. } => Ok(Executed::Done),
        }
    }

    fn limit(&self, _: &Command) -> Duration {
        Duration::from_secs(60)
    }

    fn progress(&self, command: &Command, fields: &Fields) -> Progress {
        match command {
            // The exposure was thrown away with the command before; a camera that goes on to report another state is
            // given a moment.
            Command::Abort => match fields.activity.known() {
                Some(Activity::Idle | Activity::Error) => Progress::Done,
                Some(Activity::Waiting | Activity::Exposing | Activity::Reading | Activity::Download) | None => {
                    Progress::Settling(ABORTED_S)
                }
            },
            // The set point was given. What the camera says of its cooler may be wrong; the sensor's temperature is not.
            Command::Cool { .. } if fields.cooler_on.known() == Some(&true) => Progress::Done,
            Command::Cool { .. } => Progress::Settling(COOLER_S),
            Command::Warm => match fields.cooler_on.known() {
                Some(false) => Progress::Done,
                Some(true) => Progress::Running,
                None => Progress::Settling(COOLER_S),
            },
            Command::Expose { .. } | Command::Release { .. } => Progress::Done,
        }
    }
}

/// The shortest and the longest exposure, s, as far as they are known.
async fn exposure_limits(abilities: &mut Abilities) -> Result<[Option<f64>; 2], AlpacaError> {
    let least = abilities.read("ExposureMin", value::number_in(0.0..=LONGEST_MIN_S)).await?.ok();
    let most = abilities.read("ExposureMax", value::number_in(0.0..=f64::MAX)).await?.ok();
    let most = most.filter(|most| *most >= SHORTEST_MAX_S);
    let Some((least_s, most_s)) = least.zip(most).filter(|(least, most)| least > most) else {
        return Ok([least, most]);
    };
    let why = NoData::new("wrong type", format!("ExposureMin is {least_s} s, and ExposureMax only {most_s} s"));
    for property in ["ExposureMin", "ExposureMax"] {
        abilities.doubt(property, &why);
    }
    Ok([None, None])
}

fn fits(part: &Subframe, can: &Capabilities, bin: u32) -> bool {
    let along = |first: u32, count: u32, sensor: u32| {
        count >= 1 && first.checked_add(count).is_some_and(|end| sensor == 0 || end <= sensor / bin)
    };
    along(part.x_px, part.width_px, can.width_px) && along(part.y_px, part.height_px, can.height_px)
}

/// ASCOM names of the readings that travel with a frame, without repeats.
pub fn frame_properties(header_rows: Vec<String>) -> Vec<String> {
    let mut names: BTreeMap<String, ()> = header_rows.into_iter().map(|name| (name, ())).collect();
    // Without the first two nobody knows the noise of the photons, and which pixels are saturated; the next three are for colours.
    let wanted = ["ElectronsPerADU", "MaxADU", "SensorType", "BayerOffsetX", "BayerOffsetY"];
    for name in wanted.into_iter().chain(["BinX", "BinY", "StartX", "StartY"]) {
        names.insert(name.to_owned(), ());
    }
    names.into_keys().collect()
}

/// A part of the sensor that is not on it.
fn leaves(part: &Subframe) -> String {
    let Subframe { x_px, y_px, width_px, height_px } = part;
    format!("the part of {width_px} x {height_px} px from column {x_px}, row {y_px} on leaves the sensor")
}
