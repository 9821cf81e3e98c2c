//! A mount: where it points, whether it tracks, and how it is moved.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::vendor::VendorCommand;
use crate::{Datum, DeviceKind, Kind, Payload};

/// The mount, ASCOM Telescope.
#[derive(Debug)]
pub struct Telescope;

impl DeviceKind for Telescope {
    const KIND: Kind = Kind::Telescope;
    type Capabilities = Capabilities;
    type Fields = Fields;
    type Command = Command;
}

/// What a mount can do.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "MountCapabilities")]
pub struct Capabilities {
    /// Parks on command.
    pub park: bool,
    /// Slews without blocking.
    pub slew_async: bool,
    /// Tracking can be switched.
    pub set_tracking: bool,
    /// Takes guide pulses.
    pub pulse_guide: bool,
    /// Takes a sync.
    pub sync: bool,
    /// Takes rates for moving targets on both axes.
    pub set_rates: bool,
    /// Frame of its coordinates.
    pub equatorial_system: EquatorialSystem,
    /// Where its driver believes to stand, degrees, east positive.
    pub site_latitude_deg: Datum<f64>,
    /// Degrees, east positive.
    pub site_longitude_deg: Datum<f64>,
    /// Metres above sea level.
    pub site_elevation_m: Datum<f64>,
    /// Speed of guide pulses in right ascension, degrees of that coordinate per second; absent where it is not
    /// reported.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub guide_rate_ra_deg_per_s: Option<f64>,
    /// Speed of guide pulses in declination, degrees per second; absent where it is not reported.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub guide_rate_dec_deg_per_s: Option<f64>,
}

impl Payload for Capabilities {
    const NAME: &'static str = "telescope.capabilities";
}

/// Frame of a mount's own coordinates, ASCOM EquatorialSystem.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EquatorialSystem {
    /// Not reported; taken as ICRS unless the configuration says otherwise.
    #[default]
    Other,
    /// True equator and equinox of date, seen from the site.
    Topocentric,
    /// J2000, taken as ICRS.
    J2000,
    /// J2050.
    J2050,
    /// B1950.
    B1950,
}

/// What nodes decide with; coordinates are in the mount's own frame (`equatorial_system`).
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "MountFields")]
pub struct Fields {
    /// Right ascension in the mount's frame, degrees.
    pub ra_deg: Datum<f64>,
    /// Declination in the mount's frame, degrees.
    pub dec_deg: Datum<f64>,
    /// Altitude, degrees.
    pub altitude_deg: Datum<f64>,
    /// Azimuth from north through east, degrees.
    pub azimuth_deg: Datum<f64>,
    /// Follows the sky.
    pub tracking: Datum<bool>,
    /// Moves to a target.
    pub slewing: Datum<bool>,
    /// Stands at its park position.
    pub at_park: Datum<bool>,
    /// Side of the pier.
    pub pier_side: Datum<PierSide>,
    /// A guide pulse is under way.
    pub pulse_guiding: Datum<bool>,
    /// Its device node stops it at a limit, and has not seen it stopped yet; absent otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub beyond_limit: Option<BeyondLimit>,
}

impl Fields {
    /// Does the mount stand at its park position? `None` where `AtPark` is not known. Some drivers report it as soon as
    /// they accept `Park`: a mount that is known to slew, to track or to be beyond a limit is not parked. What is not
    /// known of these does not count against it.
    pub fn parked(&self) -> Option<bool> {
        let moves = [&self.slewing, &self.tracking].iter().any(|flag| flag.known() == Some(&true));
        self.at_park.known().map(|at_park| *at_park && !moves && self.beyond_limit.is_none())
    }
}

/// A mount that tracks beyond a limit.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct BeyondLimit {
    /// Which limit, with numbers and units.
    pub why: String,
    /// Neither an end of tracking, nor an abort, nor a park has stopped it: everything is to be closed.
    pub not_stopped: bool,
}

impl Payload for Fields {
    const NAME: &'static str = "telescope.state";
}

/// Side of the pier that the mount is on (ASCOM: east means looking west).
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PierSide {
    /// On the east side of the pier, looking west.
    East,
    /// On the west side of the pier, looking east.
    West,
    /// The mount does not know.
    Unknown,
}

/// A direction of a guide pulse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// Towards +dec.
    North,
    /// Towards -dec.
    South,
    /// Towards +ra.
    East,
    /// Towards -ra.
    West,
}

/// What a mount may be asked.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "MountCommand")]
#[serde(rename_all = "snake_case")]
pub enum Command {
    /// Slew to a place in the mount's own frame; done when it stands there and has settled.
    Slew {
        /// Degrees, mount frame.
        ra_deg: f64,
        /// Degrees, mount frame.
        dec_deg: f64,
    },
    /// Switch tracking.
    Track {
        /// On or off.
        on: bool,
    },
    /// Stop moving at once.
    Abort,
    /// Go to the park position and stay; aborts a slew first.
    Park,
    /// Leave the park position.
    Unpark,
    /// Push the mount.
    PulseGuide {
        /// Which way.
        direction: Direction,
        /// How long, ms.
        duration_ms: u32,
    },
    /// Synchronise the mount with the place where it points, in its own frame.
    Sync {
        /// Degrees, mount frame.
        ra_deg: f64,
        /// Degrees, mount frame.
        dec_deg: f64,
    },
    /// Go at these rates relative to the stars, after a moving target; both zero: follow the stars again. A slew,
    /// parking, and switching tracking end them too.
    Rates {
        /// Seconds of right ascension per sidereal second, eastward positive (ASCOM RightAscensionRate).
        ra_s_per_sidereal_s: f64,
        /// Arcseconds per second, northward positive (ASCOM DeclinationRate).
        dec_arcsec_per_s: f64,
    },
    /// Grants the lease where there is no enclosure; the answer carries the token.
    Claim,
    /// A command of the maker's own; only what the device's block lists (`vendor_commands`) is sent.
    Vendor(VendorCommand),
}

impl Payload for Command {
    const NAME: &'static str = "telescope.command";
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NoData;

    #[test]
    fn a_mount_is_parked_that_says_so_and_is_not_known_to_move() {
        let flag = |value: Option<bool>| value.map_or(Datum::missing(NoData::not_implemented()), Datum::Known);
        for (at_park, slewing, tracking, parked) in [
            (Some(true), Some(false), Some(false), Some(true)),
            (Some(true), None, None, Some(true)),
            (Some(true), Some(true), Some(false), Some(false)),
            (Some(true), Some(true), None, Some(false)),
            (Some(true), Some(false), Some(true), Some(false)),
            (Some(true), None, Some(true), Some(false)),
            (Some(false), Some(false), Some(false), Some(false)),
            (None, Some(false), Some(false), None),
            (None, Some(true), Some(true), None),
        ] {
            let (at_park, slewing, tracking) = (flag(at_park), flag(slewing), flag(tracking));
            let fields = Fields { at_park, slewing, tracking, ..Fields::default() };
            assert_eq!(fields.parked(), parked, "{fields:?}");
        }
        let beyond = BeyondLimit { why: "altitude 19 deg, the limit is 20 deg".to_owned(), not_stopped: true };
        let fields = Fields { at_park: Datum::Known(true), beyond_limit: Some(beyond), ..Fields::default() };
        assert_eq!(fields.parked(), Some(false));
    }
}
