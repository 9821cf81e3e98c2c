//! Tells people of alerts where they are: webhooks, e-mail, and a ping whose absence is noticed elsewhere.
//!
//! What is due to whom is decided by [`mailbox`], which is pure; [`post`] runs one task per receiver, so that one that
//! hangs delays nobody. Nothing here is in the safety path: the nodes hand over a list of alerts that can be followed,
//! and never wait. A receiver that fails is an alert of its own.

mod http;
mod letter;
mod mail;
pub mod mailbox;
mod post;
mod safe;
mod secret;
mod sending;
mod stand_in;
mod trust;

pub use sending::{keep_pinging, keep_sending};
pub use stand_in::keep_standing_in;
