//! The observatory as one machine: its devices and the weather, moving through sky time together.

use std::sync::Arc;

use sky::{EarthOrientation, Horizontal, Observer, Place, SkyError};
use units::{Angle, Utc};

use crate::answer::{Answer, Refusal};
use crate::camera::{self, Camera};
use crate::cover_calibrator::{self, CoverCalibrator};
use crate::dome::{self, Dome};
use crate::filter_wheel::{self, FilterWheel};
use crate::focuser::{self, Focuser};
use crate::guide_camera;
use crate::kind::Kind;
use crate::observing_conditions::{self, ObservingConditions};
use crate::options::Options;
use crate::request::Request;
use crate::rotator::{self, Rotator};
use crate::safety_monitor::{self, SafetyMonitor};
use crate::scene::{Light, Pointing, Scene};
use crate::slit;
use crate::switch::{self, Switch};
use crate::telescope::{self, Telescope};
use crate::weather::{Conditions, Quantity, Weather, clear_sky_mag};

/// Longest stretch of sky time that is passed in one step while something may move, s.
const STEP_S: f64 = 0.5;
/// Most steps for one advance; at high speed they become longer instead.
const STEPS: f64 = 60.0;
/// Makes the guide camera's random numbers differ from the main camera's.
const GUIDE_SEED: u64 = 0x6001_DE00_0000_0000;

/// All devices under one sky.
#[derive(Debug)]
pub struct Observatory {
    options: Options,
    place: Place,
    observer: Arc<Observer>,
    now: Utc,
    /// The weather as it is.
    pub conditions: Conditions,
    /// The weather of the coming hours.
    pub weather: Weather,
    /// Kind telescope.
    pub telescope: Telescope,
    /// Kind camera.
    pub camera: Camera,
    /// Camera 1, where there is a guide scope.
    pub guide_camera: Option<Camera>,
    /// Kind filterwheel.
    pub filter_wheel: FilterWheel,
    /// Kind focuser.
    pub focuser: Focuser,
    /// Kind dome.
    pub dome: Dome,
    /// Kind safetymonitor.
    pub safety_monitor: SafetyMonitor,
    /// Kind observingconditions.
    pub observing_conditions: ObservingConditions,
    /// Kind covercalibrator.
    pub cover_calibrator: CoverCalibrator,
    /// Kind switch.
    pub switch: Switch,
    /// Kind rotator.
    pub rotator: Rotator,
}

impl Observatory {
    /// Closed, parked, warm, in fair weather.
    ///
    /// # Errors
    /// When the site or the start is nowhere the sky can be computed for.
    pub fn new(options: &Options) -> Result<Self, SkyError> {
        let place = Place::new(options.latitude, options.longitude, options.elevation_m)?;
        let observer = Observer::new(&place, &EarthOrientation::default(), options.start)?;
        let weather = Weather::fair(options.seed, options.longitude, options.elevation_m);
        let conditions = weather.at(options.start, clear_sky_mag(observer.sun().altitude));
        let air_c = conditions.of(Quantity::Temperature);
        Ok(Self {
            telescope: Telescope::new(options, &observer),
            camera: Camera::new(Kind::Camera, options.camera, options.seed, options, air_c),
            guide_camera: options.guide_camera.map(|guide| {
                // Its hot pixels differ.
                Camera::new(Kind::GuideCamera, guide.camera, options.seed ^ GUIDE_SEED, options, air_c)
            }),
            filter_wheel: FilterWheel::new(&options.filters),
            focuser: Focuser::new(&options.focus),
            dome: Dome::new(&options.dome),
            safety_monitor: SafetyMonitor::default(),
            observing_conditions: ObservingConditions::default(),
            cover_calibrator: CoverCalibrator::default(),
            switch: Switch::default(),
            rotator: Rotator::default(),
            options: options.clone(),
            now: options.start,
            place,
            observer: Arc::new(observer),
            conditions,
            weather,
        })
    }

