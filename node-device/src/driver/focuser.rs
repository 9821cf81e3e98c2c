//! The focuser.

use alpaca::{Alpaca, AlpacaError, can, optional, value};
use contract::device::focuser::{self, Capabilities, Command, Fields};
use contract::{CommandId, Reason};
use interlock::Need;

use super::{Driver, Executed, Progress};
use crate::readings::Readings;

/// Drives a focuser.
pub struct Focuser {
    /// A move is done when the focuser has stood for so long, sky s.
    pub settle_s: f64,
}

impl Driver for Focuser {
    type Kind = focuser::Focuser;

    fn polled(&self) -> Vec<String> {
        ["Position", "IsMoving", "Temperature"].map(str::to_owned).to_vec()
    }

    fn moving(&self) -> &'static [&'static str] {
        &["Position", "IsMoving"]
    }

    async fn capabilities(&self, alpaca: &Alpaca) -> Result<Capabilities, AlpacaError> {
        Ok(Capabilities {
            absolute: can(alpaca, "absolute").await?,
            max_step: optional(alpaca, "maxstep", value::whole).await?.unwrap_or(0),
            step_um: optional(alpaca, "stepsize", value::number).await?.into(),
        })
    }

    fn fields(&self, readings: &Readings) -> Fields {
        Fields {
            position: readings.whole("Position"),
            moving: readings.flag("IsMoving"),
            temperature_c: readings.number("Temperature"),
        }
    }

    fn is_busy(&self, fields: &Fields) -> bool {
        fields.moving.known() != Some(&false)
    }

    fn need(&self, command: &Command) -> Need {
        match command {
            Command::Move { .. } => Need::Token,
            Command::Abort => Need::Nothing,
        }
    }

    fn interrupts(&self, command: &Command) -> bool {
        *command == Command::Abort
    }

    fn refuse(&self, _: &CommandId, command: &Command, can: &Capabilities, _: &Fields) -> Option<(Reason, String)> {
        match command {
            Command::Move { .. } if !can.absolute => {
                Some((Reason::NotImplemented, "this focuser does not know its position".to_owned()))
            }
            Command::Move { position } if *position < 0 || (can.max_step > 0 && *position > can.max_step) => {
                Some((Reason::Malformed, format!("position {position}: expected 0 to {}", can.max_step)))
            }
            Command::Move { .. } | Command::Abort => None,
        }
    }

    async fn execute(
        &self,
        alpaca: &Alpaca,
        _: &CommandId,
        command: &Command,
        _: &Fields,
    ) -> Result<Executed, AlpacaError> {
        match command {
            Command::Move { position } => alpaca.put("move", &[("Position", &position.to_string())]).await?,
            Command::Abort => alpaca.put("halt", &[]).await?,
        }
        Ok(Executed::Watch)
    }

    fn progress(&self, command: &Command, fields: &Fields) -> Progress {
        let stands = fields.moving.known() == Some(&false);
        match command {
            Command::Move { position } if stands && fields.position.known() == Some(position) => {
                Progress::Settling(self.settle_s)
            }
            Command::Move { .. } => Progress::Running,
            Command::Abort => Progress::done_if(stands),
        }
    }
}
