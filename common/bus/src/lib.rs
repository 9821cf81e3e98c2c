//! The bus as nodes see it: typed publish, subscribe, ask and serve, presence, history, and the clock.
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

mod ask;
mod clock;
mod history;
mod links;
mod listening;
mod machine;
mod meetings;
mod numbers;
mod publish;
mod queue;
mod received;
mod session;
mod sockets;
mod subscribe;
pub mod threads;
mod transit;
mod writers;
pub mod zenoh_log;

pub use ask::{AskError, Service};
pub use clock::{Clock, ClockError};
pub use interlock::{Incarnations, Succession};
pub use numbers::Gap;
pub use publish::{Publisher, Quality};
pub use received::Received;
pub use session::{Alive, Bus, BusError, MOST_BYTES};
pub use subscribe::{Catch, Latest, Subscriber};
pub use units::{MachineTime, SkyTime};
