//! A camera: exposures in sky time, a cooler with inertia, binning and sub-frames.

use std::sync::Arc;

use serde_json::json;
use units::Utc;

use crate::answer::{Answer, DONE, Refusal, within};
use crate::exposure::{Exposure, Plan, Sample};
use crate::frame::Frame;
use crate::kind::Kind;
use crate::options::{CameraOptions, FocusOptions, Options};
use crate::request::Request;
use crate::scene::Scene;
use crate::transit::Transit;
use crate::weather::Quantity;

/// Properties that are read without parameters, in ASCOM's case.
pub const PROPERTIES: &[&str] = &[
    "BinX",
    "BinY",
    "CameraState",
    "CameraXSize",
    "CameraYSize",
    "CanAbortExposure",
    "CanAsymmetricBin",
    "CanFastReadout",
    "CanGetCoolerPower",
    "CanPulseGuide",
    "CanSetCCDTemperature",
    "CanStopExposure",
    "CCDTemperature",
    "CoolerOn",
    "CoolerPower",
    "ElectronsPerADU",
    "ExposureMax",
    "ExposureMin",
    "ExposureResolution",
    "FullWellCapacity",
    "Gain",
    "GainMax",
    "GainMin",
    "HasShutter",
    "HeatSinkTemperature",
    "ImageReady",
    "IsPulseGuiding",
    "MaxADU",
    "MaxBinX",
    "MaxBinY",
    "NumX",
    "NumY",
    "Offset",
    "OffsetMax",
    "OffsetMin",
    "PercentCompleted",
    "PixelSizeX",
    "PixelSizeY",
    "ReadoutMode",
    "ReadoutModes",
    "SensorName",
    "SensorType",
    "SetCCDTemperature",
    "StartX",
    "StartY",
];

/// The properties in `DeviceState`.
pub const STATE: &[&str] = &[
    "CameraState",
    "CCDTemperature",
    "CoolerPower",
    "HeatSinkTemperature",
    "ImageReady",
    "IsPulseGuiding",
    "PercentCompleted",
];

const MAX_BIN: u32 = 4;
const EXPOSURE_MAX_S: f64 = 3600.0;
const GAIN_MAX: i32 = 300;
const OFFSET_MAX: i32 = 2000;
/// The cooler changes the temperature no faster than this, K per second.
const COOLER_K_PER_S: f64 = 0.4;

/// A camera.
#[derive(Debug)]
pub struct Camera {
    kind: Kind,
    options: CameraOptions,
    focus: FocusOptions,
    seed: u64,
    transits: Arc<[Transit]>,
    binning: u32,
    start: [u32; 2],
    size: [u32; 2],
    gain: i32,
    offset: i32,
    cooler_on: bool,
    set_c: f64,
    ccd_c: f64,
    exposure: Option<Exposure>,
    number: u64,
    ready_at: Option<Utc>,
    plan: Option<Plan>,
    frame: Option<Arc<Frame>>,
    last: Option<(Utc, f64)>,
}

impl Camera {
    /// One of an observatory's cameras: warm, idle, whole sensor, no binning.
    pub fn new(kind: Kind, options: CameraOptions, seed: u64, observatory: &Options, air_c: f64) -> Self {
        Self {
            kind,
            options,
            focus: observatory.focus,
            seed,
            transits: observatory.transits.as_slice().into(),
            binning: 1,
            start: [0, 0],
            size: [options.width, options.height],
            gain: 0,
            offset: 0,
            cooler_on: false,
            set_c: 0.0,
            ccd_c: air_c,
            exposure: None,
            number: 0,
            ready_at: None,
            plan: None,
            frame: None,
            last: None,
        }
    }

    /// Which of the cameras this is.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Sky time at which the exposure under way ends.
    pub fn ends(&self) -> Option<Utc> {
        self.exposure.as_ref().map(|exposure| exposure.ends)
    }

    /// Light falls on the sensor.
    pub fn exposes_light(&self) -> bool {
        self.exposure.as_ref().is_some_and(|exposure| exposure.light)
    }

    /// The plan of a frame that waits to be drawn; given once.
    pub fn take_plan(&mut self) -> Option<Plan> {
        self.plan.take()
    }

    /// Takes a drawn frame, unless its exposure was given up meanwhile.
    pub fn develop(&mut self, frame: Frame) {
        if frame.number == self.number && self.ready_at.is_some() {
            self.frame = Some(Arc::new(frame));
        }
    }

