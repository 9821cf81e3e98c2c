//! The focuser.

use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use alpaca::{Abilities, Alpaca, AlpacaError, value};
use contract::device::focuser::{self, Capabilities, Command, Fields};
use contract::{CommandId, NoData, Reason};
use interlock::Need;
use tokio::time::Instant;

use super::{Driver, Executed, Progress};
use crate::readings::Readings;

/// A focuser that rests so long next to where it was sent has ended its move, sky s: some begin to move late.
const RESTS_S: f64 = 3.0;
/// While it goes a part of its way, its position is asked for so often.
const ON_THE_WAY: Duration = Duration::from_millis(200);
/// The positions that a focuser can have at most, since ASCOM's numbers have 32 bits; with 0 it states no limit.
const STEPS: RangeInclusive<i64> = 0..=2_147_483_647;
/// A part of a way takes no longer, machine time.
const PART: Duration = Duration::from_secs(120);

/// Drives a focuser.
#[derive(Debug, Default)]
pub struct Focuser {
    /// A move is done when the focuser has stood for so long, sky s.
    pub settle_s: f64,
    /// A move that ends so near is done, steps.
    pub tolerance_steps: i64,
    /// Most steps of one move, as the focuser reports it; 0 where that is not known.
    pub max_increment: AtomicI64,
}

impl Focuser {
    /// Goes towards a position until one more move reaches it: no move is longer than the focuser takes.
    async fn come_near(&self, alpaca: &Alpaca, target: i64) -> Result<(), AlpacaError> {
        let most = self.max_increment.load(Ordering::Relaxed);
        if most <= 0 {
            return Ok(());
        }
        let mut from = whole(alpaca, "position").await?;
        while from.abs_diff(target) > most.unsigned_abs() {
            let next = from.saturating_add((target.saturating_sub(from)).signum().saturating_mul(most));
            alpaca.put("move", &[("Position", &next.to_string())]).await?;
            let reached = self.comes_to_rest(alpaca, from, next).await?;
            if reached.abs_diff(target) >= from.abs_diff(target) {
                let detail = format!("it rests at {reached} on its way from {from} to {next}");
                return Err(AlpacaError::Value(NoData::new("stopped", detail)));
            }
            from = reached;
        }
        Ok(())
    }

    /// Waits until the focuser rests where it was sent, or elsewhere for a while; returns where.
    async fn comes_to_rest(&self, alpaca: &Alpaca, from: i64, sent_to: i64) -> Result<i64, AlpacaError> {
        let began = Instant::now();
        let (mut position, mut rests) = (from, 0);
        while rests < RESTS_ON_THE_WAY && began.elapsed() < PART {
            tokio::time::sleep(ON_THE_WAY).await;
            let moves =
                alpaca.get("ismoving").await.and_then(|answer| value::flag(&answer).map_err(AlpacaError::Value))?;
            let before = std::mem::replace(&mut position, whole(alpaca, "position").await?);
            rests = if moves || position != before { 0 } else { rests + 1 };
            if !moves && position.abs_diff(sent_to) <= self.tolerance_steps.unsigned_abs() {
                break;
            }
        }
        Ok(position)
    }
}

async fn whole(alpaca: &Alpaca, member: &str) -> Result<i64, AlpacaError> {
    value::whole(&alpaca.get(member).await?).map_err(AlpacaError::Value)
}

/// A focuser that is seen to rest so often has ended a part of its way.
const RESTS_ON_THE_WAY: u32 = 15;

impl Driver for Focuser {
    type Kind = focuser::Focuser;

    fn polled(&self) -> Vec<String> {
        ["Position", "IsMoving", "Temperature"].map(str::to_owned).to_vec()
    }

    fn moving(&self) -> &'static [&'static str] {
        &["Position", "IsMoving"]
    }

    async fn capabilities(&self, abilities: &mut Abilities) -> Result<Capabilities, AlpacaError> {
        let can = Capabilities {
            absolute: abilities.can("Absolute").await?,
            max_step: abilities.read("MaxStep", value::whole_in(STEPS)).await?.unwrap_or(0),
            step_um: abilities.read("StepSize", value::number).await?.into(),
            max_increment: abilities.read("MaxIncrement", value::whole_in(STEPS)).await?.ok().filter(|most| *most > 0),
        };
        self.max_increment.store(can.max_increment.unwrap_or(0), Ordering::Relaxed);
        Ok(can)
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

    fn contradiction(&self, command: Option<&Command>, fields: &Fields) -> Option<String> {
        let moves = command.is_none() && fields.moving.known() == Some(&true);
        moves.then(|| "IsMoving is true, and no move was commanded".to_owned())
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
            Command::Move { position } if *position < 0 || can.last_position().is_some_and(|last| *position > last) => {
                let last = can.last_position().map_or_else(|| "the focuser's last".to_owned(), |last| last.to_string());
                Some((Reason::Malformed, format!("position {position}: expected 0 to {last}")))
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
            Command::Move { position } => {
                self.come_near(alpaca, *position).await?;
                alpaca.put("move", &[("Position", &position.to_string())]).await?;
            }
            Command::Abort => alpaca.put("halt", &[]).await?,
        }
        Ok(Executed::Watch)
    }

    fn progress(&self, command: &Command, fields: &Fields) -> Progress {
        let (moving, tolerance) = (&fields.moving, self.tolerance_steps.unsigned_abs());
        match (command, fields.position.known()) {
            (Command::Move { position }, Some(now)) => match now.abs_diff(*position) {
                0 => Progress::there(moving, self.settle_s),
                off if off <= tolerance => Progress::there(moving, self.settle_s.max(RESTS_S)),
                off if moving.known() == Some(&false) => Progress::Stranded {
                    off: off as f64 / tolerance.max(1) as f64,
                    why: format!("it rests at {now}, {off} steps from {position} (tolerance_steps = {tolerance})"),
                },
                _ => Progress::Running,
            },
            (Command::Move { .. }, _) => Progress::Running,
            (Command::Abort, _) => Progress::rests(moving),
        }
    }
}
