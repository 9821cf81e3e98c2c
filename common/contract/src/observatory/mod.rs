//! What an observatory node says: verdict, permit, lease, night, schedule, alerts, pointing, guiding, focus, facts, optics.

mod action;
mod alert;
mod alert_id;
mod alerts_page;
pub mod catalogue;
mod catalogue_entry;
mod catalogue_macro;
mod facts;
mod finding;
mod focus;
mod guiding;
mod night;
mod optics;
mod pointing;
mod safety;
mod schedule;
mod solution;
mod standing;

pub use action::{ActionAnswer, ActionKind, ActionQuestion};
pub use alert::{Alert, AlertEvent, Alerts, Priority, Told, merge};
pub use alerts_page::markdown;
pub use catalogue::AlertKind;
pub use facts::{FrameFacts, Trigger, TriggerKind};
pub use finding::{Check, Finding, ScheduleDraft, ScheduleFindings, Severity};
pub use focus::{
    FocusCurve, FocusFound, FocusLearnt, FocusOutcome, FocusPass, FocusPoint, FocusRun, FocusState, FocusValue,
    FocuserFocus,
};
pub use guiding::{
    AxisCorrection, CalibrationSource, CameraCalibration, Correction, GuideCalibration, GuideField, GuideMethod,
    GuideReference, GuideStage, GuidingState, PulseWhy, ReferenceStar,
};
pub use night::{ActionNow, Lease, NightState, OrderTaken, Posture};
pub use optics::{Optics, OpticsState, ZeroPoint};
pub use pointing::{PointingCheck, PointingModel, PointingPoint, PointingState};
pub use safety::{InputState, Interval, Permit, SafetyState, Sector, Unsafe, Verdict};
pub use schedule::{RowState, RowStatus, ScheduleState};
pub use solution::{Distortion, FrameWcs, Unsolved, UnsolvedClass};
pub use standing::{Ordered, Override, Shelved, StandingOrders};
