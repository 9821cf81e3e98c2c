//! The safety loop: receives the inputs, evaluates them by the rules of [`safety`](::safety), and never stops doing
//! both.

mod clock_file;
mod failed_questions;
mod record_file;
mod subscribers;
pub mod task;
mod verdict_file;
mod writers;
