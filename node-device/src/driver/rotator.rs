//! The field rotator.

use std::sync::{Mutex, PoisonError};

use alpaca::{Abilities, Alpaca, AlpacaError, value};
use contract::device::rotator::{self, Capabilities, Command, Fields};
use contract::{CommandId, Reason};
use interlock::Need;

use super::{Driver, Executed, Progress, apart_deg, on_grid, within};
use crate::readings::Readings;

/// A rotator that rests so long next to where it was sent has ended its turn, sky s: some begin to move late.
const RESTS_S: f64 = 3.0;

/// With longer steps it could not be turned to where it is wanted, degrees.
const LONGEST_STEP_DEG: f64 = 90.0;

/// Drives a rotator.
#[derive(Debug, Default)]
pub struct Rotator {
    /// A turn that ends so near is done, degrees.
    pub tolerance_deg: f64,
    /// Its step, degrees, as it reports it.
    step_deg: Mutex<Option<f64>>,
}

impl Rotator {
    /// By its block of the configuration.
    pub fn new(tolerance_deg: f64) -> Self {
        Self { tolerance_deg, step_deg: Mutex::default() }
    }

    fn step_deg(&self) -> Option<f64> {
        *self.step_deg.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Driver for Rotator {
    type Kind = rotator::Rotator;

    fn polled(&self) -> Vec<String> {
        ["Position", "MechanicalPosition", "IsMoving"].map(str::to_owned).to_vec()
    }

    fn moving(&self) -> &'static [&'static str] {
        &["Position", "MechanicalPosition", "IsMoving"]
    }

    async fn capabilities(&self, abilities: &mut Abilities) -> Result<Capabilities, AlpacaError> {
        let step_deg = abilities.read("StepSize", value::number_in(-1.0..=LONGEST_STEP_DEG)).await?;
        // A rotator without steps, or that states none, reports 0 or -1.
        let step_deg = step_deg.ok().filter(|step| *step > 0.0);
        *self.step_deg.lock().unwrap_or_else(PoisonError::into_inner) = step_deg;
        Ok(Capabilities { reverse: abilities.can("CanReverse").await?, step_deg })
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

    fn contradiction(&self, command: Option<&Command>, fields: &Fields) -> Option<String> {
        let moves = command.is_none() && fields.moving.known() == Some(&true);
        moves.then(|| "IsMoving is true, and no turn was commanded".to_owned())
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
                let position_deg = on_grid(*position_deg, 0.0, self.step_deg()) % 360.0;
                alpaca.put("moveabsolute", &[("Position", &position_deg.to_string())]).await?;
            }
            Command::Abort => alpaca.put("halt", &[]).await?,
        }
        Ok(Executed::Watch)
    }

    fn progress(&self, command: &Command, fields: &Fields) -> Progress {
        let moving = &fields.moving;
        match (command, fields.position_deg.known()) {
            (Command::Move { position_deg }, Some(position)) => {
                // Its nearest step is half of one away.
                let tolerance_deg = self.tolerance_deg.max(0.51 * self.step_deg().unwrap_or(0.0));
                let off_deg = apart_deg(*position, *position_deg);
                match off_deg {
                    off if off <= 0.1 * tolerance_deg => Progress::there(moving, 0.0),
                    off if off <= tolerance_deg => Progress::there(moving, RESTS_S),
                    off if moving.known() == Some(&false) => Progress::Stranded {
                        off: off / tolerance_deg,
                        why: format!(
                            "it rests at {position:.2} deg, {off:.2} deg from {position_deg:.2} (tolerance_deg = {tolerance_deg})"
                        ),
                    },
                    _ => Progress::Running,
                }
            }
            (Command::Move { .. }, _) => Progress::Running,
            (Command::Abort, _) => Progress::rests(moving),
        }
    }
}