    /// The finished frame.
    ///
    /// # Errors
    /// Invalid operation when there is none.
    pub fn image(&self, now: Utc) -> Result<Arc<Frame>, Refusal> {
        let ready = self.frame.as_ref().filter(|_| self.ready_at.is_some_and(|at| at <= now));
        ready.cloned().ok_or_else(|| Refusal::invalid_operation("there is no image"))
    }

    /// Lets sky time pass.
    pub fn advance(&mut self, dt: f64, scene: &Scene) {
        let air_c = scene.weather.of(Quantity::Temperature);
        let target = if self.cooler_on { self.set_c.max(air_c - self.options.cooler_reach_k) } else { air_c };
        let away = target - self.ccd_c;
        self.ccd_c += (away * (1.0 - (-0.2 * dt).exp())).clamp(-COOLER_K_PER_S * dt, COOLER_K_PER_S * dt);
        let (options, focus) = (self.options, self.focus);
        if let Some(exposure) = &mut self.exposure {
            exposure.look(scene, || Sample::of(scene, &options, &focus));
            if exposure.ends <= scene.now {
                self.finish(scene);
            }
        }
    }

    fn finish(&mut self, scene: &Scene) {
        let Some(exposure) = self.exposure.take() else { return };
        let started = exposure.started;
        let (exposure_s, samples) = exposure.finish(scene, || Sample::of(scene, &self.options, &self.focus));
        self.ready_at = Some(started.plus_seconds(exposure_s + self.options.readout_s));
        self.last = Some((started, exposure_s));
        self.plan = Some(Plan {
            device: self.kind,
            number: self.number,
            started,
            exposure_s,
            samples,
            binning: self.binning,
            start: self.start,
            size: self.size,
            electrons_per_adu: self.electrons_per_adu(),
            bias_adu: self.options.bias_adu + f64::from(self.offset),
            dark_e_per_s: self.options.dark_e_per_s * (self.ccd_c / 6.5).exp2(),
            camera: self.options,
            seed: self.seed,
            transits: Arc::clone(&self.transits),
        });
    }

    /// Gain counts in tenths of a decibel.
    fn electrons_per_adu(&self) -> f64 {
        self.options.electrons_per_adu * 10.0_f64.powf(-f64::from(self.gain) / 200.0)
    }

    fn cooler_percent(&self, scene: &Scene) -> f64 {
        let below_k = scene.weather.of(Quantity::Temperature) - self.ccd_c;
        if self.cooler_on { (below_k / self.options.cooler_reach_k * 100.0).clamp(0.0, 100.0) } else { 0.0 }
    }

    fn image_ready(&self, now: Utc) -> bool {
        self.image(now).is_ok()
    }

    /// ASCOM: 0 idle, 2 exposing, 3 reading.
    fn state(&self, now: Utc) -> i32 {
        if self.exposure.is_some() {
            2
        } else if self.ready_at.is_some() && !self.image_ready(now) {
            3
        } else {
            0
        }
    }

    fn percent(&self, now: Utc) -> i32 {
        match &self.exposure {
            Some(exposure) => {
                let whole_s = exposure.ends.seconds_since(exposure.started).max(1e-6);
                (now.seconds_since(exposure.started) / whole_s * 100.0).clamp(0.0, 100.0) as i32
            }
            None if self.ready_at.is_some() => 100,
            None => 0,
        }
    }

