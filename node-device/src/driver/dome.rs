//! The dome or roof; who may open it is the guard's business.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use alpaca::{Abilities, Alpaca, AlpacaError};
use bus::Clock;
use config::VendorPattern;
use contract::device::dome::{self, Capabilities, Command, Fields, Shutter};
use contract::{CommandId, NoData, Reason};
use interlock::{Guard, Hinders, Need};
use tokio::sync::watch;

use super::{Driver, Executed, Progress, apart_deg, vendor, within};
use crate::guard_task::Seen;
use crate::now::Now;
use crate::readings::Readings;
use crate::shutter_status::SHUTTER;

/// A dome that rests so near to where it was sent is there.
const THERE_DEG: f64 = 2.0;
/// One that rests so long within its tolerance has ended its turn, sky s: some begin to move late.
const RESTS_S: f64 = 5.0;

/// Drives a dome.
pub struct Dome {
    /// A shutter that moves longer is stuck, sky s.
    pub travel_timeout_s: f64,
    /// A turn that ends so near is done, degrees.
    pub tolerance_deg: f64,
    /// Its guard.
    pub guard: Arc<Mutex<Guard>>,
    /// The clock that permits are judged by.
    pub clock: Clock,
    /// Where the guard sees what this driver reads.
    pub eye: watch::Sender<Seen>,
    /// What of its maker's own it may be sent under a permit.
    pub vendor_commands: Vec<VendorPattern>,
    /// What it may be sent without one.
    pub vendor_commands_to_close: Vec<VendorPattern>,
}

impl Dome {
    async fn close(&self, alpaca: &Alpaca, fields: &Fields) -> Result<(), AlpacaError> {
        match alpaca.put("closeshutter", &[]).await {
            // There are domes that move no shutter while they turn.
            Err(error) if !error.is_unknown_outcome() && fields.slewing.known() == Some(&true) => {
                // If it cannot be stopped, the closing itself decides.
                let _ = alpaca.put("abortslew", &[]).await;
                alpaca.put("closeshutter", &[]).await
            }
            closed => closed,
        }
    }

    /// Without an answer the request may have arrived all the same.
    fn close_answered<T>(&self, answer: &Result<T, AlpacaError>) {
        if !answer.as_ref().is_err_and(AlpacaError::is_unknown_outcome) {
            self.guard().close_answered(answer.is_ok(), self.clock.machine());
        }
    }

    fn guard(&self) -> std::sync::MutexGuard<'_, Guard> {
        self.guard.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Driver for Dome {
    type Kind = dome::Dome;

    fn polled(&self) -> Vec<String> {
        ["ShutterStatus", "Azimuth", "Slewing", "AtPark", "Slaved"].map(str::to_owned).to_vec()
    }

    fn moving(&self) -> &'static [&'static str] {
        &["ShutterStatus", "Azimuth", "Slewing", "AtPark"]
    }

    async fn capabilities(&self, abilities: &mut Abilities) -> Result<Capabilities, AlpacaError> {
        Ok(Capabilities {
            set_shutter: abilities.can("CanSetShutter").await?,
            park: abilities.can("CanPark").await?,
            set_azimuth: abilities.can("CanSetAzimuth").await?,
            slave: abilities.can("CanSlave").await?,
        })
    }

    fn observed(&self, readings: &Readings, now: Now) {
        if let Some(shutter) = readings.choice("ShutterStatus", &SHUTTER).known() {
            let asked = readings.asked("ShutterStatus").unwrap_or(now);
            self.guard().read(*shutter, asked.machine);
            self.eye.send_replace(Some((*shutter, asked.machine)));
        } else if let Some(number) = readings.whole("ShutterStatus").known() {
            self.guard().odd_status(*number);
        }
    }

    fn fields(&self, readings: &Readings) -> Fields {
        Fields {
            shutter: readings.choice("ShutterStatus", &SHUTTER),
            azimuth_deg: readings.number("Azimuth"),
            slewing: readings.flag("Slewing"),
            at_park: readings.flag("AtPark"),
            slaved: readings.flag("Slaved"),
        }
    }

    fn is_busy(&self, fields: &Fields) -> bool {
        let shutter = match fields.shutter.known() {
            Some(Shutter::Open | Shutter::Closed | Shutter::Error) => false,
            Some(Shutter::Opening | Shutter::Closing) | None => true,
        };
        // A roof that does not turn does not know Slewing.
        shutter || fields.slewing.known() == Some(&true)
    }

