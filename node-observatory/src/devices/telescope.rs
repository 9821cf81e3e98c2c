//! The mount: slewing to a place of the catalogue, in the frame that the mount speaks.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use config::EquatorialChoice;
use contract::device::telescope::{self, BeyondLimit, Command, EquatorialSystem};
use contract::{CommandId, Device};
use schedule::horizon_limits::HorizonLimits;
use schedule::kept_place::KeptPlace;
use schedule::plan::overheads::{TOOK, TimedPart};
use schedule::slew_limits;
use sky::{Icrs, Observer, Rates, separation};
use units::{Angle, Utc, seconds};

use super::instrument::{CommandSender, Instrument};
use crate::action_error::ActionError;
use crate::command_timeout::command_timeout;
use crate::took::took_s;

/// Slews over less than this are not reported, deg.
const WORTH_REPORTING_DEG: f64 = 1.0;

/// A mount that was told to end its tracking has so long to show it, machine time.
const ENDS_TRACKING: Duration = Duration::from_secs(10);
/// It is told so often before it is parked.
const TOLD: u32 = 2;
/// A mount that is being stopped at a limit is slewed when that is over, at most after this, machine time.
const STOPPING: Duration = Duration::from_secs(60);

/// A mount.
pub struct Mount {
    /// The device.
    pub instrument: Instrument<telescope::Telescope>,
    /// Its configuration.
    pub config: config::Telescope,
    /// What its site leaves of the sky.
    pub horizon_limits: HorizonLimits,
    /// Where it was when the last slew of this node had ended, by its own coordinates.
    kept: Mutex<Option<KeptPlace>>,
}

impl Mount {
    /// Subscribes to a mount.
    pub async fn listen(
        command_sender: &CommandSender,
        device: Device,
        config: config::Telescope,
        horizon_limits: HorizonLimits,
    ) -> anyhow::Result<Self> {
        let instrument = Instrument::listen(command_sender, device).await?;
        Ok(Self { instrument, config, horizon_limits, kept: Mutex::default() })
    }

    /// Leaves the park position, unless the mount is known to be out of it or to have none.
    pub async fn unpark(&self) -> Result<(), ActionError> {
        let parked = self.instrument.fresh_reading("AtPark").and_then(|state| state.fields.at_park.known().copied());
        let cannot = self.instrument.can().is_some_and(|can| !can.park);
        if parked == Some(false) || cannot {
            return Ok(());
        }
        self.instrument.execute(Command::Unpark, self.slew_timeout()).await.map(|_| ())
    }

    /// Switches tracking.
    pub async fn track(&self, on: bool) -> Result<(), ActionError> {
        let tracking = self.instrument.fresh().and_then(|state| state.fields.tracking.known().copied());
        if tracking == Some(on) {
            return Ok(());
        }
        self.instrument.execute(Command::Track { on }, Duration::from_secs(60)).await.map(|_| ())
    }

    /// Slews to a place of the catalogue, tracks it, and returns when the mount has settled, for which its device node
    /// waits. Every slew of this node goes through here, and none goes beyond the mount's limits.
    pub async fn point(&self, target: &Icrs, observer: &Observer) -> Result<(), ActionError> {
        if let Some(why) = slew_limits::beyond(&self.config.limits, target, observer) {
            return Err(ActionError::Impossible(why));
        }
        if self.config.equatorial_system == EquatorialChoice::Auto {
            self.instrument.capabilities_with(&["EquatorialSystem"]).await?;
        }
        let (ra, dec) = in_mount_frame(target, observer, self.frame())?;
        self.until_stopped().await?;
        self.keep_place(false);
        self.unpark().await?;
        self.track(true).await?;
        let slew = Command::Slew { ra_deg: ra.degrees(), dec_deg: dec.degrees() };
        let (began, way_deg) = (self.instrument.clock().utc(), self.way_deg(ra, dec));
        self.instrument.execute(slew, self.slew_timeout()).await?;
        // Some mounts drop tracking with a slew.
        self.track(true).await?;
        self.keep_place(true);
        // Small corrections come with frames, and would fill the diary.
        if let Some(deg) = way_deg.filter(|deg| *deg >= WORTH_REPORTING_DEG) {
            let took_s = took_s(self.instrument.clock(), began);
            let (deg, device) = ((10.0 * deg).round() / 10.0, self.instrument.device.to_string());
            tracing::info!(deg, device, span = TimedPart::Slew.word(), took_s, "{TOOK}");
        }
        Ok(())
    }

