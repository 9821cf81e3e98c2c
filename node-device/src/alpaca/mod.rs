//! ASCOM Alpaca: a thin client that forgives sloppy servers and keeps every error's class.

mod client;
pub mod discovery;
mod error;
#[cfg(test)]
mod fuzz_tests;
pub mod image;
mod image_bytes;
mod image_json;
mod json;
mod response;
mod transaction;
pub mod value;

pub use client::Alpaca;
pub(crate) use client::http_client;
pub use error::{AlpacaError, Fault};
