//! One driver per ASCOM kind: its capabilities, its state, and how it executes commands. Pure mapping; `serve` does the
//! rest.

pub mod camera;
mod camera_setting;
pub mod cover_calibrator;
pub mod dome;
mod exposure;
pub mod filter_wheel;
pub mod focuser;
pub mod observing_conditions;
pub mod rotator;
pub mod safety_monitor;
pub mod switch;
pub mod telescope;
mod vendor;

use std::future::Future;
use std::time::Duration;

use alpaca::{Abilities, Alpaca, AlpacaError};
use contract::{CommandId, Datum, DeviceKind, Reason, Reply};
use interlock::{Hinders, Need};

use crate::now::Now;
use crate::readings::Readings;

/// What the devices of a driver can do.
pub type Capabilities<D> = <<D as Driver>::Kind as DeviceKind>::Capabilities;
/// What is true of them.
pub type Fields<D> = <<D as Driver>::Kind as DeviceKind>::Fields;
/// What they may be asked.
pub type Command<D> = <<D as Driver>::Kind as DeviceKind>::Command;

/// How far a command is, judged by the device's own state.
#[derive(Debug, Clone, PartialEq)]
pub enum Progress {
    /// Not there yet.
    Running,
    /// There.
    Done,
    /// There, and done when it stays so for so long, s of sky time.
    Settling(f64),
    /// There, and it says that it moves: done when it has said so until the end of the command's time.
    SaysItMoves,
    /// It rests elsewhere: failed when it stays so.
    Stranded {
        /// How far, in units of the tolerance: while that changes by one, it moves whatever it says.
        off: f64,
        /// Where it rests, in words.
        why: String,
    },
    /// It will not get there.
    Failed(String),
}

impl Progress {
    /// Done or still running.
    pub fn done_if(done: bool) -> Self {
        if done { Self::Done } else { Self::Running }
    }

    /// Of a device that is to rest anywhere, by its flag that it moves.
    pub fn rests(moves: &Datum<bool>) -> Self {
        match moves.known() {
            Some(false) => Self::Done,
            None if moves.is_refused() => Self::Settling(UNREADABLE_S),
            Some(true) | None => Self::Running,
        }
    }

    /// Of a device that is where it was sent and rests there for `settle_s`, by its flag that it moves. Some drivers say
    /// so for ever, and some report at once where they are going: the flag is believed as long as the command has time.
    pub fn there(moves: &Datum<bool>, settle_s: f64) -> Self {
        match Self::rests(moves) {
            Self::Done if settle_s <= 0.0 => Self::Done,
            Self::Done => Self::Settling(settle_s),
            Self::Settling(unreadable_s) => Self::Settling(settle_s + unreadable_s),
            running if moves.known().is_none() => running,
            _ => Self::SaysItMoves,
        }
    }
}

/// A command whose effect the driver refuses to tell is taken for done after so long, s of sky time.
pub const UNREADABLE_S: f64 = 10.0;

/// What sending a command came to.
#[derive(Debug, Clone, PartialEq)]
pub enum Executed {
    /// The device took it; its state will show when it is done.
    Watch,
    /// Done already.
    Done,
    /// Done, and the device answered so.
    Answered(String),
}

/// One ASCOM kind.
pub trait Driver: Send + Sync + 'static {
    /// Which.
    type Kind: DeviceKind;

    /// ASCOM properties that the typed fields are made of.
    fn polled(&self) -> Vec<String>;

    /// Those of them that change while something moves or exposes.
    fn moving(&self) -> &'static [&'static str] {
        &[]
    }

    /// The device was connected anew: what was known of its settings does not hold any more.
    fn connected(&self) {}

    /// Reads what the device can do. It is called again, with the same abilities, as long as some could not be read.
    fn capabilities(
        &self,
        abilities: &mut Abilities,
    ) -> impl Future<Output = Result<Capabilities<Self>, AlpacaError>> + Send;

    /// New readings came, or the link was lost.
    fn observed(&self, _readings: &Readings, _now: Now) {}

    /// Ends when something changed that no poll would show, such as the spool.
    fn stirred(&self) -> impl Future<Output = ()> + Send {
        std::future::pending()
    }

    /// What nodes decide with.
    fn fields(&self, readings: &Readings) -> Fields<Self>;

    /// Does something move, or is that unknown?
    fn is_busy(&self, _fields: &Fields<Self>) -> bool {
        false
    }

    /// Does the part of the device move that this command moves, or is that unknown? Other parts do not matter to it.
    fn works_at(&self, _command: &Command<Self>, fields: &Fields<Self>) -> bool {
        self.is_busy(fields)
    }

    /// What the device reports of itself that cannot be, with the command that it executes; an alert shows it when it
    /// stays so.
    fn contradiction(&self, _command: Option<&Command<Self>>, _fields: &Fields<Self>) -> Option<String> {
        None
    }

    /// What the command needs.
    fn need(&self, command: &Command<Self>) -> Need;

    /// Does it move, switch or expose anything, or change who may? Such commands leave a record in the audit.
    fn moves(&self, _command: &Command<Self>) -> bool {
        true
    }

    /// Makes safe, so it interrupts whatever runs and waits for nothing.
    fn interrupts(&self, _command: &Command<Self>) -> bool {
        false
    }

    /// Does it hinder a closing that is due?
    fn hinders(&self, _command: &Command<Self>) -> Hinders {
        Hinders::No
    }

    /// Answers commands that the device itself does not execute, such as a frame's release; by id and sender.
    fn answer(&self, _origin: (&CommandId, &str), _command: &Command<Self>) -> Option<Reply> {
        None
    }

    /// Why the command makes no sense now.
    fn refuse(
        &self,
        _id: &CommandId,
        _command: &Command<Self>,
        _can: &Capabilities<Self>,
        _fields: &Fields<Self>,
    ) -> Option<(Reason, String)> {
        None
    }

    /// Sends the command. Dropping the future in the middle must be harmless.
    fn execute(
        &self,
        alpaca: &Alpaca,
        id: &CommandId,
        command: &Command<Self>,
        fields: &Fields<Self>,
    ) -> impl Future<Output = Result<Executed, AlpacaError>> + Send;

    /// A command that takes longer has failed, sky time from the moment it was sent.
    fn limit(&self, _command: &Command<Self>) -> Duration {
        Duration::from_secs(120)
    }

    /// How far a command is that was sent.
    fn progress(&self, _command: &Command<Self>, _fields: &Fields<Self>) -> Progress {
        Progress::Done
    }
}

/// Is a number one that a device may be sent?
pub(crate) fn within(name: &str, number: f64, low: f64, high: f64) -> Option<(Reason, String)> {
    // False for NaN too.
    let fits = number >= low && number <= high;
    (!fits).then(|| (Reason::Malformed, format!("{name} = {number}: expected {low} to {high}")))
}

/// A number rounded to the grid of a device; one without a grid as it is.
pub(crate) fn on_grid(number: f64, origin: f64, step: Option<f64>) -> f64 {
    match step.filter(|step| step.is_finite() && *step > 0.0) {
        // Whole units of 1e-9: multiples of a decimal step have long tails.
        Some(step) => ((origin + ((number - origin) / step).round() * step) * 1e9).round() / 1e9,
        None => number,
    }
}

/// A difference of two directions, without sign, degrees.
pub(crate) fn apart_deg(a: f64, b: f64) -> f64 {
    units::Angle::from_degrees(a - b).wrapped_signed().abs().degrees()
}

#[cfg(test)]
mod refusal_tests;

#[cfg(test)]
#[path = "driver_tests.rs"]
mod tests;
