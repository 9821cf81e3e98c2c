//! The bus as nodes see it: typed publish, subscribe, ask and serve, presence, the clock, and node start-up.
//!
//! Only this crate names zenoh. Publishers drop rather than block, receivers overwrite in bounded queues, and
//! no slow work runs in a callback. Measured with zenoh 1.10.2: one frozen subscriber stalls a publisher with
//! `CongestionControl::Block`, and all its healthy subscribers, for 5 s; two full `FifoChannel`s (256 samples) stop all
//! traffic of the process, since they block both of its receiving threads. One [`Bus`] per node.
//!
//! # Invariants
//!
//! - Only `Clock` reads machine time or sky time, and they are two types: machine time for permits, ages and deadlines;
//!   sky time for what happens under the sky.
//! - An age is that of a reading, not of a message: the sender's boot-time clock from request to publication, the
//!   receiver's from there; the sender's wall clock is for the record only (`transit.rs`, decision 0041):
//!   `a_burst_after_a_stall_is_as_old_as_it_is`.
//! - An answer counts only if it comes from the program that publishes the state next to the key, and a query with a
//!   wildcard changes nothing (decision 0049): `what_only_a_stranger_answers_is_unknown`,
//!   `a_look_at_everything_is_no_order_and_no_question`.
//! - Publishers drop, receivers overwrite, callbacks only enqueue:
//!   `a_slow_subscriber_loses_the_oldest_and_stalls_nobody`.
//! - No place in the code floods a log, and complaints about the bus are not published on the bus (`flood.rs`):
//!   `a_library_that_repeats_itself_is_cut_short_and_others_still_speak`.
//! - A data file that cannot be read is copied aside before anything is written in its place (`aside.rs`):
//!   `a_damaged_file_is_kept_once_and_stays_where_it_is`.
//! - Log lines have a thread of their own: nothing that closes waits for a terminal, a pipe or a disk (`lines.rs`,
//!   decision 0067).

mod alert_life;
mod alerts;
pub mod aside;
mod ask;
mod clock;
mod console;
mod diary;
mod disk;
mod figures;
mod flood;
mod heard;
mod history;
mod host;
pub mod lines;
mod links;
mod listening;
mod machine;
pub mod node;
pub mod notify;
mod numbers;
pub mod private;
mod publish;
mod queue;
mod session;
mod step_back;
mod stop;
mod subscribe;
mod threads;
mod transit;
mod twin;
mod writers;
mod zenoh_log;

pub use alerts::AlertBoard;
pub use ask::{AskError, Service};
pub use clock::{Clock, ClockError};
pub use heard::Heard;
pub use host::host_name;
pub use interlock::{Lives, Succession};
pub use node::{Node, NodeOptions};
pub use publish::{Publisher, Quality};
pub use session::{Alive, Bus, BusError, MOST_BYTES};
pub use step_back::step_back;
pub use stop::Stop;
pub use subscribe::{Catch, Latest, Subscriber};
pub use units::{MachineTime, SkyTime};
