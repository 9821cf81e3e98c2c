//! The mount.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use alpaca::{Abilities, Alpaca, AlpacaError, value};
use bus::{Clock, MachineTime};
use config::VendorPattern;
use contract::device::telescope::{
    self, BeyondLimit, Capabilities, Command, Direction, EquatorialSystem, Fields, PierSide,
};
use contract::{CommandId, Datum, Reason};
use interlock::{Hinders, Need};

use super::{Driver, Executed, Progress, UNREADABLE_S, apart_deg, vendor, within};
use crate::mount_sight::{MountSight, Ordered};
use crate::now::Now;
use crate::readings::Readings;

/// The fastest that a mount may move relative to the stars, arcsec per second: a satellite at 300 km overhead needs
/// 5000.
const MOST_ARCSEC_PER_S: f64 = 20_000.0;
/// The same in right ascension, s per sidereal second: near the pole that coordinate runs faster.
const MOST_RA_S_PER_SIDEREAL_S: f64 = 20_000.0;

/// No mount guides faster: this is 240 times as fast as the stars, degrees per second.
const MOST_GUIDE_DEG_PER_S: f64 = 1.0;

/// A pulse that takes so long is seen as one for long.
const LONG_PULSE_MS: u32 = 15_000;

/// A mount that parks is asked to forget its rates no longer than this.
const END_RATES: Duration = Duration::from_secs(2);

/// Drives a mount.
pub struct Telescope {
    /// A slew that takes longer has failed, sky s.
    slew_timeout_s: f64,
    /// A slew is done when the mount has stood for so long, sky s.
    settle_s: f64,
    /// A mount that stands still farther from its target than this has not reached it, degrees.
    tolerance_deg: f64,
    /// What of its maker's own it may be sent.
    vendor_commands: Vec<VendorPattern>,
    /// Rates relative to the stars may be set: ours, or those that another program set before this node began.
    may_drift: AtomicBool,
    /// This node has set rates other than zero.
    has_set: AtomicBool,
    /// The clock of orders and readings.
    clock: Clock,
    /// What was read last, for the watch of the limits.
    sight: Mutex<MountSight>,
    /// The newest order, and when it was given or answered.
    ordered: Mutex<Option<(Ordered, MachineTime)>>,
    /// What the watch of the limits has found.
    beyond_limit: Mutex<Option<BeyondLimit>>,
}

impl Telescope {
    /// A driver by its block of the configuration.
    pub fn new(mount: &config::Telescope, clock: Clock) -> Self {
        Self {
            slew_timeout_s: mount.slew_timeout_s,
            settle_s: mount.settle_s,
            tolerance_deg: mount.arrival_tolerance_deg,
            vendor_commands: mount.vendor_commands.clone(),
            may_drift: AtomicBool::new(true),
            has_set: AtomicBool::new(false),
            clock,
            sight: Mutex::default(),
            ordered: Mutex::default(),
            beyond_limit: Mutex::default(),
        }
    }

    /// The mount as it was read last, with the newest order to it.
    pub fn sight(&self) -> MountSight {
        let sight = *self.sight.lock().unwrap_or_else(PoisonError::into_inner);
        MountSight { ordered: *self.ordered.lock().unwrap_or_else(PoisonError::into_inner), ..sight }
    }

    /// Publishes that the mount is stopped at a limit, or not any more.
    pub fn set_beyond_limit(&self, beyond: Option<BeyondLimit>) {
        *self.beyond_limit.lock().unwrap_or_else(PoisonError::into_inner) = beyond;
    }

    /// Notes an order to the mount: what was read before shows nothing of it.
    fn note_order(&self, command: &Command) {
        let ordered = match command {
            Command::Slew { .. } | Command::Park => Ordered::Go,
            Command::Unpark | Command::Track { on: true } | Command::Sync { .. } => Ordered::Begin,
            Command::Track { on: false } | Command::Abort => Ordered::Stop,
            Command::PulseGuide { .. } | Command::Rates { .. } | Command::Vendor(_) | Command::Claim => return,
        };
        *self.ordered.lock().unwrap_or_else(PoisonError::into_inner) = Some((ordered, self.clock.machine()));
    }