    /// Remembers the place that it reports now as the one that it was sent to, or forgets that.
    pub fn keep_place(&self, is_there: bool) {
        let now = self.instrument.clock().utc();
        let kept = self.reported_deg().filter(|_| is_there).map(|[ra, dec]| KeptPlace::new(ra, dec, now));
        *self.kept.lock().unwrap_or_else(PoisonError::into_inner) = kept;
    }

    /// How far it has left the place that this node sent it to, by its own coordinates, arcmin; `None` while it is there
    /// or nobody knows.
    pub fn left_by_arcmin(&self, is_guided: bool) -> Option<f64> {
        let kept = (*self.kept.lock().unwrap_or_else(PoisonError::into_inner))?;
        let [ra, dec] = self.reported_deg()?;
        kept.left_by_arcmin(ra, dec, self.instrument.clock().utc(), is_guided)
    }

    /// Right ascension and declination that it reports, in its own frame, while it does not slew.
    fn reported_deg(&self) -> Option<[f64; 2]> {
        let fields = self.instrument.fresh_reading("RightAscension")?.fields;
        if fields.slewing.known() == Some(&true) {
            return None;
        }
        Some([*fields.ra_deg.known()?, *fields.dec_deg.known()?])
    }

    /// Why its device node stops it, while it does.
    pub fn is_stopped_for(&self) -> Option<BeyondLimit> {
        self.instrument.fresh()?.fields.beyond_limit
    }

    /// Waits while its device node stops it at a limit: a slew in between would be stopped too.
    async fn until_stopped(&self) -> Result<(), ActionError> {
        let Some(beyond) = self.is_stopped_for() else { return Ok(()) };
        let stands = self.instrument.until(STOPPING, "stopped at its limit", |received| {
            received.sample.body.fields.beyond_limit.is_none().then_some(())
        });
        stands.await.map_err(|_| self.stopped_at(&beyond))
    }

    /// That it is stopped at a limit, as an error of the step that wants it to go on.
    pub fn stopped_at(&self, beyond: &BeyondLimit) -> ActionError {
        let (device, reason) =
            (self.instrument.device.to_string(), format!("it is stopped at a limit: {}", beyond.why));
        ActionError::Failed { device, verb: "follow the sky".to_owned(), reason }
    }

    /// Tells it to track although it says that it does: it stands.
    pub async fn track_anew(&self) {
        if let Err(error) = self.instrument.execute(Command::Track { on: true }, Duration::from_secs(60)).await {
            tracing::warn!(%error, "the mount was not told anew to track; the slew decides");
        }
    }

    /// Ends its tracking after a row. A mount that goes on is told again, and then parked; returns that in words.
    pub async fn rest(&self) -> Result<(), String> {
        let name = &self.instrument.device.name;
        let mut why = String::new();
        for _ in 0..TOLD {
            match self.end_tracking().await {
                Ok(()) => return Ok(()),
                Err(error) => why = error.to_string(),
            }
        }
        // One that does not answer is told of by another alert, and may track or not.
        let is_silent = self.instrument.fresh().is_none();
        if self.instrument.can().is_some_and(|can| !can.park) {
            return Err(format!("{name} goes on tracking, was told {TOLD} times, and cannot park: {why}"));
        }
        match self.instrument.execute(Command::Park, self.slew_timeout()).await {
            Ok(_) if is_silent => Ok(()),
            Ok(_) => {
                Err(format!("{name} went on tracking after it was told {TOLD} times to stop, and was parked for it"))
            }
            Err(park) => {
                Err(format!("{name} goes on tracking, was told {TOLD} times, and does not park ({park}): {why}"))
            }
        }
    }