    /// Answers a GET; the image itself is [`Camera::image`].
    pub fn get(&self, request: &Request, scene: &Scene) -> Answer {
        let options = &self.options;
        let last = || self.last.ok_or_else(|| Refusal::invalid_operation("there was no exposure yet"));
        Ok(match request.member.as_str() {
            "binx" | "biny" => json!(self.binning),
            "camerastate" => json!(self.state(scene.now)),
            "cameraxsize" => json!(options.width),
            "cameraysize" => json!(options.height),
            "canabortexposure" | "cangetcoolerpower" | "cansetccdtemperature" | "canstopexposure" | "hasshutter" => {
                json!(true)
            }
            "canasymmetricbin" | "canfastreadout" | "canpulseguide" | "ispulseguiding" => json!(false),
            "ccdtemperature" => json!(self.ccd_c),
            "cooleron" => json!(self.cooler_on),
            "coolerpower" => json!(self.cooler_percent(scene)),
            "heatsinktemperature" => {
                json!(scene.weather.of(Quantity::Temperature) + 0.15 * self.cooler_percent(scene))
            }
            "setccdtemperature" => json!(self.set_c),
            "electronsperadu" => json!(self.electrons_per_adu()),
            "exposuremax" => json!(EXPOSURE_MAX_S),
            "exposuremin" => json!(0.0),
            "exposureresolution" => json!(0.001),
            "fullwellcapacity" => json!(options.full_well_e),
            "gain" => json!(self.gain),
            "gainmin" | "offsetmin" => json!(0),
            "gainmax" => json!(GAIN_MAX),
            "offset" => json!(self.offset),
            "offsetmax" => json!(OFFSET_MAX),
            // The pixels are sent another way, but the question whether there are any is like any other.
            "imagearray" | "imagearrayvariant" => {
                self.image(scene.now)?;
                json!(null)
            }
            "imageready" => json!(self.image_ready(scene.now)),
            "lastexposureduration" => json!(last()?.1),
            "lastexposurestarttime" => json!(last()?.0.fits()),
            "maxadu" => json!(65_535),
            "maxbinx" | "maxbiny" => json!(MAX_BIN),
            "startx" => json!(self.start[0]),
            "starty" => json!(self.start[1]),
            "numx" => json!(self.size[0]),
            "numy" => json!(self.size[1]),
            "percentcompleted" => json!(self.percent(scene.now)),
            "pixelsizex" | "pixelsizey" => json!(options.pixel_um),
            "readoutmode" => json!(0),
            "readoutmodes" => json!(["Normal"]),
            "sensorname" => json!("Simulated CCD"),
            // Monochrome.
            "sensortype" => json!(0),
            "bayeroffsetx" | "bayeroffsety" | "fastreadout" | "gains" | "offsets" | "subexposureduration" => {
                return Err(Refusal::not_implemented(&request.member));
            }
            _ => return Err(Refusal::UnknownMember),
        })
    }

    /// Executes a PUT.
    pub fn put(&mut self, request: &Request, scene: &Scene) -> Answer {
        let whole = |name: &str, high: u32| -> Result<u32, Refusal> {
            Ok(within(name, f64::from(request.integer(name)?), 0.0, f64::from(high))? as u32)
        };
        match request.member.as_str() {
            "startexposure" => self.expose(request, scene)?,
            "abortexposure" => {
                self.exposure = None;
                // A frame that was being read is given up as well.
                if !self.image_ready(scene.now) {
                    (self.ready_at, self.plan) = (None, None);
                }
            }
            "stopexposure" => self.finish(scene),
            "binx" => self.binning = whole("BinX", MAX_BIN)?.max(1),
            "biny" => self.binning = whole("BinY", MAX_BIN)?.max(1),
            "startx" => self.start[0] = whole("StartX", self.options.width)?,
            "starty" => self.start[1] = whole("StartY", self.options.height)?,
            "numx" => self.size[0] = whole("NumX", self.options.width)?,
            "numy" => self.size[1] = whole("NumY", self.options.height)?,
            "gain" => self.gain = whole("Gain", GAIN_MAX.unsigned_abs())? as i32,
            "offset" => self.offset = whole("Offset", OFFSET_MAX.unsigned_abs())? as i32,
            "cooleron" => self.cooler_on = request.truth("CoolerOn")?,
            "setccdtemperature" => {
                self.set_c = within("SetCCDTemperature", request.number("SetCCDTemperature")?, -80.0, 50.0)?;
            }
            "readoutmode" => {
                whole("ReadoutMode", 0)?;
            }
            "fastreadout" | "pulseguide" | "subexposureduration" => {
                return Err(Refusal::not_implemented(&request.member));
            }
            _ => return Err(Refusal::UnknownMember),
        }
        DONE
    }

    fn expose(&mut self, request: &Request, scene: &Scene) -> Result<(), Refusal> {
        let duration_s = within("Duration", request.number("Duration")?, 0.0, EXPOSURE_MAX_S)?;
        let light = request.truth("Light")?;
        if self.state(scene.now) != 0 {
            return Err(Refusal::invalid_operation("camera is busy"));
        }
        for (axis, pixels) in [self.options.width, self.options.height].into_iter().enumerate() {
            let end = (self.start[axis] + self.size[axis]) * self.binning;
            if self.size[axis] == 0 || end > pixels {
                return Err(Refusal::invalid_value(format!("sub-frame ends at pixel {end} of {pixels}")));
            }
        }
        self.number += 1;
        (self.frame, self.ready_at, self.plan) = (None, None, None);
        self.exposure = Some(Exposure::start(scene.now, duration_s, light));
        if duration_s == 0.0 {
            self.finish(scene);
        }
        Ok(())
    }
}