    /// The options that it was made of.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// Lets everything happen until `now`.
    pub fn advance(&mut self, now: Utc) {
        let total_s = now.seconds_since(self.now);
        if total_s <= 0.0 {
            return;
        }
        // After 2099 the position of the sky cannot be computed: it stands still, and the simulator goes on.
        if let Ok(observer) = Observer::new(&self.place, &EarthOrientation::default(), now) {
            self.observer = Arc::new(observer);
        }
        let steps = (total_s / STEP_S).ceil().clamp(1.0, STEPS);
        let begin = self.now;
        for step in 1..=steps as u32 {
            self.now = begin.plus_seconds(total_s * f64::from(step) / steps);
            self.step(total_s / steps);
        }
        self.now = now;
        self.feel_weather();
    }

    /// Takes over the weather that is planned for this moment.
    pub fn feel_weather(&mut self) {
        self.conditions = self.weather.at(self.now, clear_sky_mag(self.observer.sun().altitude));
    }

    fn step(&mut self, dt: f64) {
        self.telescope.turn_rates(&self.observer);
        self.telescope.mount.advance(dt);
        if let Some(vendor) = &mut self.telescope.vendor {
            vendor.advance(dt, self.telescope.mount.parked);
        }
        self.filter_wheel.advance(dt);
        self.focuser.advance(dt);
        self.cover_calibrator.advance(dt);
        self.rotator.advance(dt);
        self.switch.advance(dt);
        let pointing = self.pointing();
        self.dome.advance(dt, pointing.horizontal.azimuth.degrees());
        let scene = self.scene();
        if self.camera.exposes_light() {
            self.dome.count_light(dt, scene.light.slit_free);
        }
        self.camera.advance(dt, &scene);
        if let (Some(camera), Some(options)) = (&mut self.guide_camera, &self.options.guide_camera) {
            camera.advance(dt, &guide_camera::scene(options, scene, self.dome.open()));
        }
    }

    /// All cameras.
    pub fn cameras(&mut self) -> impl Iterator<Item = &mut Camera> {
        std::iter::once(&mut self.camera).chain(&mut self.guide_camera)
    }

    /// The camera of this kind; None: no camera, or none that is there.
    pub fn camera(&self, kind: Kind) -> Option<&Camera> {
        match kind {
            Kind::Camera => Some(&self.camera),
            Kind::GuideCamera => self.guide_camera.as_ref(),
            _ => None,
        }
    }

    /// The observatory as the guide camera finds it; None without one.
    pub fn guide_scene(&self) -> Option<Scene> {
        let options = self.options.guide_camera.as_ref()?;
        Some(guide_camera::scene(options, self.scene(), self.dome.open()))
    }

    fn pointing(&self) -> Pointing {
        let mount = &self.telescope.mount;
        let icrs = mount.looks_at(&self.observer);
        Pointing { icrs, horizontal: self.observer.to_horizontal(&icrs), pier_west: mount.pier_west }
    }

    /// The observatory as its devices find it now.
    pub fn scene(&self) -> Scene {
        let pointing = self.pointing();
        let (filter, transmission) = self.filter_wheel.filter();
        let temperature_c = self.conditions.of(Quantity::Temperature);
        let slit_free = slit::free(&self.options, &pointing, self.dome.azimuth());
        let turned = self.rotator.mechanical_deg() + if pointing.pier_west { 180.0 } else { 0.0 };
        Scene {
            now: self.now,
            observer: self.observer.clone(),
            of_date: self.options.mount.of_date,
            weather: self.conditions,
            light: Light {
                open: self.dome.open() * slit_free * self.cover_calibrator.open(),
                slit_free,
                panel_e_per_s: self.cover_calibrator.panel_e_per_s(),
                transmission,
                defocus_steps: self.focuser.defocus_steps(temperature_c, f64::from(filter.focus_offset)),
                position_angle: (self.options.camera.position_angle + Angle::from_degrees(turned)).wrapped_positive(),
            },
            pointing,
        }
    }