    fn works_at(&self, command: &Command, fields: &Fields) -> bool {
        match command {
            Command::OpenShutter | Command::CloseShutter => {
                !matches!(fields.shutter.known(), Some(Shutter::Open | Shutter::Closed | Shutter::Error))
            }
            Command::Park | Command::SlewToAzimuth { .. } => fields.slewing.known() == Some(&true),
            Command::Slave { .. } | Command::Claim | Command::Resume | Command::Vendor(_) => false,
            Command::Abort => self.is_busy(fields),
        }
    }

    fn contradiction(&self, command: Option<&Command>, fields: &Fields) -> Option<String> {
        let slews = command.is_none() && fields.slaved.known() != Some(&true) && fields.slewing.known() == Some(&true);
        slews.then(|| "Slewing is true, and no turn was commanded".to_owned())
    }

    fn need(&self, command: &Command) -> Need {
        match command {
            Command::OpenShutter => Need::Open,
            Command::CloseShutter => Need::Close,
            Command::Abort => Need::Nothing,
            Command::Park => Need::TokenWhileSafe,
            Command::SlewToAzimuth { .. } | Command::Slave { .. } => Need::Token,
            Command::Claim => Need::Claim,
            Command::Resume => Need::Resume,
            Command::Vendor(command) if vendor::is_listed(&self.vendor_commands_to_close, command) => Need::Token,
            Command::Vendor(_) => Need::TokenAndPermit,
        }
    }

    fn hinders(&self, command: &Command) -> Hinders {
        match command {
            Command::Abort | Command::SlewToAzimuth { .. } | Command::Slave { .. } => Hinders::Yes,
            Command::Park => Hinders::FromOthers,
            Command::Vendor(command) if vendor::is_listed(&self.vendor_commands_to_close, command) => Hinders::No,
            Command::Vendor(_) => Hinders::Yes,
            Command::OpenShutter | Command::CloseShutter | Command::Claim | Command::Resume => Hinders::No,
        }
    }

    fn interrupts(&self, command: &Command) -> bool {
        matches!(command, Command::CloseShutter | Command::Abort | Command::Park)
    }

    fn refuse(
        &self,
        _: &CommandId,
        command: &Command,
        can: &Capabilities,
        fields: &Fields,
    ) -> Option<(Reason, String)> {
        let shutter_moves = matches!(fields.shutter.known(), Some(Shutter::Opening | Shutter::Closing));
        let not = |what: &str| Some((Reason::NotImplemented, format!("this dome cannot {what}")));
        match command {
            Command::OpenShutter if !can.set_shutter => not("open its shutter"),
            Command::Park if !can.park => not("park"),
            Command::SlewToAzimuth { .. } if !can.set_azimuth => not("turn"),
            // Many domes cannot do both at once, and a shutter that closes must not be hindered.
            Command::SlewToAzimuth { .. } if shutter_moves => {
                Some((Reason::WrongState, "the shutter moves; turn when it rests".to_owned()))
            }
            Command::SlewToAzimuth { azimuth_deg } => within("azimuth_deg", *azimuth_deg, 0.0, 360.0),
            Command::Slave { .. } if !can.slave => not("follow the mount"),
            Command::Vendor(command) => {
                vendor::refuse(&[&self.vendor_commands, &self.vendor_commands_to_close], command)
            }
            // Closing is tried whatever the dome reports of itself.
            Command::OpenShutter
            | Command::CloseShutter
            | Command::Abort
            | Command::Park
            | Command::Slave { .. }
            | Command::Claim
            | Command::Resume => None,
        }
    }

