//! The contract of the bus: every key and every payload that Starmesh nodes exchange.
//!
//! Nodes never import nodes; they meet on the keys of [`table`] and exchange the payloads below. Each payload
//! travels in a [`Stamped`] envelope as JSON. Times are RFC 3339 UTC with `Z`, angles are degrees (right
//! ascension too), a number's field name ends in its unit, and a missing value carries its reason
//! ([`NoData`]): a NaN never leaves a node.
//!
//! Growing within `v1` means optional fields and new keys. `golden/v1/*.json` holds one frozen sample of each
//! payload; when its test fails, change the code. `table.rs` declares each key once; keys as
//! text, the key expressions of subscribers ([`Topic`]) and `docs/bus.md` are made from it.
//!
//! # Invariants
//!
//! - No other crate than this one and `bus` spells a key or a wildcard: held by `scripts/layers`.
//! - Every key has exactly one row in the table, and reads back as itself: `every_key_has_exactly_one_row`,
//!   `every_key_reads_back_as_itself`.
//! - No bytes from the bus make a decoder panic: `a_damaged_sample_never_panics`, `random_bytes_never_panic`.
//! - Only kinds of alerts that are in the table of alerts can be raised, and each has sentences for people; shelving an alert never
//!   changes safety: `every_id_names_its_kind`, `every_row_has_words_that_are_sentences`.
//! - Text from outside appears in a log, a diary, an alert, an e-mail or a line on a terminal only as [`printable()`] spells it (decision
//!   0065): `nothing_in_a_text_ends_its_line_or_steers_a_terminal`.

mod address;
pub mod archive;
pub mod archived_frame;
pub mod async_api;
pub mod audit;
pub mod bus_page;
pub mod command;
pub mod datum;
pub mod device;
pub mod frame_search;
mod key;
mod keys;
pub mod log_search;
pub mod node;
pub mod observatory;
pub mod order_form;
mod payload;
mod printable;
pub mod row;
pub mod stamp;
pub mod table;
mod table_macro;

pub use address::{Address, BadKey, Chunk, Device, Name, Role};
pub use command::{Accepted, Command, CommandId, Order, OrderKind, OrderedRow, Reason, Refusal, Reply};
pub use datum::{Datum, NoData, Reading, Scalar};
pub use device::{CommandOutcome, DeviceKind, DeviceState, Kind, LastCommand, Link};
pub use keys::{EVERYTHING, Keys};
pub use order_form::Right;
pub use payload::Payload;
pub use printable::printable;
pub use stamp::{BootId, Stamped};
pub use table::{Key, NodeTopic, Part, Topic};
