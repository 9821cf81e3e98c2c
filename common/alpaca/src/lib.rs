//! A client of ASCOM Alpaca that tolerates careless servers and preserves the class of every error.
//!
//! [`Alpaca`] is one device of one server: [`Alpaca::get`] reads a property, [`Alpaca::put`] calls a method,
//! [`Alpaca::image`] fetches a frame, each with a total deadline, one at a time. [`Abilities`] reads
//! properties that a device may lack, [`value`] converts JSON to types, and [`discovery`] finds the servers of a
//! network.
//!
//! Nothing here knows the bus or a node of Starmesh; of `contract` only its values are used: the kind of a device, the
//! type of a pixel, and the reason why a value is absent.

mod body;
mod capability;
mod client;
pub mod discovery;
mod envelope_number;
mod error;
#[cfg(test)]
mod fuzz_tests;
mod image;
mod image_bytes;
mod image_json;
mod json;
mod raw_image;
mod response;
mod transaction;
pub mod value;

pub use capability::Abilities;
pub use client::{Alpaca, STATUS_DEADLINE, http_client};
pub use error::{AlpacaError, Fault};
pub use image::Image;
pub use raw_image::RawImage;
