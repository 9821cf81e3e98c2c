//! Commands, orders and their immediate answers; *done* is visible in state.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::stamp::MOST_ID_BYTES;
use crate::{BootId, Payload};

/// Names one command; a repeat of the same id is answered again and not done again.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default, JsonSchema, Serialize, Deserialize)]
#[serde(try_from = "String")]
pub struct CommandId(pub String);

impl TryFrom<String> for CommandId {
    type Error = String;

    /// An id becomes the name of a file and a part of log lines, and nodes remember many.
    fn try_from(id: String) -> Result<Self, Self::Error> {
        if id.len() > MOST_ID_BYTES {
            return Err(format!("an id of {} bytes; expected at most {MOST_ID_BYTES}", id.len()));
        }
        match id.chars().find(|c| c.is_control() || matches!(c, '/' | '\\')) {
            Some(c) => Err(format!("the id {id:?} holds {c:?}; expected no slash and no control character")),
            None => Ok(Self(id)),
        }
    }
}

impl CommandId {
    /// A fresh id that sorts by time; the id of an `expose` command is the id of its frame.
    pub fn fresh() -> Self {
        Self(uuid::Uuid::now_v7().to_string())
    }

    /// Names nothing: the command could not be read.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl fmt::Display for CommandId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// A command to a device, `C` being its kind's commands.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Command<C> {
    /// Names the command, for repeats and for `last_command`.
    pub id: CommandId,
    /// The sender, such as `observatory/alpha` or `web/ops`.
    pub from: String,
    /// Fencing token of the sender's lease; close, stop, abort, tracking off and park need none while no
    /// valid safe permit exists. In a claim: the newest token that the sender remembers, beyond which an arbiter that has
    /// lost its own goes on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub token: Option<u64>,
    /// Incarnation of the sender: the lease is granted to a process, not to a name. A sender without one is known by
    /// its name alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boot_id: Option<BootId>,
    /// What to do.
    #[serde(rename = "do")]
    pub action: C,
}

impl<C: Payload> Payload for Command<C> {
    const NAME: &'static str = C::NAME;
}

/// The answer to a command or an order, given at once.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(tag = "answer", rename_all = "snake_case")]
pub enum Reply {
    /// It will be done, or was done already.
    Accepted(Accepted),
    /// It will not be done.
    Refusal(Refusal),
}

impl Payload for Reply {
    const NAME: &'static str = "reply";
}

/// A command was taken.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Accepted {
    /// Id of the command.
    pub id: CommandId,
    /// The fencing token that a `claim` was granted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub token: Option<u64>,
    /// The order holds now, and a restart of the observatory node would forget it: the file and the error, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_written: Option<String>,
}

/// A command was not taken.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Refusal {
    /// Id of the command; empty where the command could not be read.
    pub id: CommandId,
    /// Why, for programs.
    pub reason: Reason,
    /// Why, for people.
    pub detail: String,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "refused ({}): {}", self.reason, self.detail)
    }
}

impl std::error::Error for Refusal {}

/// Why a command was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// The command could not be read, or a value is out of range.
    Malformed,
    /// The device cannot do this.
    NotImplemented,
    /// There is no link to the device.
    NotConnected,
    /// The device is doing something that must end first.
    Busy,
    /// Opening needs a valid safe permit.
    NoPermit,
    /// The fencing token is missing or older than one already seen.
    StaleToken,
    /// Somebody else holds the lease and is alive.
    LeaseHeld,
    /// The state of the device forbids it (a parked mount does not slew).
    WrongState,
    /// The device answered with an error.
    DeviceError,
    /// The order cannot be followed now.
    NotNow,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Malformed => "malformed",
            Self::NotImplemented => "not implemented",
            Self::NotConnected => "not connected",
            Self::Busy => "busy",
            Self::NoPermit => "no permit",
            Self::StaleToken => "stale token",
            Self::LeaseHeld => "lease held",
            Self::WrongState => "wrong state",
            Self::DeviceError => "device error",
            Self::NotNow => "not now",
        })
    }
}

