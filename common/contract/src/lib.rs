//! The words of the bus: every key and every payload that Starmesh nodes exchange.
//!
//! Nodes never import nodes; they meet on the keys of [`key`] and speak the payloads below. Each payload
//! travels in a [`Stamped`] envelope as JSON. Times are RFC 3339 UTC with `Z`, angles are degrees (right
//! ascension too), a number's field name ends in its unit, and a missing value carries its reason
//! ([`NoData`]): a NaN never leaves a node.
//!
//! Growing within `v1` means optional fields and new keys. `golden/v1/*.json` holds one frozen sample of each
//! payload; when its test speaks up, change the code. `docs/bus.md` is made from the table in `table.rs`.

pub mod archive;
pub mod audit;
pub mod command;
pub mod datum;
pub mod device;
pub mod key;
pub mod node;
pub mod observatory;
mod printable;
pub mod stamp;
pub mod table;

pub use command::{Accepted, Command, CommandId, Order, OrderKind, Reason, Refusal, Reply};
pub use datum::{Datum, NoData, Reading, Scalar};
pub use device::{DeviceKind, DeviceState, Kind, LastCommand, Link, Outcome};
pub use key::{Address, BadKey, Chunk, Device, Key, Name, NodeTopic, Part, Role};
pub use printable::printable;
pub use stamp::{BootId, Stamped};

/// A value that travels on the bus: plain data with a name that the contract's table and golden samples use.
pub trait Payload: serde::Serialize + serde::de::DeserializeOwned + Send + Sync + Clone + 'static {
    /// Name of the payload in `docs/bus.md` and of its golden sample.
    const NAME: &'static str;
}
