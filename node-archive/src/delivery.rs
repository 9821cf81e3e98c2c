//! Nights are handed over to the destinations of `[[delivery]]`, and verified there.
//!
//! A try ([`run`]) selects frames ([`selection`]), makes the copies that a profile asks for (`product`), reads what the destination has of
//! them, sends the rest, reads that back, and writes
//! the manifest ([`manifest`]) last. A destination ([`destination`]) is a folder ([`directory`]), a place that rsync reaches
//! ([`rsync`]), or a bucket ([`store`]). What counts is what the destination gives back; the record in the data folder
//! ([`record`]) only says which files are ours. The archive node delivers each night when it is over ([`keep()`]), and removes
//! files that every destination has, where the site wants that ([`removal`]).
//!
//! # Invariants
//!
//! - Nothing at a destination is replaced by other content: `what_is_there_with_other_bytes_is_reported_and_not_overwritten`.
//! - A night has a manifest only when all its files were read back from the destination:
//!   `a_night_is_delivered_once_and_its_manifest_lists_what_was_read_back`.
//! - A kill at any point loses and doubles nothing: `tests/foreign/test_delivery.py`.

pub mod destination;
pub mod directory;
pub mod hash;
pub mod item;
mod keep;
pub mod manifest;
mod product;
pub(crate) mod record;
pub mod removal;
pub mod rsync;
pub mod run;
pub mod selection;
pub mod store;
mod store_http;
pub mod verify;

pub use keep::keep;

#[cfg(test)]
mod tests;
