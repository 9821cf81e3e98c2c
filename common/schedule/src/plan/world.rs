//! The devices of a forecast, as far as their next step depends on earlier ones.

use std::collections::BTreeMap;

use contract::Name;
use contract::device::telescope::PierSide;
use sky::Icrs;
use units::{Angle, Utc};

/// Turn of the sky, deg of right ascension per s.
const SIDEREAL_DEG_S: f64 = 15.041_067 / 3600.0;

/// The direction of a mount.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aim {
    /// The place of its last slew.
    pub place: Icrs,
    /// Since when it does not track while the sky turns; it tracks where absent.
    pub stands_since: Option<Utc>,
    /// Its side of the pier.
    pub side: PierSide,
}

impl Aim {
    /// The place where it points at an instant.
    pub fn at(&self, now: Utc) -> Icrs {
        let stood_s = self.stands_since.map_or(0.0, |since| now.seconds_since(since));
        Icrs { ra: self.place.ra + Angle::from_degrees(SIDEREAL_DEG_S * stood_s), dec: self.place.dec }
    }
}

/// All devices; everything is shut, parked and warm at first.
#[derive(Debug, Default)]
pub struct World {
    /// Since when the roof is open.
    opened: Option<Utc>,
    /// How long it was open before, s.
    open_before_s: f64,
    /// By mount; parked where absent.
    pub aims: BTreeMap<Name, Aim>,
    /// The filter in the beam of each camera, once it is known.
    pub filters: BTreeMap<Name, String>,
    /// The time at which the sensor of each cooled camera is cold.
    pub cold: BTreeMap<Name, Utc>,
    /// End of the newest exposure.
    pub last_exposure: Option<Utc>,
    /// When everything was last verified closed.
    pub closed: Option<Utc>,
}

impl World {
    /// Is the roof open?
    pub fn is_open(&self) -> bool {
        self.opened.is_some()
    }

    /// Opens the roof.
    pub fn open(&mut self, now: Utc) {
        self.opened = self.opened.or(Some(now));
    }

    /// Closing begins, and takes so long; the mount parks. Nothing changes where all is closed.
    pub fn close(&mut self, now: Utc, takes_s: f64) {
        if let Some(opened) = self.opened.take() {
            let closed = now.plus_seconds(takes_s);
            self.open_before_s += closed.seconds_since(opened);
            self.closed = Some(closed);
            self.aims.clear();
        }
    }

    /// How long the roof was open so far, s.
    pub fn open_s(&self) -> f64 {
        self.open_before_s
    }
}
