//! What was read of a mount, and when each of it was asked: a decision never uses a reading from before the command that
//! it judges.

use bus::MachineTime;
use contract::Datum;
use contract::device::telescope::{EquatorialSystem, Fields, PierSide};

use crate::now::Now;
use crate::readings::Readings;

/// A value with the moment at which it was asked for; none where it is not known.
pub type ReadAt<T> = Option<(T, Now)>;

/// What this node ordered last of what moves a mount or stops it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ordered {
    /// To go somewhere: a slew or a park. Some mounts are late to report that they move.
    Go,
    /// To leave its park, or to track: a slew follows.
    Begin,
    /// To stop.
    Stop,
}

/// A mount as it was read last.
#[derive(Debug, Clone, Copy, Default)]
pub struct MountSight {
    /// The frame of right ascension and declination.
    pub system: EquatorialSystem,
    /// Right ascension in the mount's frame, degrees.
    pub ra_deg: ReadAt<f64>,
    /// Declination, degrees.
    pub dec_deg: ReadAt<f64>,
    /// Altitude as the mount reports it, degrees.
    pub altitude_deg: ReadAt<f64>,
    /// Azimuth, degrees.
    pub azimuth_deg: ReadAt<f64>,
    /// It says that it follows the sky.
    pub tracking: ReadAt<bool>,
    /// It says that it moves to a target.
    pub slewing: ReadAt<bool>,
    /// It says that it is parked.
    pub at_park: ReadAt<bool>,
    /// Side of the pier, where it reports one.
    pub pier_side: ReadAt<PierSide>,
    /// The newest order to the mount, and when it was given or, later, answered.
    pub ordered: Option<(Ordered, MachineTime)>,
}

impl MountSight {
    /// By the newest readings.
    pub fn of(readings: &Readings, fields: Fields, ordered: Option<(Ordered, MachineTime)>) -> Self {
        fn seen<T: Copy>(readings: &Readings, value: Datum<T>, property: &str) -> ReadAt<T> {
            value.known().copied().zip(readings.asked(property))
        }
        let pier_side = seen(readings, fields.pier_side, "SideOfPier");
        Self {
            ra_deg: seen(readings, fields.ra_deg, "RightAscension"),
            dec_deg: seen(readings, fields.dec_deg, "Declination"),
            altitude_deg: seen(readings, fields.altitude_deg, "Altitude"),
            azimuth_deg: seen(readings, fields.azimuth_deg, "Azimuth"),
            tracking: seen(readings, fields.tracking, "Tracking"),
            slewing: seen(readings, fields.slewing, "Slewing"),
            at_park: seen(readings, fields.at_park, "AtPark"),
            pier_side: pier_side.filter(|(side, _)| *side != PierSide::Unknown),
            ordered,
            ..Self::default()
        }
    }
}

/// A value, unless it was asked for before `since`.
pub fn asked_since<T: Copy>(seen: ReadAt<T>, since: MachineTime) -> ReadAt<T> {
    seen.filter(|(_, asked)| asked.machine >= since)
}
