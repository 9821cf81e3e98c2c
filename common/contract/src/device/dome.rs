//! A dome or roof: its shutter, and the guard that closes it when permission is not renewed.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::vendor::VendorCommand;
use crate::{Datum, DeviceKind, Kind, Payload};

/// The dome, ASCOM Dome.
#[derive(Debug)]
pub struct Dome;

impl DeviceKind for Dome {
    const KIND: Kind = Kind::Dome;
    type Capabilities = Capabilities;
    type Fields = Fields;
    type Command = Command;
}

/// What a dome can do.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "DomeCapabilities")]
pub struct Capabilities {
    /// The shutter can be commanded.
    pub set_shutter: bool,
    /// Parks on command.
    pub park: bool,
    /// Turns to an azimuth.
    pub set_azimuth: bool,
    /// Follows the mount by itself.
    pub slave: bool,
}

impl Payload for Capabilities {
    const NAME: &'static str = "dome.capabilities";
}

/// What nodes decide with.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "DomeFields")]
pub struct Fields {
    /// The shutter, as the dome itself says.
    pub shutter: Datum<Shutter>,
    /// Azimuth of the slit from north through east, degrees.
    pub azimuth_deg: Datum<f64>,
    /// Anything of the dome moves.
    pub slewing: Datum<bool>,
    /// Stands at its park position.
    pub at_park: Datum<bool>,
    /// Follows the mount by itself.
    pub slaved: Datum<bool>,
}

impl Payload for Fields {
    const NAME: &'static str = "dome.state";
}

/// ASCOM ShutterStatus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shutter {
    /// Open.
    Open,
    /// Closed.
    Closed,
    /// On its way to open.
    Opening,
    /// On its way to closed.
    Closing,
    /// Stuck or unknown.
    Error,
}

/// How a dome's closing waits for its mounts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CloseWithMount {
    /// Stop the mount and close together.
    #[default]
    Alongside,
    /// Wait for the park, at most `parked_within_s`, then close anyway.
    ParkedWithinS,
    /// Close only on a parked mount; alert when it takes longer than `parked_within_s`.
    ParkedOnly,
}

/// What a dome may be asked.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "DomeCommand")]
#[serde(rename_all = "snake_case")]
pub enum Command {
    /// Open the shutter; refused without a valid safe permit and the newest token.
    OpenShutter,
    /// Close the shutter; always taken.
    CloseShutter,
    /// Stop all movement.
    Abort,
    /// Turn to the park position.
    Park,
    /// Turn the slit.
    SlewToAzimuth {
        /// From north through east, degrees.
        azimuth_deg: f64,
    },
    /// Follow the mount, or stop following.
    Slave {
        /// On or off.
        on: bool,
    },
    /// Grants the lease of the telescopes under this dome; the answer carries the token.
    Claim,
    /// Ends a hold of the guard: the commander has taken over again after a closing by the guard.
    Resume,
    /// A command of the maker's own; only what the device's block lists is sent, and without a valid safe permit only
    /// what it lists for closing.
    Vendor(VendorCommand),
}

impl Payload for Command {
    const NAME: &'static str = "dome.command";
}

/// What a dome's guard says, once a second.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Guard {
    /// Counts the guard's own seconds; a permit must carry a recent one to be valid.
    pub number: u64,
    /// Highest fencing token that this guard's node has granted.
    pub token: u64,
    /// A permit is only as old as the guard number in it, s; default 10.
    pub permit_valid_s: f64,
    /// The permits that count, one per telescope under this dome.
    pub permits: Vec<ReceivedPermit>,
    /// True while every telescope's permit is valid and safe.
    pub may_be_open: bool,
    /// What the guard itself is doing.
    pub action: GuardAction,
    /// True after the guard closed: it opens for nobody until the commander sends `resume`.
    pub hold: bool,
    /// Permits dropped since the start: malformed, replayed, or with a token that was not granted or is older.
    pub dropped: u64,
    /// True while the shutter is proven closed: asked to close, and seen to follow. A status that only says closed is no
    /// proof. Absent from nodes that do not report it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verified_closed: Option<bool>,
    /// Closing waits for the mounts under this dome. Absent from nodes that do not report it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub waits_for_mounts: Option<bool>,
    /// The dome's own watchdog closes it when it was not fed for so long, s of machine time; it is fed only while
    /// `may_be_open`. 0 where the dome has none. Absent from nodes that do not report it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub watchdog_s: Option<f64>,
    /// The newest token that this node granted, by telescope: the arbiter's own word, which other devices follow.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub granted: Vec<GrantedToken>,
}

/// The newest fencing token of one telescope, as its arbiter granted it.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct GrantedToken {
    /// Which telescope.
    pub telescope: String,
    /// Its token.
    pub token: u64,
}

impl Payload for Guard {
    const NAME: &'static str = "dome.guard";
}

/// The newest valid permit of one telescope.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct ReceivedPermit {
    /// Which telescope.
    pub telescope: String,
    /// Its commander.
    pub commander: String,
    /// The verdict in it.
    pub safe: bool,
    /// Seconds until it runs out, machine time; negative when it has.
    pub left_s: f64,
}

/// What the guard is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GuardAction {
    /// Watches.
    Watching,
    /// Closes, and will try until the dome is verified closed.
    Closing,
}