    /// The Sun, from the site.
    pub fn sun(&self) -> Horizontal {
        self.observer.sun()
    }

    /// Sends a request to its device.
    pub fn ask(&mut self, kind: Kind, request: &Request) -> Answer {
        if request.is_put { self.put(kind, request) } else { self.get(kind, request) }
    }

    fn get(&self, kind: Kind, request: &Request) -> Answer {
        let scene = self.scene();
        match kind {
            Kind::Telescope => self.telescope.get(request, &scene),
            Kind::Camera => self.camera.get(request, &scene),
            Kind::GuideCamera => match (&self.guide_camera, self.guide_scene()) {
                (Some(camera), Some(scene)) => camera.get(request, &scene),
                _ => Err(Refusal::UnknownMember),
            },
            Kind::FilterWheel => self.filter_wheel.get(request),
            Kind::Focuser => self.focuser.get(request, &scene),
            Kind::Dome => self.dome.get(request),
            Kind::SafetyMonitor => self.safety_monitor.get(request, &scene.weather),
            Kind::ObservingConditions => self.observing_conditions.get(request, &scene.weather),
            Kind::CoverCalibrator => self.cover_calibrator.get(request),
            Kind::Switch => self.switch.get(request),
            Kind::Rotator => self.rotator.get(request),
        }
    }

    fn put(&mut self, kind: Kind, request: &Request) -> Answer {
        let scene = self.scene();
        match kind {
            Kind::FilterWheel => self.filter_wheel.put(request),
            Kind::Focuser => self.focuser.put(request),
            Kind::Dome => self.dome.put(request),
            Kind::SafetyMonitor => Err(Refusal::UnknownMember),
            Kind::ObservingConditions => self.observing_conditions.put(request),
            Kind::CoverCalibrator => self.cover_calibrator.put(request),
            Kind::Switch => self.switch.put(request),
            Kind::Rotator => self.rotator.put(request),
            Kind::Telescope => self.telescope.put(request, &scene),
            Kind::Camera => self.camera.put(request, &scene),
            Kind::GuideCamera => {
                let scene = self.guide_scene();
                match (&mut self.guide_camera, scene) {
                    (Some(camera), Some(scene)) => camera.put(request, &scene),
                    _ => Err(Refusal::UnknownMember),
                }
            }
        }
    }

    /// Names of the properties of a kind that need no parameters.
    pub fn properties(kind: Kind) -> &'static [&'static str] {
        match kind {
            Kind::Telescope => telescope::PROPERTIES,
            Kind::Camera | Kind::GuideCamera => camera::PROPERTIES,
            Kind::FilterWheel => filter_wheel::PROPERTIES,
            Kind::Focuser => focuser::PROPERTIES,
            Kind::Dome => dome::PROPERTIES,
            Kind::SafetyMonitor => safety_monitor::PROPERTIES,
            Kind::ObservingConditions => observing_conditions::PROPERTIES,
            Kind::CoverCalibrator => cover_calibrator::PROPERTIES,
            Kind::Switch => switch::PROPERTIES,
            Kind::Rotator => rotator::PROPERTIES,
        }
    }

    /// Names of the properties in `DeviceState` of a kind.
    pub fn state_properties(kind: Kind) -> &'static [&'static str] {
        match kind {
            Kind::Telescope => telescope::STATE,
            Kind::Camera | Kind::GuideCamera => camera::STATE,
            Kind::FilterWheel => filter_wheel::STATE,
            Kind::Focuser => focuser::STATE,
            Kind::Dome => dome::STATE,
            Kind::SafetyMonitor => safety_monitor::STATE,
            Kind::ObservingConditions => observing_conditions::STATE,
            Kind::CoverCalibrator => cover_calibrator::STATE,
            Kind::Switch => switch::STATE,
            Kind::Rotator => rotator::STATE,
        }
    }
}
