//! The state of the rest of the observatory that every device may see at one moment.

use std::sync::Arc;

use sky::{Horizontal, Icrs, Observer, OfDate};
use units::{Angle, Utc};

use crate::weather::Conditions;

/// The observatory at one moment, as its devices find it.
pub struct Scene {
    /// Sky time.
    pub now: Utc,
    /// The site at that time.
    pub observer: Arc<Observer>,
    /// The mount reports coordinates of date instead of J2000.
    pub of_date: bool,
    /// The weather.
    pub weather: Conditions,
    /// Where the telescope really looks.
    pub pointing: Pointing,
    /// The light that reaches the camera, and how sharply.
    pub light: Light,
}

/// The direction in which a telescope looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pointing {
    /// Among the stars, pointing error included.
    pub icrs: Icrs,
    /// At the site.
    pub horizontal: Horizontal,
    /// The tube lies on the west side of the pier (looking east).
    pub pier_west: bool,
}

/// The way of the light through dome, cover and filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Fraction of the aperture that dome and cover leave free.
    pub open: f64,
    /// Of that, the fraction that the dome's slit leaves free when its shutter is open.
    pub slit_free: f64,
    /// The light that the flat panel sends into the closed cover, electrons per second and pixel, before the filter.
    pub panel_e_per_s: f64,
    /// Fraction that the filter lets through.
    pub transmission: f64,
    /// Focuser position less best position, steps.
    pub defocus_steps: f64,
    /// Position angle of the camera's y axis, north through east.
    pub position_angle: Angle,
}

impl Scene {
    /// Mount coordinates (hours, degrees) of a place among the stars.
    pub fn to_mount(&self, icrs: Icrs) -> (f64, f64) {
        if self.of_date {
            let of_date = self.observer.to_of_date(&icrs);
            (of_date.ra.wrapped_positive().hours(), of_date.dec.degrees())
        } else {
            (icrs.ra.wrapped_positive().hours(), icrs.dec.degrees())
        }
    }

    /// The place among the stars that mount coordinates (hours, degrees) mean.
    pub fn icrs_of_mount(&self, ra_h: f64, dec_deg: f64) -> Icrs {
        let (ra, dec) = (Angle::from_hours(ra_h), Angle::from_degrees(dec_deg));
        if self.of_date { self.observer.of_date_to_icrs(&OfDate { ra, dec }) } else { Icrs { ra, dec } }
    }
}
