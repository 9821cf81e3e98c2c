//! The light that a camera receives while its shutter is open, and the plan for the frame that results.

use std::sync::Arc;

use sky::{Icrs, airmass};
use units::{Angle, Utc};

use crate::kind::Kind;
use crate::options::{CameraOptions, FocusOptions};
use crate::scene::Scene;
use crate::transit::Transit;
use crate::weather::Quantity;

/// Photons per second and square metre from a star of magnitude 0 in V (Bessell 1979: 1000 per s, cm2 and A).
const PHOTONS: f64 = 8.8e9;
/// The part of them that mirrors, obstruction and detector leave.
const EFFICIENCY: f64 = 0.45;
/// Magnitudes of extinction per airmass.
const EXTINCTION: f64 = 0.15;

/// The light that falls on the camera during one stretch of an exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Length of the stretch, sky seconds.
    pub duration_s: f64,
    /// Where the middle of the sensor looks.
    pub center: Icrs,
    /// Position angle of the camera's y axis, north through east.
    pub position_angle: Angle,
    /// Electrons per second from a star of magnitude 0.
    pub zero_e_per_s: f64,
    /// Electrons per second and unbinned pixel from the sky or the flat panel.
    pub sky_e_per_s: f64,
    /// FWHM of a star, arcsec.
    pub fwhm_arcsec: f64,
}

impl Sample {
    /// The light that the camera receives at this moment.
    pub fn of(scene: &Scene, camera: &CameraOptions, focus: &FocusOptions) -> Self {
        let light = &scene.light;
        let air = airmass(scene.pointing.horizontal.altitude);
        let area_m2 = (camera.aperture_mm / 1e3).powi(2) * std::f64::consts::FRAC_PI_4;
        let optics = PHOTONS * EFFICIENCY * area_m2 * light.open * light.transmission;
        let cloud = scene.weather.of(Quantity::CloudCover) / 100.0;
        let through_air = air.map_or(0.0, |air| 10.0_f64.powf(-0.4 * EXTINCTION * air) * (1.0 - 0.97 * cloud));
        let pixel_arcsec = camera.pixel_scale().arcseconds();
        let sky = 10.0_f64.powf(-0.4 * scene.weather.of(Quantity::SkyQuality)) * pixel_arcsec * pixel_arcsec;

        let seeing = scene.weather.of(Quantity::StarFwhm) * air.unwrap_or(1.0).powf(0.6);
        // The cone of light seen off focus: as wide as defocus over focal ratio, 0.7 of that as a FWHM.
        let blur_mm = light.defocus_steps * focus.step_um * 1e-3 * camera.aperture_mm / camera.focal_length_mm;
        let defocus = 0.7 * Angle::from_radians(blur_mm / camera.focal_length_mm).arcseconds();
        Self {
            duration_s: 0.0,
            center: scene.pointing.icrs,
            position_angle: light.position_angle,
            zero_e_per_s: optics * through_air,
            sky_e_per_s: optics * sky + light.panel_e_per_s * light.transmission,
            fwhm_arcsec: (seeing.powi(2) + camera.optics_fwhm_arcsec.powi(2) + defocus.powi(2)).sqrt(),
        }
    }
}

/// All values that decide the pixels of one frame.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The camera that exposed.
    pub device: Kind,
    /// Which exposure this is, counting from 1.
    pub number: u64,
    /// Begin of the exposure.
    pub started: Utc,
    /// Its length, s.
    pub exposure_s: f64,
    /// The light that fell on the camera; empty for a dark.
    pub samples: Vec<Sample>,
    /// Pixels binned to one, along each axis.
    pub binning: u32,
    /// First column and row, binned pixels.
    pub start: [u32; 2],
    /// Columns and rows, binned pixels.
    pub size: [u32; 2],
    /// At the gain chosen.
    pub electrons_per_adu: f64,
    /// At the offset chosen.
    pub bias_adu: f64,
    /// Electrons per second and unbinned pixel at the sensor's temperature.
    pub dark_e_per_s: f64,
    /// The camera.
    pub camera: CameraOptions,
    /// Chance of this camera.
    pub seed: u64,
    /// Stars whose light falls for some time.
    pub transits: Arc<[Transit]>,
}

/// An exposure under way.
#[derive(Debug, Clone)]
pub struct Exposure {
    /// Begin.
    pub started: Utc,
    /// When it ends by itself.
    pub ends: Utc,
    /// Whether light falls on the sensor.
    pub light: bool,
    samples: Vec<Sample>,
    sampled: Utc,
}

impl Exposure {
    /// Starts now.
    pub fn start(now: Utc, duration_s: f64, light: bool) -> Self {
        Self { started: now, ends: now.plus_seconds(duration_s), light, samples: Vec::new(), sampled: now }
    }

    /// Takes a sample: the light of this moment fills the time since the last look. At most some 40 samples are kept.
    pub fn look(&mut self, scene: &Scene, see: impl FnOnce() -> Sample) {
        let until = scene.now.min(self.ends);
        let since_s = until.seconds_since(self.sampled);
        let least_s = self.ends.seconds_since(self.started) / 40.0;
        if self.light && since_s > 0.0 && (since_s >= least_s || until == self.ends) {
            self.samples.push(Sample { duration_s: since_s, ..see() });
            self.sampled = until;
        }
    }

    /// Ends it now, at the latest at its planned end; returns its true length and the samples.
    pub fn finish(mut self, scene: &Scene, see: impl FnOnce() -> Sample) -> (f64, Vec<Sample>) {
        let end = scene.now.min(self.ends);
        let rest_s = end.seconds_since(self.sampled);
        if self.light && (rest_s > 0.0 || self.samples.is_empty()) {
            self.samples.push(Sample { duration_s: rest_s.max(0.0), ..see() });
        }
        (end.seconds_since(self.started), self.samples)
    }
}
