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
mod operator_orders;
mod optics;
mod plan;
mod pointing;
mod safety;
mod schedule;
mod schedule_texts;
mod solution;

pub use action::{ActionAnswer, ActionKind, ActionQuestion};
pub use alert::{Alert, AlertEvent, Alerts, LAST_WORD, Notification, Priority, Standing, merge};
pub use alerts_page::markdown;
pub use catalogue::AlertKind;
pub use facts::{FrameFacts, Trigger, TriggerKind};
pub use finding::{Check, Finding, Fix, ScheduleDraft, ScheduleFindings, Severity};
pub use focus::{
    FocusCurve, FocusFound, FocusLearned, FocusOutcome, FocusPass, FocusPoint, FocusRun, FocusState, FocusValue,
    FocuserFocus,
};
pub use guiding::{
    AxisCorrection, CalibrationSource, CameraCalibration, Correction, GUIDE_REFERENCES, GuideCalibration, GuideField,
    GuideMethod, GuideReference, GuideStage, GuidingState, PulseWhy, ReferenceStar,
};
pub use night::{ActionNow, Lease, NightState, OrderTaken, Posture};
pub use operator_orders::{CONTROL_LAPSES_S, OperatorOrders, Ordered, Override, Shelved};
pub use optics::{Optics, OpticsState, ZeroPoint};
pub use plan::{
    AltitudePoint, NightPlan, OverheadFigure, PlanBegun, RowBegun, RowPlan, SchedulePlan, SchedulePlanQuestion,
    SensorFigure,
};
pub use pointing::{PointingCheck, PointingModel, PointingPoint, PointingState};
pub use safety::{InputLimit, InputState, Interval, Permit, SafetyState, Sector, Unsafe, Verdict};
pub use schedule::{RowState, RowStatus, ScheduleState};
pub use schedule_texts::{ScheduleTextQuestion, ScheduleTexts, ScheduleVersion};
pub use solution::{Distortion, FrameWcs, Unsolved, UnsolvedClass};
