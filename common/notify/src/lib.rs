//! Sends alerts to people: webhooks, e-mail, browsers that have subscribed ([`push`]), and a ping whose absence is noticed elsewhere.
//!
//! [`mailbox`], which is pure, decides what is due to each receiver; [`post`] runs one task per receiver, so that a
//! receiver that hangs delays no other. Nothing here is in the safety path: the nodes hand over a list of alerts that
//! can be followed, and never wait. A receiver that fails is an alert of its own.
//!
//! # Invariants
//!
//! - A node that sends alerts publishes what it sent to which receiver, and persists it, so that the next sender (also
//!   its own next incarnation) repeats nothing (decision 0025): `who_sends_next_goes_on_where_the_last_one_ended`,
//!   `what_was_sent_is_not_sent_again_after_a_restart_or_by_the_standby_which_sends_what_is_new`
//!   (`tests/tests/it/alerts_reach_people.rs`).
//! - Flood control never holds back a critical alert: `a_flood_ends_in_one_digest_and_holds_back_nothing_critical`.

mod http;
mod letter;
mod mail;
pub mod mailbox;
mod post;
pub mod push;
mod safe;
pub mod secret;
mod sending;
mod silent_nodes;
mod stand_in;

pub use post::{TestSent, send_first, send_test};
pub use sending::{keep_pinging, keep_sending};
pub use silent_nodes::keep_noticing_silence;
pub use stand_in::keep_substituting;
