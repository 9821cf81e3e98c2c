//! The audit: a node writes down who ordered or moved what, and nobody can change it later without being found out.
//!
//! [`Audit::note`] only queues, so no disk ever delays a closing. A thread of its own makes each entry a link of a
//! [`chain`] of hashes, appends it to the node's own [`book`] (one JSON line per record, synced within a second), and
//! then hands it to the bus ([`voice`]). Whoever was away asks the node for what it lacks ([`past`]); nobody else needs to
//! be there for the record to be kept. Decision 0010 has the choices.

pub mod book;
pub mod chain;
mod entry;
mod past;
mod queue;
mod voice;
mod whereabouts;
mod writer;

pub use chain::{Broken, Link, Proven};
pub use entry::{Entry, GUARD, verb_and_parameters};
pub use queue::Audit;
