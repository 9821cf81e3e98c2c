//! Schedules over HTTP: the texts that are and were active, the findings and the forecast of any other, and drafts, which
//! people write together until one of them is put in force.
//!
//! The observatory node decides what a schedule is worth: this node asks it, and stores drafts only.

mod active;
mod asked;
mod body;
mod difference;
mod draft_routes;
mod forecast;

pub use self::active::{
    ActionsQuery, Revision, RevisionsQuery, SimulateQuery, action_schemas, in_force, revision, revisions, simulate,
    validate,
};
pub use self::difference::ScheduleDifference;
pub use self::draft_routes::{ActivateRequest, Draft, activate, diff, list, put, read, remove};
pub use self::forecast::{Forecast, forecast};

/// The media type of a schedule's text.
pub const JSONL: &str = "application/jsonl";