/// A person's order to an observatory node.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Order {
    /// Names the order.
    pub id: CommandId,
    /// The person who orders, as `WAY/OPERATOR` or `WAY/OPERATOR@HOST`: `web/ana`, `cli/ana@dome-pc`.
    pub from: String,
    /// Why, for the diary.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
    /// What to do.
    #[serde(rename = "do")]
    pub kind: OrderKind,
    /// The newest state of the night that its giver had received. An order that does more than to close is
    /// refused where this is older than 5 s, so that one that lay in a buffer is not executed hours later.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seen: Option<Seen>,
}

/// One state of the night, by the numbers of its envelope.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct Seen {
    /// The boot of the observatory node that published it.
    pub boot_id: BootId,
    /// Its number.
    pub seq: u64,
}

impl Payload for Order {
    const NAME: &'static str = "order";
}

impl Order {
    /// The operator's name, without the way and the host that the order came by.
    pub fn operator(&self) -> &str {
        operator(&self.from)
    }
}

/// The operator's name in who ordered something: `ana` in `web/ana` and in `cli/ana@dome-pc`.
pub fn operator(from: &str) -> &str {
    let name = from.split_once('/').map_or(from, |(_, name)| name);
    name.split('@').next().unwrap_or(name).trim()
}

impl OrderKind {
    /// Does it only close, or make something stricter? Then it is never too late for it.
    pub fn only_tightens(&self) -> bool {
        match self {
            Self::Close => true,
            Self::Robotic(on) => !on,
            Self::StayClosed(on) => *on,
            Self::Override { for_s, .. } => *for_s == 0.0,
            Self::ReloadSchedule
            | Self::Acknowledge(_)
            | Self::Shelve { .. }
            | Self::Unshelve(_)
            | Self::PutSchedule { .. }
            | Self::Cool { .. }
            | Self::Warm(_)
            | Self::CompleteHeaders { .. }
            | Self::Skip(_)
            | Self::Repeat(_) => false,
        }
    }
}

/// A row of the schedule that an order is about.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct OrderedRow {
    /// Its place, as the state of the schedule numbers rows: from 0.
    pub row: u32,
    /// SHA-256 of the schedule that it stands in, as lower-case hex: where another one is in force, the order is refused as
    /// `wrong_state`. The one in force where this is absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of: Option<String>,
}

/// What a person may order.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OrderKind {
    /// Work through the schedule (`true`) or stop after closing safely (`false`); a set, never a toggle.
    Robotic(bool),
    /// Stop everything and close now; the robotic switch goes off.
    Close,
    /// Read the schedule file again.
    ReloadSchedule,
    /// Nothing opens until it is taken back, whatever the sky and the schedule say.
    StayClosed(bool),
    /// Does without one limit for a while; needs a reason.
    Override {
        /// The input as the verdict names it, such as `wx/Humidity` or `sun`.
        input: String,
        /// Sky seconds, at most 28800; 0 applies it again.
        for_s: f64,
    },
    /// Somebody knows of the alert of this id and sees to it.
    Acknowledge(String),
    /// Sends one alert to nobody for a while; needs a reason. It stays on the list, and safety does not change.
    Shelve {
        /// Id of the alert.
        alert: String,
        /// Sky seconds, at most 86400.
        for_s: f64,
    },
    /// Takes the alert of this id from the shelf.
    Unshelve(String),
    /// Puts another schedule in the place of the one in force; refused with what is wrong with it where it is none.
    PutSchedule {
        /// The whole file, at most 1000000 bytes.
        text: String,
        /// SHA-256 of the text that it replaces, as lower-case hex: where another one is active, the order is refused as
        /// `wrong_state`. Whatever is active is replaced where this is absent.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        instead_of: Option<String>,
    },
    /// Runs a camera's cooler now, whatever the schedule does; the next row that exposes wants its own set point again.
    Cool {
        /// Name of the camera.
        camera: String,
        /// Set point, degrees Celsius; that of its configuration where absent.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        set_c: Option<f64>,
    },
    /// Switches the cooler of the camera of this name off, until a row wants it.
    Warm(String),
    /// Has the archive complete the headers of a night again, with all that has arrived by now.
    CompleteHeaders {
        /// Date of its evening, `YYYYMMDD`; the night under way where absent.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        night: Option<String>,
    },
    /// Does without a row that has not ended; one at work ends with the frame under way.
    Skip(OrderedRow),
    /// Runs a row again within its window: one that has finished from its first frame, one that failed or was skipped from
    /// where it stopped, one that rests now.
    Repeat(OrderedRow),
}
