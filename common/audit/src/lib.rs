//! The audit: a node records each order and each movement, with the person or node that asked for it, in a way that
//! shows every later change.
//!
//! [`Audit::note`] only queues, so no disk ever delays a closing. A thread of its own makes each entry a link of a
//! [`chain`] of hashes, appends it to the node's own [`audit_file`] (one JSON line per record, synced within a second),
//! and then publishes it ([`publisher`]). A subscriber that was away asks the node for the records that it lacks
//! ([`past`]); the record does not depend on any other node. Decision 0010 has the choices.
//!
//! # Invariants
//!
//! - Every order and every movement leaves a record: `every_order_and_every_movement_of_a_night_leaves_a_record`
//!   (`tests/tests/it/leaves_a_record.rs`).
//! - Noting never waits for a disk: `a_full_disk_stops_nobody_and_the_chain_goes_on_when_there_is_room`,
//!   `a_full_disk_delays_nothing`.
//! - The archive's audit is a copy; the node's own file decides:
//!   `whoever_was_away_gets_all_in_portions_across_files_and_breaks`.
//! - Any byte that is changed in a file is found:
//!   `any_byte_that_is_changed_in_the_file_is_found_and_a_new_chain_names_it`.

pub mod audit_file;
pub mod chain;
mod entry;
mod past;
mod publisher;
mod queue;
mod whereabouts;
mod writer;

pub use chain::{Broken, Link, Proven};
pub use entry::{Entry, GUARD, verb_and_parameters};
pub use queue::Audit;
