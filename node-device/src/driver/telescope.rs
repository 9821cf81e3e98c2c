//! The mount.

use std::time::Duration;

use contract::device::telescope::{self, Capabilities, Command, Direction, EquatorialSystem, Fields, PierSide};
use contract::{CommandId, Datum, Reason};

use super::{Driver, Need, Obeyed, Progress, apart_deg, can, optional, within};
use crate::alpaca::{Alpaca, AlpacaError, value};
use crate::readings::Readings;

/// A mount that stands still farther from its target than this has not reached it; generous, because mounts
/// report positions after their own pointing model.
const AT_TARGET_DEG: f64 = 0.5;

/// Drives a mount.
pub struct Telescope {
    /// A slew that takes longer has failed, sky s.
    pub slew_timeout_s: f64,
    /// A slew is done when the mount has stood for so long, sky s.
    pub settle_s: f64,
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

    async fn capabilities(&self, alpaca: &Alpaca) -> Result<Capabilities, AlpacaError> {
        let set_rates = can(alpaca, "cansetrightascensionrate").await? && can(alpaca, "cansetdeclinationrate").await?;
        let system = optional(alpaca, "equatorialsystem", value::whole).await?.unwrap_or(0);
        Ok(Capabilities {
            park: can(alpaca, "canpark").await?,
            slew_async: can(alpaca, "canslewasync").await?,
            set_tracking: can(alpaca, "cansettracking").await?,
            pulse_guide: can(alpaca, "canpulseguide").await?,
            sync: can(alpaca, "cansync").await?,
            set_rates,
            equatorial_system: match system {
                1 => EquatorialSystem::Topocentric,
                2 => EquatorialSystem::J2000,
                3 => EquatorialSystem::J2050,
                4 => EquatorialSystem::B1950,
                _ => EquatorialSystem::Other,
            },
            site_latitude_deg: optional(alpaca, "sitelatitude", value::number).await?.into(),
            site_longitude_deg: optional(alpaca, "sitelongitude", value::number).await?.into(),
            site_elevation_m: optional(alpaca, "siteelevation", value::number).await?.into(),
        })
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
        }
    }

    fn is_busy(&self, fields: &Fields) -> bool {
        // a mount that cannot be guided does not know IsPulseGuiding
        fields.slewing.known() != Some(&false) || fields.pulse_guiding.known() == Some(&true)
    }

    fn need(&self, command: &Command) -> Need {
        match command {
            Command::Abort => Need::Nothing,
            Command::Park | Command::Track { on: false } => Need::TokenWhileSafe,
            Command::Slew { .. }
            | Command::Track { on: true }
            | Command::Unpark
            | Command::PulseGuide { .. }
            | Command::Sync { .. } => Need::Token,
            Command::Claim => Need::Claim,
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
            Command::Track { .. } | Command::Abort | Command::Park | Command::Unpark | Command::Claim => None,
        }
    }

    async fn obey(
        &self,
        alpaca: &Alpaca,
        _: &CommandId,
        command: &Command,
        fields: &Fields,
    ) -> Result<Obeyed, AlpacaError> {
        match command {
            Command::Slew { ra_deg, dec_deg } => {
                if fields.tracking.known() == Some(&false) {
                    // ASCOM refuses equatorial slews of a mount that does not track
                    alpaca.put("tracking", &[("Tracking", "True")]).await?;
                }
                let (hours, degrees) = (hours(*ra_deg), dec_deg.to_string());
                let target = [("RightAscension", hours.as_str()), ("Declination", degrees.as_str())];
                alpaca.put("slewtocoordinatesasync", &target).await?;
            }
            Command::Sync { ra_deg, dec_deg } => {
                let (hours, degrees) = (hours(*ra_deg), dec_deg.to_string());
                let target = [("RightAscension", hours.as_str()), ("Declination", degrees.as_str())];
                alpaca.put("synctocoordinates", &target).await?;
                return Ok(Obeyed::Done);
            }
            Command::Track { on } => {
                alpaca.put("tracking", &[("Tracking", if *on { "True" } else { "False" })]).await?
            }
            Command::Abort => alpaca.put("abortslew", &[]).await?,
            Command::Park => {
                if fields.slewing.known() != Some(&false) {
                    // some mounts refuse to park while they slew; the park itself decides
                    let _ = alpaca.put("abortslew", &[]).await;
                }
                alpaca.put("park", &[]).await?;
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
                // some mounts answer only when the pulse is over
                let deadline = pulse + Duration::from_secs(5);
                let parameters = [("Direction", direction), ("Duration", duration.as_str())];
                alpaca.put_within("pulseguide", &parameters, deadline).await?;
            }
            Command::Claim => return Ok(Obeyed::Done),
        }
        Ok(Obeyed::Watch)
    }

    fn limit(&self, command: &Command) -> Duration {
        match command {
            Command::Slew { .. } | Command::Park => Duration::from_secs_f64(self.slew_timeout_s.clamp(1.0, 86_400.0)),
            Command::PulseGuide { duration_ms, .. } => Duration::from_millis(u64::from(*duration_ms) + 5000),
            Command::Track { .. } | Command::Abort | Command::Unpark | Command::Sync { .. } | Command::Claim => {
                Duration::from_secs(60)
            }
        }
    }

    fn progress(&self, command: &Command, fields: &Fields) -> Progress {
        match command {
            Command::Slew { ra_deg, dec_deg } => match (fields.slewing.known(), &fields.ra_deg, &fields.dec_deg) {
                (Some(false), Datum::Known(ra), Datum::Known(dec)) => {
                    let across = apart_deg(*ra, *ra_deg) * dec_deg.to_radians().cos();
                    let distance = across.hypot(dec - dec_deg);
                    // right after the command some mounts do not say yet that they slew, so this is no failure
                    if distance <= AT_TARGET_DEG { Progress::Settling(self.settle_s) } else { Progress::Running }
                }
                _ => Progress::Running,
            },
            Command::Track { on } => Progress::done_if(fields.tracking.known() == Some(on)),
            Command::Abort => Progress::done_if(fields.slewing.known() == Some(&false)),
            Command::Park => Progress::done_if(fields.at_park.known() == Some(&true)),
            Command::Unpark => Progress::done_if(fields.at_park.known() == Some(&false)),
            Command::PulseGuide { .. } => Progress::done_if(fields.pulse_guiding.known() != Some(&true)),
            Command::Sync { .. } | Command::Claim => Progress::Done,
        }
    }
}

/// Right ascension as ASCOM wants it, hours in [0, 24).
fn hours(ra_deg: f64) -> String {
    units::Angle::from_degrees(ra_deg).wrapped_positive().hours().to_string()
}