    async fn end_tracking(&self) -> Result<(), ActionError> {
        let stands = |fields: &telescope::Fields| fields.tracking.known() == Some(&false);
        if self.instrument.fresh().is_some_and(|state| stands(&state.fields)) {
            return Ok(());
        }
        let id = CommandId::fresh();
        self.instrument.ask_in_turn(&id, Command::Track { on: false }).await?;
        let (mut seen, what) = (false, "seen to end its tracking");
        let ended = self.instrument.until(ENDS_TRACKING, what, |received| {
            let state = &received.sample.body;
            // A state from before the command shows nothing of it.
            seen |= state.last_command.as_ref().is_some_and(|last| last.id == id);
            (seen && stands(&state.fields)).then_some(())
        });
        ended.await
    }

    /// How far it is from where it looks to a place of its own frame, deg.
    fn way_deg(&self, ra: Angle, dec: Angle) -> Option<f64> {
        let fields = self.instrument.fresh()?.fields;
        let here = Icrs::from_degrees(*fields.ra_deg.known()?, *fields.dec_deg.known()?);
        Some(separation(&here, &Icrs { ra, dec }).degrees()).filter(|deg| deg.is_finite())
    }

    /// Moves at these rates relative to the stars. Returns when the device node had accepted them; its mount then does
    /// so at once.
    pub async fn set_rates(&self, rates: Rates) -> Result<Utc, ActionError> {
        let Rates { ra_s_per_sidereal_s, dec_arcsec_per_s } = rates;
        let (id, clock) = (CommandId::fresh(), self.instrument.clock());
        self.instrument.ask_in_turn(&id, Command::Rates { ra_s_per_sidereal_s, dec_arcsec_per_s }).await?;
        let taken = clock.utc();
        self.instrument.done(&id, "rates", command_timeout(clock, Duration::from_secs(60))).await?;
        Ok(taken)
    }

    /// A place of the catalogue in the mount's own frame.
    pub fn place(&self, target: &Icrs, observer: &Observer) -> Result<(Angle, Angle), ActionError> {
        in_mount_frame(target, observer, self.frame())
    }

    /// Synchronises the mount: it looks at this place of the catalogue now.
    pub async fn sync(&self, seen: &Icrs, observer: &Observer) -> Result<(), ActionError> {
        let (ra, dec) = in_mount_frame(seen, observer, self.frame())?;
        let sync = Command::Sync { ra_deg: ra.degrees(), dec_deg: dec.degrees() };
        // Its coordinates jump, and it stays where it is.
        self.keep_place(false);
        self.instrument.execute(sync, Duration::from_secs(60)).await.map(|_| ())
    }

    /// The frame of its coordinates, as far as it is known yet.
    pub fn frame(&self) -> EquatorialSystem {
        self.config.equatorial_system.of(self.instrument.can().map(|can| can.equatorial_system))
    }

    fn slew_timeout(&self) -> Duration {
        seconds(self.config.slew_timeout_s)
    }
}

/// A place of the catalogue in the mount's own frame.
fn in_mount_frame(target: &Icrs, observer: &Observer, system: EquatorialSystem) -> Result<(Angle, Angle), ActionError> {
    match system {
        EquatorialSystem::Topocentric => {
            let apparent = observer.to_of_date(target);
            Ok((apparent.ra, apparent.dec))
        }
        EquatorialSystem::J2000 | EquatorialSystem::Other => Ok((target.ra, target.dec)),
        EquatorialSystem::J2050 | EquatorialSystem::B1950 => Err(ActionError::Impossible(format!(
            "the mount wants coordinates of {}, which is not supported; set equatorial_system to \
             \"j2000\" or \"topocentric\" in its block",
            if system == EquatorialSystem::B1950 { "B1950" } else { "J2050" }
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
        // 27 years of precession are about a third of a degree.
        assert!((0.2..0.5).contains(&(ra.degrees() - 78.0)), "{}", ra.degrees());
        assert!(in_mount_frame(&target, &observer, EquatorialSystem::B1950).is_err());
    }
}
