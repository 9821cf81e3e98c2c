//! The report of a night: what each second of it was used for, and what came out.
//!
//! [`events`] are the values that were recorded. Each of them claims a span of time for a class ([`timeline`],
//! [`class`]); where claims overlap, one counts by a fixed order ([`claim`]), so that every ms is in exactly one class,
//! and what nobody claims is `unexplained`. [`summary`] counts frames, orders and so on; [`curve`] makes light curves;
//! [`html`] is the page, and [`Report`] as JSON is what programs read (`docs/operator/report.md`).
//!
//! Values in, values out: no files, no clock.
//!
//! # Invariants
//!
//! - The classes cover the span exactly once: `the_classes_cover_the_span_exactly_once_whatever_is_claimed`.
//! - No text of a schedule, a device or a log becomes markup: `hostile_names_stay_text`.

pub mod claim;
pub mod class;
pub mod curve;
pub mod events;
pub mod html;
mod markup;
pub mod summary;
mod svg;
pub mod timeline;

use contract::observatory::RowState;
use serde::Serialize;
use units::Utc;

use crate::class::Group;
use crate::curve::Curve;
use crate::events::{AlertRecord, FocusRecord, NightEvents, OrderRecord};
use crate::summary::{Disk, GroupTime, Guiding, RefusedFrame, Target};

/// The version of the shape of the JSON; fields may be added within one version.
pub const SHAPE: u32 = 1;

/// The report of a night.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// The version of this shape.
    pub shape: u32,
    /// The site.
    pub site: String,
    /// The telescope.
    pub telescope: String,
    /// The date of the evening.
    pub night: String,
    /// When the report was made.
    pub made_utc: Utc,
    /// The night was not over yet.
    pub is_running: bool,
    /// The first instant that is classified.
    pub from_utc: Utc,
    /// The last one.
    pub to_utc: Utc,
    /// Length of the span, s.
    pub span_s: f64,
    /// Share of the span that no record explains, 0 to 1.
    pub unexplained_share: f64,
    /// Why no action was begun and no frame was taken; absent where one was.
    pub nothing_tried: Option<String>,
    /// The time by class; together exactly the span.
    pub times: Vec<GroupTime>,
    /// The span in pieces, in order, without a gap.
    pub timeline: Vec<TimelinePiece>,
    /// The targets.
    pub targets: Vec<Target>,
    /// The rows of the schedule as they were last.
    pub rows: Vec<RowState>,
    /// Light curves.
    pub curves: Vec<Curve>,
    /// Alerts.
    pub alerts: Vec<AlertRecord>,
    /// Orders of people.
    pub orders: Vec<OrderRecord>,
    /// Focus runs.
    pub focus_runs: Vec<FocusRecord>,
    /// Guiding, by object, camera and binning.
    pub guiding: Vec<Guiding>,
    /// Frames that do not count, and why.
    pub refused_frames: Vec<RefusedFrame>,
    /// What is on disk.
    pub disk: Disk,
    /// Stored rows that could not be read and are left out, each with the reason.
    pub unreadable: Vec<String>,
}

/// A piece of the night in one class.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TimelinePiece {
    /// When it begins.
    pub from_utc: Utc,
    /// When it ends.
    pub to_utc: Utc,
    /// The group.
    pub group: Group,
    /// The kind of overhead, the limit, the device or the reason.
    pub kind: String,
}

/// Makes the report.
pub fn make(events: &NightEvents) -> Report {
    let timeline = timeline::timeline(events);
    let times = summary::times(&timeline);
    let unexplained = times.iter().find(|time| time.group == Group::Unexplained).map_or(0.0, |time| time.share);
    let at = |ms: i64| Utc::from_micros(timeline.from.micros() + 1000 * ms);
    let piece = |piece: &claim::Piece| TimelinePiece {
        from_utc: at(piece.from_ms),
        to_utc: at(piece.to_ms),
        group: piece.class.group,
        kind: piece.class.kind.clone(),
    };
    let span_s: f64 = times.iter().map(|time| time.time_s).sum();
    Report {
        shape: SHAPE,
        site: events.site.clone(),
        telescope: events.telescope.clone(),
        night: events.night.clone(),
        made_utc: events.now,
        is_running: events.now < events.dark.map_or(events.to, |(_, sunrise)| sunrise),
        from_utc: timeline.from,
        to_utc: timeline.to,
        span_s,
        unexplained_share: unexplained,
        timeline: timeline.pieces.iter().map(piece).collect(),
        nothing_tried: summary::nothing_tried(events, &times),
        times,
        targets: summary::targets(events),
        rows: summary::rows(events),
        curves: curve::curves(events),
        alerts: events.alerts.clone(),
        orders: events.orders.clone(),
        focus_runs: events.focus.clone(),
        guiding: summary::guiding(events),
        refused_frames: summary::refused(events),
        disk: summary::disk(events),
        unreadable: events.unreadable.clone(),
    }
}

#[cfg(test)]
mod tests;