    async fn execute(
        &self,
        alpaca: &Alpaca,
        _: &CommandId,
        command: &Command,
        fields: &Fields,
    ) -> Result<Executed, AlpacaError> {
        match command {
            Command::OpenShutter => {
                // The permit may have gone since the command was taken.
                if !self.guard().may_be_open(self.clock.machine()) {
                    return Err(AlpacaError::Value(NoData::new("no permit", "it ran out before the shutter moved")));
                }
                self.guard().open_sent(self.clock.machine());
                let opened = alpaca.put("openshutter", &[]).await;
                if opened.as_ref().is_err_and(|error| !error.is_unknown_outcome()) {
                    self.guard().open_refused();
                }
                opened?;
            }
            // The guard has begun to: the shutter moves as soon as its policy about the mounts lets it.
            Command::CloseShutter if self.guard().closes_by_itself() => {}
            Command::CloseShutter if self.guard().is_on_its_way(self.clock.machine()) => {}
            Command::CloseShutter => {
                self.guard().close_sent(self.clock.machine());
                let closed = self.close(alpaca, fields).await;
                self.close_answered(&closed);
                closed?;
            }
            Command::Abort => alpaca.put("abortslew", &[]).await?,
            Command::Park => alpaca.put("park", &[]).await?,
            Command::SlewToAzimuth { azimuth_deg } => {
                alpaca.put("slewtoazimuth", &[("Azimuth", &(azimuth_deg % 360.0).to_string())]).await?;
            }
            Command::Slave { on } => alpaca.put("slaved", &[("Slaved", if *on { "True" } else { "False" })]).await?,
            Command::Vendor(words) => {
                // The permit may have gone since the command was taken.
                let needs_permit = self.need(command) == Need::TokenAndPermit;
                if needs_permit && !self.guard().may_be_open(self.clock.machine()) {
                    return Err(AlpacaError::Value(NoData::new("no permit", "it ran out before this was sent")));
                }
                // A site may close by its maker's own command.
                let closes = vendor::is_listed(&self.vendor_commands_to_close, words);
                if closes {
                    self.guard().close_sent(self.clock.machine());
                }
                let executed = vendor::execute(alpaca, words).await;
                if closes {
                    self.close_answered(&executed);
                }
                return executed;
            }
            Command::Claim | Command::Resume => return Ok(Executed::Done),
        }
        Ok(Executed::Watch)
    }

    fn limit(&self, command: &Command) -> Duration {
        match command {
            Command::OpenShutter | Command::CloseShutter => {
                Duration::from_secs_f64(self.travel_timeout_s.clamp(1.0, 86_400.0))
            }
            Command::Park | Command::SlewToAzimuth { .. } => Duration::from_secs(300),
            Command::Abort | Command::Slave { .. } | Command::Claim | Command::Resume | Command::Vendor(_) => {
                Duration::from_secs(30)
            }
        }
    }

    fn progress(&self, command: &Command, fields: &Fields) -> Progress {
        let shutter = fields.shutter.known();
        let still = fields.slewing.known() != Some(&true);
        match command {
            Command::OpenShutter if self.guard().is_closing() => Progress::Failed("the guard closes".to_owned()),
            Command::OpenShutter if shutter == Some(&Shutter::Error) => {
                Progress::Failed("the shutter is in error".to_owned())
            }
            Command::OpenShutter => Progress::done_if(shutter == Some(&Shutter::Open)),
            // A status of closed is no proof of it.
            Command::CloseShutter => {
                Progress::done_if(shutter == Some(&Shutter::Closed) && self.guard().is_closed(self.clock.machine()))
            }
            Command::Abort => {
                let moves = matches!(shutter, Some(Shutter::Opening | Shutter::Closing));
                Progress::done_if(still && !moves)
            }
            Command::Park => Progress::done_if(fields.at_park.known() == Some(&true)),
            Command::SlewToAzimuth { azimuth_deg } => match fields.azimuth_deg.known() {
                Some(azimuth) => turned(*azimuth, *azimuth_deg, self.tolerance_deg, still),
                None => Progress::Running,
            },
            Command::Slave { on } => Progress::done_if(fields.slaved.known() == Some(on)),
            Command::Vendor(_) => Progress::Failed(vendor::UNANSWERED.to_owned()),
            Command::Claim | Command::Resume => Progress::Done,
        }
    }
}

/// How far a turn is, of a dome that does not say that it turns where it is `still`.
fn turned(azimuth_deg: f64, asked_deg: f64, tolerance_deg: f64, still: bool) -> Progress {
    let off_deg = apart_deg(azimuth_deg, asked_deg);
    match off_deg {
        off if !still && off > tolerance_deg => Progress::Running,
        _ if !still => Progress::SaysItMoves,
        off if off < THERE_DEG.min(tolerance_deg) => Progress::Done,
        off if off <= tolerance_deg => Progress::Settling(RESTS_S),
        off => Progress::Stranded {
            off: off / tolerance_deg,
            why: format!("it rests at azimuth {azimuth_deg:.1} deg, {off:.1} deg from {asked_deg:.1}"),
        },
    }
}
