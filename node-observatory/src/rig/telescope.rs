//! The mount: slewing to a place of the catalogue, in the frame that the mount speaks.

use std::time::Duration;

use config::EquatorialChoice;
use contract::Device;
use contract::device::telescope::{self, Command, EquatorialSystem};
use sky::{Icrs, Observer};
use units::Angle;

use super::instrument::{Instrument, Voice};
use crate::patience::seconds;
use crate::trouble::Trouble;

/// A mount.
pub struct Mount {
    /// The device.
    pub instrument: Instrument<telescope::Telescope>,
    /// Its configuration.
    pub config: config::Telescope,
}

impl Mount {
    /// Begins to hear a mount.
    pub async fn listen(voice: &Voice, device: Device, config: config::Telescope) -> anyhow::Result<Self> {
        Ok(Self { instrument: Instrument::listen(voice, device).await?, config })
    }

    /// Leaves the park position, unless the mount is known to be out of it or to have none.
    pub async fn unpark(&self) -> Result<(), Trouble> {
        let parked = self.instrument.fresh().and_then(|state| state.fields.at_park.known().copied());
        let cannot = self.instrument.can().is_some_and(|can| !can.park);
        if parked == Some(false) || cannot {
            return Ok(());
        }
        self.instrument.obey(Command::Unpark, self.slew_timeout()).await.map(|_| ())
    }

    /// Switches tracking.
    pub async fn track(&self, on: bool) -> Result<(), Trouble> {
        let tracking = self.instrument.fresh().and_then(|state| state.fields.tracking.known().copied());
        if tracking == Some(on) {
            return Ok(());
        }
        self.instrument.obey(Command::Track { on }, Duration::from_secs(60)).await.map(|_| ())
    }

    /// Slews to a place of the catalogue, tracks it, and settles.
    pub async fn point(&self, target: &Icrs, observer: &Observer) -> Result<(), Trouble> {
        if self.config.equatorial_system == EquatorialChoice::Auto {
            self.instrument.capabilities().await?;
        }
        let (ra, dec) = in_mount_frame(target, observer, self.frame())?;
        self.unpark().await?;
        self.track(true).await?;
        let slew = Command::Slew { ra_deg: ra.degrees(), dec_deg: dec.degrees() };
        self.instrument.obey(slew, self.slew_timeout()).await?;
        // some mounts drop tracking with a slew
        self.track(true).await?;
        self.instrument.clock().sleep_sky(seconds(self.config.settle_s)).await;
        Ok(())
    }

    /// The frame of its coordinates, as far as it is known yet.
    pub fn frame(&self) -> EquatorialSystem {
        match self.config.equatorial_system {
            EquatorialChoice::Auto => {
                self.instrument.can().map_or(EquatorialSystem::Other, |can| can.equatorial_system)
            }
            EquatorialChoice::J2000 => EquatorialSystem::J2000,
            EquatorialChoice::Topocentric => EquatorialSystem::Topocentric,
        }
    }

    fn slew_timeout(&self) -> Duration {
        seconds(self.config.slew_timeout_s)
    }
}

/// A place of the catalogue in the mount's own frame.
fn in_mount_frame(target: &Icrs, observer: &Observer, system: EquatorialSystem) -> Result<(Angle, Angle), Trouble> {
    match system {
        EquatorialSystem::Topocentric => {
            let apparent = observer.to_of_date(target);
            Ok((apparent.ra, apparent.dec))
        }
        EquatorialSystem::J2000 | EquatorialSystem::Other => Ok((target.ra, target.dec)),
        EquatorialSystem::J2050 | EquatorialSystem::B1950 => Err(Trouble::Impossible(format!(
            "the mount wants coordinates in {system:?}, which is not supported; set equatorial_system to \
             \"j2000\" or \"topocentric\" in its block"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use sky::{EarthOrientation, Place};

    use super::*;

    #[test]
    fn a_topocentric_mount_gets_the_place_of_date() {
        let place = Place::new(Angle::from_degrees(-24.6), Angle::from_degrees(-70.4), 2500.0).unwrap();
        let at = "2026-11-21T03:00:00Z".parse().unwrap();
        let observer = Observer::new(&place, &EarthOrientation::default(), at).unwrap();
        let target = Icrs::from_degrees(78.0, -8.0);
        let (ra, dec) = in_mount_frame(&target, &observer, EquatorialSystem::J2000).unwrap();
        assert_eq!((ra.degrees(), dec.degrees()), (78.0, -8.0));
        let (ra, _) = in_mount_frame(&target, &observer, EquatorialSystem::Topocentric).unwrap();
        // 27 years of precession are about a third of a degree
        assert!((0.2..0.5).contains(&(ra.degrees() - 78.0)), "{}", ra.degrees());
        assert!(in_mount_frame(&target, &observer, EquatorialSystem::B1950).is_err());
    }
}
