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
mod payload;
mod printable;
pub mod stamp;
pub mod table;

pub use command::{Accepted, Command, CommandId, Order, OrderKind, Reason, Refusal, Reply};
pub use datum::{Datum, NoData, Reading, Scalar};
pub use device::{DeviceKind, DeviceState, Kind, LastCommand, Link, Outcome};
pub use key::{Address, BadKey, Chunk, Device, Key, Name, NodeTopic, Part, Role};
pub use payload::Payload;
pub use printable::printable;
pub use stamp::{BootId, Stamped};
