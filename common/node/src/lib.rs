//! A node as a process: its command line, configuration, start, log, alerts and end.
//!
//! [`start::main`] is what `starmesh node ROLE` calls: it reads the configuration, joins the bus, and runs
//! the node's work in parallel with its own publications (presence, health, alerts, diary) until a signal asks for an
//! end. A task gets [`Node`]: configuration, bus, alerts and stop.
//!
//! # Invariants
//!
//! - No sample on the bus ends a node (`twin.rs`): `a_node_leaves_only_to_a_process_that_this_host_shows`.
//! - No place in the code floods a log, and complaints about the bus are not published on the bus (`flood.rs`):
//!   `a_library_that_repeats_itself_is_cut_short_and_others_still_speak`.
//! - A data file that cannot be read is copied aside before anything is written in its place (`aside.rs`):
//!   `a_damaged_file_is_copied_once_and_stays_where_it_is`.
//! - Log lines have a thread of their own: nothing that closes waits for a terminal, a pipe or a disk (`lines.rs`,
//!   decision 0067).

mod alert_states;
mod alerts;
pub mod aside;
pub mod configuration;
mod console;
mod diary;
mod disk;
mod figures;
mod file_lock;
pub mod file_writer;
mod flood;
mod host;
pub mod lines;
pub mod log;
mod looks;
mod node;
mod options;
pub mod private;
pub mod restart;
pub mod runs;
pub mod service_manager;
pub mod signals;
pub mod start;
mod step_back;
mod stop;
mod twin;
pub mod watchdog;

pub use alerts::{NodeAlerts, StandingAlerts};
pub use disk::free_gb;
pub use file_lock::FileLock;
pub use host::{host_name, kernel_boot_id, now_s};
pub use looks::Looks;
pub use node::{Node, SUPERVISOR};
pub use options::NodeOptions;
pub use step_back::step_back;
pub use stop::Stop;
