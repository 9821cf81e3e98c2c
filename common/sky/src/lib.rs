//! The sky over a site: the direction of a catalogue place now, the times of sunset and twilight, the light times of
//! stars.
//!
//! Coordinates carry their frame in the type: [`Icrs`] is the frame of catalogues, schedules and the bus, [`OfDate`]
//! that of most mounts ("JNow"), [`Horizontal`] that of a dome slit and a horizon limit. An [`Observer`] is one
//! [`Place`] at one instant; it is built once (some 70 us) and then turns coordinates between the frames cheaply.
//!
//! ```
//! use sky::{EarthOrientation, Icrs, Observer, Place};
//! use units::Angle;
//!
//! let paranal = Place::new(Angle::from_degrees(-24.6157), Angle::from_degrees(-70.3976), 2518.0)?;
//! let observer = Observer::new(&paranal, &EarthOrientation::default(), "2026-11-21T03:00:00Z".parse()?)?;
//! let rigel = Icrs::from_degrees(78.634, -8.202);
//! let altitude = observer.to_horizontal(&rigel).altitude;
//! println!("at airmass {:?}", sky::airmass(altitude));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! No refraction anywhere: it would need the weather, and telescopes apply their own.
//! Stars agree with astropy within 0.01 arcsec and 0.1 ms, Sun and Moon within 0.1 arcsec, when both are
//! given the same [`EarthOrientation`] (`tests/agrees_with_astropy.rs`, values made by `golden/make_golden.py`).
//!
//! The astronomy is computed by `sofars`, a Rust derivation of the IAU SOFA routines; it is neither distributed nor
//! endorsed by SOFA.

mod airmass;
mod arc;
mod body;
mod error;
mod frame;
mod light_time;
mod meridian;
pub mod moving;
mod night_date;
mod observer;
mod place;
pub mod slit;
mod sun_crossing;
mod tangent;
mod time_scale;
mod visibility;

pub use airmass::airmass;
pub use arc::Arc;
pub use error::SkyError;
pub use frame::{Horizontal, Icrs, OfDate, position_angle, separation};
pub use light_time::{barycentric_jd_tdb, heliocentric_jd_utc};
pub use meridian::{Meridian, nearest_meridian};
pub use moving::{Body, Rates, Seen};
pub use night_date::{NightDate, night_date};
pub use observer::Observer;
pub use place::{EarthOrientation, Place};
pub use sun_crossing::{Night, next_sun_crossing, night};
pub use tangent::Tangent;
pub use visibility::{LowestAltitude, altitudes, lowest_altitude};
