//! The bus as nodes see it: typed publish, subscribe, ask and serve, presence, the clock, and node start-up.
//!
//! Only this crate names zenoh. Publishers drop rather than block, receivers overwrite in bounded queues, and
//! no slow work runs in a callback (spec/technology.md 1.3 has the measurements behind each rule). One
//! [`Bus`] per node.

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
