//! The field rotator.

use alpaca::{Alpaca, AlpacaError, can};
use contract::device::rotator::{self, Capabilities, Command, Fields};
use contract::{CommandId, Reason};
use interlock::Need;

use super::{Driver, Executed, Progress, apart_deg, within};
use crate::readings::Readings;

/// A rotator that is this close to its target has reached it.
const AT_TARGET_DEG: f64 = 0.1;

/// Drives a rotator.
pub struct Rotator;

impl Driver for Rotator {
    type Kind = rotator::Rotator;

    fn polled(&self) -> Vec<String> {
        ["Position", "MechanicalPosition", "IsMoving"].map(str::to_owned).to_vec()
    }

    fn moving(&self) -> &'static [&'static str] {
        &["Position", "MechanicalPosition", "IsMoving"]
    }

    async fn capabilities(&self, alpaca: &Alpaca) -> Result<Capabilities, AlpacaError> {
        Ok(Capabilities { reverse: can(alpaca, "canreverse").await? })
    }

    fn fields(&self, readings: &Readings) -> Fields {
        Fields {
            position_deg: readings.number("Position"),
            mechanical_deg: readings.number("MechanicalPosition"),
            moving: readings.flag("IsMoving"),
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

    fn refuse(&self, _: &CommandId, command: &Command, _: &Capabilities, _: &Fields) -> Option<(Reason, String)> {
        match command {
            Command::Move { position_deg } => within("position_deg", *position_deg, 0.0, 360.0),
            Command::Abort => None,
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
            Command::Move { position_deg } => {
                alpaca.put("moveabsolute", &[("Position", &(position_deg % 360.0).to_string())]).await?;
            }
            Command::Abort => alpaca.put("halt", &[]).await?,
        }
        Ok(Executed::Watch)
    }

    fn progress(&self, command: &Command, fields: &Fields) -> Progress {
        let stands = fields.moving.known() == Some(&false);
        match (command, fields.position_deg.known()) {
            (Command::Move { position_deg }, Some(position)) => {
                Progress::done_if(stands && apart_deg(*position, *position_deg) < AT_TARGET_DEG)
            }
            (Command::Move { .. }, None) => Progress::Running,
            (Command::Abort, _) => Progress::done_if(stands),
        }
    }
}
