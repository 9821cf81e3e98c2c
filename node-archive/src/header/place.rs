//! Where the site is, as headers have it.

use super::HeaderFacts;
use crate::card::CardValue;

/// The ellipsoid of IAU 1976, which FITS has for OBSGEO-H (Rots et al. 2015, A&A 574, A36, section 4.1.3), is so much larger than
/// that of WGS 84, m.
pub(super) const LOWER_M: f64 = 3.0;

impl HeaderFacts<'_> {
    /// A coordinate of the site in the Earth's frame, m.
    pub(super) fn geocentric(&self, axis: usize) -> Option<CardValue> {
        let place_m = self.place.on_earth().ok()?.0.geocentric_m();
        // Sites are known to the centimetre at best.
        place_m.get(axis).map(|m| CardValue::Float((m * 100.0).round() / 100.0))
    }
}

/// What the configuration says of a property that mounts have too.
pub(super) fn site(place: &config::Place, property: &str) -> Option<f64> {
    match property {
        "SiteLatitude" => Some(place.latitude_deg),
        "SiteLongitude" => Some(place.longitude_deg),
        "SiteElevation" => Some(place.elevation_m),
        _ => None,
    }
}
