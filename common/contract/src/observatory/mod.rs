//! What an observatory node says: verdict, permit, lease, night, schedule, alerts, guiding, focus, facts.

mod alert;
mod alerts_page;
pub mod catalogue;
mod night;
mod safety;
mod schedule;

pub use alert::{Alert, Alerts, Priority, merge};
pub use alerts_page::markdown;
pub use catalogue::AlertKind;
pub use night::{ActionNow, FocusState, FrameFacts, GuidingState, Lease, NightState, Posture};
pub use safety::{InputState, Interval, Permit, SafetyState, Sector, Unsafe, Verdict};
pub use schedule::{RowState, RowStatus, ScheduleState};
