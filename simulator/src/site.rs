//! A simulator that takes the place of a site: where and when, its filters, its focus and its cooler.

use serde::Deserialize;
use serde_json::Value;
use units::{Angle, Utc};

use crate::options::{Filter, FocusOptions, Options};
use crate::world::World;

/// The properties of a site; an absent one stays as it is.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Site {
    /// Degrees, north positive.
    latitude_deg: Option<f64>,
    /// Degrees, east positive.
    longitude_deg: Option<f64>,
    /// m above the sea.
    elevation_m: Option<f64>,
    /// Sky time at which the clock stands until a client asks for it.
    start: Option<Utc>,
    /// Best position of the focuser at 10 C, steps.
    best_focus: Option<u32>,
    /// Filters that the wheel needs in addition to its own.
    filters: Vec<String>,
    /// Small frames of the same field where the night is fast: to draw and solve a large one takes hours of it.
    small_frames: bool,
    /// Scatter of repeated slews to one place, arcsec per axis.
    scatter_arcsec: Option<f64>,
    /// A set point that the cooler has to reach, degrees Celsius.
    coldest_c: Option<f64>,
}

/// A wheel has no more places.
const MOST_FILTERS: usize = 100;
/// From this speed on small frames are small.
const FAST: f64 = 60.0;
/// Their side, pixels.
const SMALL_PX: u32 = 512;
/// Width of the stars in them, pixels.
const SMALL_FWHM_PX: f64 = 2.4;
/// The light that passes a filter of an unknown sort.
const TRANSMISSION: f64 = 0.45;
/// The air is no warmer than this in the simulated nights, degrees Celsius, with some reserve of the cooler.
const WARMEST_C: f64 = 25.0;

/// Begins anew as this site.
///
/// # Errors
/// The reason why the order describes no site.
pub fn begin(world: &World, order: &Value) -> Result<(), String> {
    let site: Site = serde_json::from_value(order.clone()).map_err(|error| error.to_string())?;
    for (name, value, most) in [
        ("latitude_deg", site.latitude_deg, 90.0),
        ("longitude_deg", site.longitude_deg, 360.0),
        ("elevation_m", site.elevation_m, 9000.0),
        ("coldest_c", site.coldest_c, 273.0),
        ("scatter_arcsec", site.scatter_arcsec, 3600.0),
    ] {
        if value.is_some_and(|value| value.is_nan() || value.abs() > most) {
            return Err(format!("{name}: expected -{most} to {most}"));
        }
    }
    if site.filters.len() > MOST_FILTERS {
        return Err(format!("filters: expected at most {MOST_FILTERS}"));
    }
    world.begin_anew(|options| site.apply(options)).map_err(|error| error.to_string())
}

impl Site {
    fn apply(self, options: &mut Options) {
        options.latitude = self.latitude_deg.map_or(options.latitude, Angle::from_degrees);
        options.longitude = self.longitude_deg.map_or(options.longitude, Angle::from_degrees);
        options.elevation_m = self.elevation_m.unwrap_or(options.elevation_m);
        options.start = self.start.unwrap_or(options.start);
        if let Some(best) = self.best_focus.and_then(|best| i32::try_from(best).ok()) {
            let of_old = FocusOptions::default();
            options.focus.best_step = f64::from(best);
            // Room on the far side too.
            options.focus.max_step = of_old.max_step.max(best.saturating_mul(2));
        }
        for name in self.filters {
            if !options.filters.iter().any(|known| known.name == name) {
                options.filters.push(Filter::new(&name, 0, TRANSMISSION));
            }
        }
        let camera = &mut options.camera;
        if self.small_frames && options.speed >= FAST && camera.width.max(camera.height) > SMALL_PX {
            let larger = f64::from(camera.width.max(camera.height)) / f64::from(SMALL_PX);
            camera.width = (f64::from(camera.width) / larger).round() as u32;
            camera.height = (f64::from(camera.height) / larger).round() as u32;
            camera.pixel_um *= larger;
            camera.optics_fwhm_arcsec = SMALL_FWHM_PX * camera.pixel_scale().arcseconds();
        }
        options.mount.scatter_arcsec = self.scatter_arcsec.map_or(options.mount.scatter_arcsec, f64::abs);
        if let Some(coldest_c) = self.coldest_c {
            options.camera.cooler_reach_k = options.camera.cooler_reach_k.max(WARMEST_C - coldest_c);
        }
    }
}
