//! The reasons why the sky cannot be computed.

use units::Utc;

/// Why a place, a time or a window was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SkyError {
    /// The latitude is outside [-90, 90] deg or not a number.
    #[error("latitude {degrees} deg is not within -90 to 90")]
    Latitude {
        /// As given.
        degrees: f64,
    },
    /// The longitude is outside [-180, 360] deg or not a number.
    #[error("longitude {degrees} deg east is not within -180 to 360")]
    Longitude {
        /// As given.
        degrees: f64,
    },
    /// The elevation is below -500 m, above 9000 m or not a number.
    #[error("elevation {metres} m is not within -500 to 9000")]
    Elevation {
        /// As given.
        metres: f64,
    },
    /// UT1-UTC or the polar motion is not a number, or larger than either has ever been.
    #[error("earth orientation (UT1-UTC {dut1_s} s, pole {polar_x_arcsec}, {polar_y_arcsec} arcsec) is out of range")]
    EarthOrientation {
        /// UT1-UTC as given.
        dut1_s: f64,
        /// Polar motion as given.
        polar_x_arcsec: f64,
        /// Polar motion as given.
        polar_y_arcsec: f64,
    },
    /// The Earth's ephemeris holds until 2100 and UTC has its leap seconds since 1972: a clock outside is a clock
    /// unset.
    #[error("{at} is not within 1972 to 2099, for which the sky is computed")]
    Time {
        /// As given.
        at: Utc,
    },
    /// The window ends before it starts.
    #[error("the window from {start} to {end} ends before it starts")]
    Window {
        /// Start as given.
        start: Utc,
        /// End as given.
        end: Utc,
    },
    /// A right ascension or declination that is no direction.
    #[error("right ascension {ra_deg} deg, declination {dec_deg} deg is no direction")]
    Direction {
        /// As given.
        ra_deg: f64,
        /// As given.
        dec_deg: f64,
    },
    /// Orbital elements that describe no orbit.
    #[error("orbital elements: {0}")]
    Elements(String),
    /// Two-line elements that cannot be read, or that do not hold at the requested time.
    #[error("two-line elements: {0}")]
    TwoLines(String),
    /// A body that no telescope is pointed at.
    #[error("{name}: no telescope is pointed at it")]
    NoTarget {
        /// Its name.
        name: String,
    },
    /// No such day in the calendar.
    #[error("{0:?} is no date such as 20261121")]
    Date(String),
}
