//! The values of a header about the sky: dates, sidereal time, light times, direction and airmass at the start of an
//! exposure.

use sky::{Icrs, Observer, OfDate, SkyError};
use units::{Angle, Utc};

use crate::card::CardValue;

/// The sky over the site when an exposure began.
pub struct Exposure {
    observer: Observer,
    /// The same site in the middle of the exposure.
    middle: Observer,
    start: Utc,
    end: Utc,
    /// The direction of the target, where it is known.
    target: Option<Icrs>,
}

impl Exposure {
    /// Computes the sky; refused for a place off the Earth or a clock that was never set.
    pub fn new(place: &config::Place, start: Utc, exposure_s: f64, target: Option<Icrs>) -> Result<Self, SkyError> {
        let (site, orientation) = place.on_earth()?;
        let observer = Observer::new(&site, &orientation, start)?;
        let middle = Observer::new(&site, &orientation, start.plus_seconds(exposure_s / 2.0))?;
        let target = target.and_then(|target| target.checked().ok());
        Ok(Self { observer, middle, start, end: start.plus_seconds(exposure_s), target })
    }

    /// Takes this as the direction of the target, unless one is known already.
    pub fn point_to(&mut self, place: Icrs) {
        self.target = self.target.or(place.checked().ok());
    }

    /// The direction of the target.
    pub fn target(&self) -> Option<Icrs> {
        self.target
    }

    /// The catalogue place behind a mount's coordinates of date.
    pub fn of_date_to_icrs(&self, ra_deg: f64, dec_deg: f64) -> Icrs {
        self.observer.of_date_to_icrs(&OfDate::from_degrees(ra_deg, dec_deg))
    }

    /// Altitude and azimuth of the target, degrees, without refraction.
    pub fn direction(&self) -> Option<(f64, f64)> {
        let direction = self.observer.to_horizontal(&self.target?);
        Some((direction.altitude.degrees(), direction.azimuth.degrees()))
    }

    /// A keyword that the header table leaves to Starmesh; `None` when it needs a target and there is none, or the
    /// target is below the horizon, or the keyword is unknown.
    pub fn keyword(&self, keyword: &str) -> Option<CardValue> {
        let value = match keyword {
            "JD-OBS" => CardValue::Float(self.start.jd()),
            "JD-END" => CardValue::Float(self.end.jd()),
            "MJD-OBS" => CardValue::Float(self.start.mjd()),
            "MJD-END" => CardValue::Float(self.end.mjd()),
            "DATE-END" => CardValue::Text(fits_date(self.end)),
            "LST" => CardValue::Float(self.observer.mean_sidereal_time().hours() * 3600.0),
            "HJD-OBS" => CardValue::Float(sum(self.observer.heliocentric_jd_utc(&self.target?))),
            "BJD-OBS" => CardValue::Float(sum(self.observer.barycentric_jd_tdb(&self.target?))),
            "HA" => CardValue::Text(hours_minutes_seconds(self.observer.hour_angle(&self.target?).hours())),
            "AIRMASS" => CardValue::Float(sky::airmass(Angle::from_degrees(self.direction()?.0))?),
            "BJD_TDB" => CardValue::Float(sum(self.middle.barycentric_jd_tdb(&self.target?))),
            "DATE-AVG" => CardValue::Text(fits_date(self.middle.at())),
            "MJD-AVG" => CardValue::Float(self.middle.at().mjd()),
            "AIRMMID" => CardValue::Float(sky::airmass(self.middle.to_horizontal(&self.target?).altitude)?),
            "SUNALT" => CardValue::Float(self.middle.sun().altitude.degrees()),
            "MOONALT" => CardValue::Float(self.middle.moon().altitude.degrees()),
            "MOONDIST" => CardValue::Float(sky::separation(&self.middle.moon_icrs(), &self.target?).degrees()),
            "MOONFRAC" => CardValue::Float(self.middle.moon_illumination()),
            _ => return None,
        };
        Some(value)
    }
}

/// Keywords that [`Exposure::keyword`] knows.
pub const KEYWORDS: [&str; 18] = [
    "JD-OBS", "JD-END", "MJD-OBS", "MJD-END", "DATE-END", "LST", "HJD-OBS", "BJD-OBS", "HA", "AIRMASS", "DATE-AVG",
    "MJD-AVG", "AIRMMID", "SUNALT", "MOONALT", "MOONDIST", "MOONFRAC", "BJD_TDB",
];

/// Those of them that need a direction: a frame with a closed shutter has none of them.
pub const OF_DIRECTION: [&str; 7] = ["HJD-OBS", "BJD-OBS", "HA", "AIRMASS", "AIRMMID", "MOONDIST", "BJD_TDB"];

/// The middle of the exposure, which is in every header, whatever the table lists, with the comments.
pub const MIDDLE: [(&str, &str); 4] = [
    ("DATE-AVG", "UTC at mid-exposure"),
    ("MJD-AVG", "[d] modified Julian date at mid-exposure"),
    ("BJD_TDB", "[d] barycentric Julian date at mid-exposure"),
    ("AIRMMID", "airmass at mid-exposure"),
];

/// A date as headers have it, to the microsecond: `2026-11-21T03:00:00.123456`.
pub fn fits_date(at: Utc) -> String {
    at.strftime("%Y-%m-%dT%H:%M:%S.%6f")
}

/// One number; good to about 40 us.
fn sum((days, fraction): (f64, f64)) -> f64 {
    days + fraction
}

/// Such as `00 10 22.393` or `-01 59 03.120`.
fn hours_minutes_seconds(hours: f64) -> String {
    // Rounded first, so that no 60 appears.
    let milliseconds = (hours.abs() * 3_600_000.0).round() as u64;
    let sign = if hours < 0.0 && milliseconds > 0 { "-" } else { "" };
    let (minutes, rest) = (milliseconds / 60_000, milliseconds % 60_000);
    format!("{sign}{:02} {:02} {:02}.{:03}", minutes / 60, minutes % 60, rest / 1000, rest % 1000)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_hour_angle_never_shows_sixty() {
        assert_eq!(hours_minutes_seconds(0.1728869), "00 10 22.393");
        assert_eq!(hours_minutes_seconds(-1.0 / 3600.0 * 59.9999), "-00 01 00.000");
        assert_eq!(hours_minutes_seconds(-1e-9), "00 00 00.000");
        assert_eq!(hours_minutes_seconds(-12.0), "-12 00 00.000");
    }
}