    /// Sets both rates relative to the stars.
    async fn set_rates(&self, alpaca: &Alpaca, ra: f64, dec: f64) -> Result<(), AlpacaError> {
        self.may_drift.store(true, Ordering::Relaxed);
        self.has_set.fetch_or(ra != 0.0 || dec != 0.0, Ordering::Relaxed);
        alpaca.put("rightascensionrate", &[("RightAscensionRate", ra.to_string().as_str())]).await?;
        alpaca.put("declinationrate", &[("DeclinationRate", dec.to_string().as_str())]).await?;
        // Forgotten only when both are known to be zero.
        self.may_drift.store(ra != 0.0 || dec != 0.0, Ordering::Relaxed);
        Ok(())
    }

    /// Lets the mount follow the stars again, where it may do otherwise.
    async fn end_rates(&self, alpaca: &Alpaca) -> Result<(), AlpacaError> {
        if !self.may_drift.load(Ordering::Relaxed) {
            return Ok(());
        }
        match self.set_rates(alpaca, 0.0, 0.0).await {
            // It has no rates, or refuses them; this node has set none, and the mount goes where it is sent.
            Err(error) if error.is_ascom() && !self.has_set.load(Ordering::Relaxed) => {
                tracing::debug!(%error, "the mount refuses rates of zero");
                self.may_drift.store(false, Ordering::Relaxed);
                Ok(())
            }
            ended => ended,
        }
    }

    /// Sends a command.
    async fn send(&self, alpaca: &Alpaca, command: &Command, fields: &Fields) -> Result<Executed, AlpacaError> {
        match command {
            Command::Slew { ra_deg, dec_deg } => {
                if fields.tracking.known() == Some(&false) {
                    // ASCOM refuses equatorial slews of a mount that does not track.
                    alpaca.put("tracking", &[("Tracking", "True")]).await?;
                }
                self.end_rates(alpaca).await?;
                let (hours, degrees) = (hours(*ra_deg), dec_deg.to_string());
                let target = [("RightAscension", hours.as_str()), ("Declination", degrees.as_str())];
                alpaca.put("slewtocoordinatesasync", &target).await?;
            }
            Command::Sync { ra_deg, dec_deg } => {
                let (hours, degrees) = (hours(*ra_deg), dec_deg.to_string());
                let target = [("RightAscension", hours.as_str()), ("Declination", degrees.as_str())];
                alpaca.put("synctocoordinates", &target).await?;
                return Ok(Executed::Done);
            }
            Command::Track { on } => {
                alpaca.put("tracking", &[("Tracking", if *on { "True" } else { "False" })]).await?;
                match self.end_rates(alpaca).await {
                    // A mount that stands goes nowhere; the next slew ends its rates.
                    Err(error) if !on => tracing::debug!(%error, "rates of a moving target are still set"),
                    ended => ended?,
                }
            }
            Command::Rates { ra_s_per_sidereal_s, dec_arcsec_per_s } => {
                self.set_rates(alpaca, *ra_s_per_sidereal_s, *dec_arcsec_per_s).await?;
                return Ok(Executed::Done);
            }
            Command::Abort => alpaca.put("abortslew", &[]).await?,
            Command::Park => {
                let says_parked = fields.at_park.known() == Some(&true);
                // One that says that it is parked while it slews is on its way there: an abort would leave it elsewhere.
                if fields.slewing.known() != Some(&false) && !says_parked {
                    // Some mounts refuse to park while they slew; the park itself decides.
                    let _ = alpaca.put("abortslew", &[]).await;
                }
                if says_parked && fields.tracking.known() == Some(&true) {
                    // A second park may do nothing.
                    let _ = alpaca.put("tracking", &[("Tracking", "False")]).await;
                }
                alpaca.put("park", &[]).await?;
                // The park goes on meanwhile, whatever becomes of this; what is left of rates, the next slew ends.
                let _ = tokio::time::timeout(END_RATES, self.end_rates(alpaca)).await;
            }
            Command::Unpark => alpaca.put("unpark", &[]).await?,
            Command::PulseGuide { direction, duration_ms } => {
                let direction = match direction {
                    Direction::North => "0",
                    Direction::South => "1",
                    Direction::East => "2",
                    Direction::West => "3",
                };
                let pulse = Duration::from_millis(u64::from(*duration_ms));
                let duration = duration_ms.to_string();
                // Some mounts answer only when the pulse is over.
                let deadline = pulse + Duration::from_secs(5);
                let parameters = [("Direction", direction), ("Duration", duration.as_str())];
                alpaca.put_within("pulseguide", &parameters, deadline).await?;
            }
            Command::Vendor(command) => return vendor::execute(alpaca, command).await,
            Command::Claim => return Ok(Executed::Done),
        }
        Ok(Executed::Watch)
    }
}

impl Driver for Telescope {
    type Kind = telescope::Telescope;

    fn polled(&self) -> Vec<String> {
        [
            "RightAscension",
            "Declination",
            "Altitude",
            "Azimuth",
            "Tracking",
            "Slewing",
            "AtPark",
            "SideOfPier",
            "IsPulseGuiding",
        ]
        .map(str::to_owned)
        .to_vec()
    }

    fn moving(&self) -> &'static [&'static str] {
        &["RightAscension", "Declination", "Tracking", "Slewing", "AtPark", "IsPulseGuiding"]
    }

    async fn capabilities(&self, abilities: &mut Abilities) -> Result<Capabilities, AlpacaError> {
        let ra_rate = abilities.can("CanSetRightAscensionRate").await?;
        let set_rates = abilities.can("CanSetDeclinationRate").await? && ra_rate;
        if !set_rates {
            self.may_drift.store(false, Ordering::Relaxed);
        }
        let system = abilities.read("EquatorialSystem", value::whole).await?.unwrap_or(0);
        Ok(Capabilities {
            park: abilities.can("CanPark").await?,
            slew_async: abilities.can("CanSlewAsync").await?,
            set_tracking: abilities.can("CanSetTracking").await?,
            pulse_guide: abilities.can("CanPulseGuide").await?,
            sync: abilities.can("CanSync").await?,
            set_rates,
            equatorial_system: match system {
                1 => EquatorialSystem::Topocentric,
                2 => EquatorialSystem::J2000,
                3 => EquatorialSystem::J2050,
                4 => EquatorialSystem::B1950,
                _ => EquatorialSystem::Other,
            },
            site_latitude_deg: abilities.read("SiteLatitude", value::number).await?.into(),
            site_longitude_deg: abilities.read("SiteLongitude", value::number).await?.into(),
            site_elevation_m: abilities.read("SiteElevation", value::number).await?.into(),
            guide_rate_ra_deg_per_s: guide_rate(abilities, "GuideRateRightAscension").await?,
            guide_rate_dec_deg_per_s: guide_rate(abilities, "GuideRateDeclination").await?,
        })
    }

    fn observed(&self, readings: &Readings, _: Now) {
        let sight = MountSight::of(readings, self.fields(readings), None);
        *self.sight.lock().unwrap_or_else(PoisonError::into_inner) = sight;
    }

    fn fields(&self, readings: &Readings) -> Fields {
        let side = [(0, PierSide::East), (1, PierSide::West), (-1, PierSide::Unknown)];
        Fields {
            ra_deg: readings.number("RightAscension").map(|hours| hours * 15.0),
            dec_deg: readings.number("Declination"),
            altitude_deg: readings.number("Altitude"),
            azimuth_deg: readings.number("Azimuth"),
            tracking: readings.flag("Tracking"),
            slewing: readings.flag("Slewing"),
            at_park: readings.flag("AtPark"),
            pier_side: readings.choice("SideOfPier", &side),
            pulse_guiding: readings.flag("IsPulseGuiding"),
            beyond_limit: self.beyond_limit.lock().unwrap_or_else(PoisonError::into_inner).clone(),
        }
    }

    fn is_busy(&self, fields: &Fields) -> bool {
        // A mount that cannot be guided does not know IsPulseGuiding.
        fields.slewing.known() != Some(&false) || fields.pulse_guiding.known() == Some(&true)
    }

    fn works_at(&self, command: &Command, fields: &Fields) -> bool {
        match command {
            Command::PulseGuide { .. } => fields.pulse_guiding.known() == Some(&true),
            Command::Slew { .. } | Command::Park | Command::Unpark | Command::Abort => {
                fields.slewing.known() != Some(&false)
            }
            Command::Track { .. }
            | Command::Rates { .. }
            | Command::Sync { .. }
            | Command::Vendor(_)
            | Command::Claim => false,
        }
    }

    fn contradiction(&self, command: Option<&Command>, fields: &Fields) -> Option<String> {
        // A guided mount is between two pulses now and then.
        let long = |command: &Command| matches!(command, Command::PulseGuide { duration_ms, .. } if *duration_ms >= LONG_PULSE_MS);
        if fields.pulse_guiding.known() == Some(&true) && !command.is_some_and(long) {
            return Some("IsPulseGuiding stays true, and no pulse takes so long".to_owned());
        }
        let parked_slewing = fields.at_park.known() == Some(&true) && fields.slewing.known() == Some(&true);
        (command.is_none() && parked_slewing).then(|| "AtPark and Slewing are both true".to_owned())
    }

    fn need(&self, command: &Command) -> Need {
        match command {
            Command::Abort => Need::Nothing,
            Command::Park | Command::Track { on: false } => Need::TokenWhileSafe,
            Command::Rates { ra_s_per_sidereal_s: 0.0, dec_arcsec_per_s: 0.0 } => Need::TokenWhileSafe,
            Command::Slew { .. }
            | Command::Track { on: true }
            | Command::Unpark
            | Command::PulseGuide { .. }
            | Command::Rates { .. }
            | Command::Sync { .. }
            | Command::Vendor(_) => Need::Token,
            Command::Claim => Need::Claim,
        }
    }

    fn hinders(&self, command: &Command) -> Hinders {
        match command {
            // The park that a roof waits for is begun by a stop of its own.
            Command::Abort => Hinders::Yes,
            Command::Track { on: false } => Hinders::FromOthers,
            Command::Slew { .. } | Command::Track { on: true } | Command::Unpark => Hinders::FromTheUnaware,
            Command::Park
            | Command::PulseGuide { .. }
            | Command::Rates { .. }
            | Command::Sync { .. }
            | Command::Vendor(_)
            | Command::Claim => Hinders::No,
        }
    }

    fn interrupts(&self, command: &Command) -> bool {
        matches!(command, Command::Abort | Command::Park | Command::Track { on: false })
    }

    fn refuse(
        &self,
        _: &CommandId,
        command: &Command,
        can: &Capabilities,
        fields: &Fields,
    ) -> Option<(Reason, String)> {
        let parked = fields.at_park.known() == Some(&true);
        let not = |what: &str| Some((Reason::NotImplemented, format!("this mount cannot {what}")));
        match command {
            Command::Slew { ra_deg, dec_deg } | Command::Sync { ra_deg, dec_deg } => {
                let bad = within("ra_deg", *ra_deg, 0.0, 360.0).or_else(|| within("dec_deg", *dec_deg, -90.0, 90.0));
                match command {
                    _ if bad.is_some() => bad,
                    _ if parked => Some((Reason::WrongState, "the mount is parked; unpark it first".to_owned())),
                    Command::Slew { .. } if !can.slew_async => not("slew without blocking"),
                    Command::Sync { .. } if !can.sync => not("be synced"),
                    _ => None,
                }
            }
            Command::Track { on } if !can.set_tracking && fields.tracking.known() != Some(on) => not("switch tracking"),
            Command::Track { on: true } if parked => {
                Some((Reason::WrongState, "the mount is parked; unpark it first".to_owned()))
            }
            Command::Park if !can.park => not("park"),
            Command::PulseGuide { .. } if !can.pulse_guide => not("take guide pulses"),
            Command::PulseGuide { duration_ms, .. } => within("duration_ms", f64::from(*duration_ms), 1.0, 60_000.0),
            Command::Rates { ra_s_per_sidereal_s: ra, dec_arcsec_per_s: dec } => {
                let bad = within("ra_s_per_sidereal_s", *ra, -MOST_RA_S_PER_SIDEREAL_S, MOST_RA_S_PER_SIDEREAL_S)
                    .or_else(|| within("dec_arcsec_per_s", *dec, -MOST_ARCSEC_PER_S, MOST_ARCSEC_PER_S));
                let stands = fields.tracking.known() == Some(&false) && (*ra != 0.0 || *dec != 0.0);
                match bad {
                    Some(bad) => Some(bad),
                    None if !can.set_rates => {
                        not("follow moving targets (CanSetRightAscensionRate or CanSetDeclinationRate is false)")
                    }
                    None if stands => Some((Reason::WrongState, "the mount does not track".to_owned())),
                    None => None,
                }
            }
            Command::Vendor(command) => vendor::refuse(&[&self.vendor_commands], command),
            Command::Track { .. } | Command::Abort | Command::Park | Command::Unpark | Command::Claim => None,
        }
    }

    async fn execute(
        &self,
        alpaca: &Alpaca,
        _: &CommandId,
        command: &Command,
        fields: &Fields,
    ) -> Result<Executed, AlpacaError> {
        self.note_order(command);
        let executed = self.send(alpaca, command, fields).await;
        self.note_order(command);
        executed
    }

    fn limit(&self, command: &Command) -> Duration {
        match command {
            Command::Slew { .. } | Command::Park => Duration::from_secs_f64(self.slew_timeout_s.clamp(1.0, 86_400.0)),
            Command::PulseGuide { duration_ms, .. } => Duration::from_millis(u64::from(*duration_ms) + 5000),
            Command::Track { .. }
            | Command::Abort
            | Command::Unpark
            | Command::Sync { .. }
            | Command::Rates { .. }
            | Command::Vendor(_)
            | Command::Claim => Duration::from_secs(60),
        }
    }

    fn progress(&self, command: &Command, fields: &Fields) -> Progress {
        match command {
            Command::Slew { ra_deg, dec_deg } => match (&fields.ra_deg, &fields.dec_deg) {
                (Datum::Known(ra), Datum::Known(dec)) => {
                    let across = apart_deg(*ra, *ra_deg) * dec_deg.to_radians().cos();
                    let distance = across.hypot(dec - dec_deg);
                    match fields.slewing.known() {
                        _ if distance <= self.tolerance_deg => Progress::there(&fields.slewing, self.settle_s),
                        // Right after the command some mounts do not report yet that they slew.
                        Some(false) => Progress::Stranded {
                            off: distance / self.tolerance_deg,
                            why: format!(
                                "it rests {distance:.2} deg from where it was sent (arrival_tolerance_deg = {})",
                                self.tolerance_deg
                            ),
                        },
                        _ => Progress::Running,
                    }
                }
                _ => Progress::Running,
            },
            // The next steps show whether it was done: a mount that is parked refuses to slew, and stars trail without tracking.
            Command::Track { on: true } if fields.tracking.is_refused() => Progress::Settling(UNREADABLE_S),
            Command::Unpark if fields.at_park.is_refused() => Progress::Settling(UNREADABLE_S),
            Command::Track { on } => Progress::done_if(fields.tracking.known() == Some(on)),
            Command::Abort => Progress::rests(&fields.slewing),
            Command::Park if fields.at_park.is_refused() => parks_unseen(fields),
            Command::Park => Progress::done_if(fields.parked() == Some(true)),
            Command::Unpark => Progress::done_if(fields.at_park.known() == Some(&false)),
            Command::PulseGuide { .. } => Progress::done_if(fields.pulse_guiding.known() != Some(&true)),
            Command::Vendor(_) => Progress::Failed(vendor::UNANSWERED.to_owned()),
            Command::Sync { .. } | Command::Rates { .. } | Command::Claim => Progress::Done,
        }
    }
}

/// How far the park is of a mount whose driver does not tell whether it is parked: in the end it neither slews nor tracks.
fn parks_unseen(fields: &Fields) -> Progress {
    let has_ended = |flag: &Datum<bool>| flag.known() == Some(&false) || flag.is_refused();
    if has_ended(&fields.slewing) && has_ended(&fields.tracking) {
        Progress::Settling(UNREADABLE_S)
    } else {
        Progress::Running
    }
}

/// A guide rate, degrees per second; `None` if it is no speed.
async fn guide_rate(abilities: &mut Abilities, property: &str) -> Result<Option<f64>, AlpacaError> {
    let rate = abilities.read(property, value::number_in(0.0..=MOST_GUIDE_DEG_PER_S)).await?;
    Ok(rate.ok().filter(|rate| *rate > 0.0))
}

/// Right ascension as ASCOM wants it, hours in [0, 24).
fn hours(ra_deg: f64) -> String {
    units::Angle::from_degrees(ra_deg).wrapped_positive().hours().to_string()
}
