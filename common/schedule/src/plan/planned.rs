//! The result of a forecast: for each row, and for the night.

use contract::Name;
use contract::observatory::RowStatus;
use sky::{Icrs, airmass};
use units::{Angle, Utc};

use super::Site;
use crate::action::Place;
use crate::row::Row;

/// Points of an altitude curve are so far apart, s.
const STEP_S: f64 = 300.0;

/// How high a target stands while its row runs; not refracted.
#[derive(Debug, Clone, PartialEq)]
pub struct Heights {
    /// Lowest, deg.
    pub min_deg: f64,
    /// Highest, deg.
    pub max_deg: f64,
    /// Airmass in the middle of the row; none below the horizon.
    pub airmass_at_mid: Option<f64>,
    /// Altitude every 5 min and at the end, deg.
    pub curve: Vec<(Utc, f64)>,
}

/// One row.
#[derive(Debug, Clone)]
pub struct PlannedRow {
    /// Its place in the schedule, from 0.
    pub index: usize,
    /// Line of the file on which it begins, from 1.
    pub line: usize,
    /// `action_type`.
    pub action: &'static str,
    /// OBJECT.
    pub object: Option<String>,
    /// Its camera.
    pub camera: Name,
    /// It has the mount while it runs.
    pub has_mount: bool,
    /// It asks for a safe sky.
    pub needs_safe: bool,
    /// Its window.
    pub window: (Utc, Utc),
    /// When it runs: more than one span where the sky interrupts it.
    pub runs: Vec<(Utc, Utc)>,
    /// Its status at the end.
    pub status: RowStatus,
    /// Frames that count.
    pub frames: u32,
    /// Frames wanted, where that is a number.
    pub frames_wanted: Option<u32>,
    /// Time exposed, s.
    pub exposed_s: f64,
    /// Of all its files; 0 while no frame of its camera is known.
    pub bytes: f64,
    /// The altitudes of its target.
    pub heights: Option<Heights>,
    /// Remarks for the astronomer.
    pub note: String,
}

impl PlannedRow {
    pub(super) fn of(row: &Row, index: usize) -> Self {
        let needs = row.action.needs();
        Self {
            index,
            line: row.line,
            action: row.action.name(),
            object: row.action.object().map(str::to_owned),
            camera: row.camera.clone(),
            has_mount: needs.mount,
            needs_safe: needs.safe,
            window: (row.start, row.end),
            runs: Vec::new(),
            status: RowStatus::Pending,
            frames: 0,
            frames_wanted: row.action.frames_wanted(),
            exposed_s: 0.0,
            bytes: 0.0,
            heights: None,
            note: String::new(),
        }
    }

    /// Begin of its first and end of its last run.
    pub fn span(&self) -> Option<(Utc, Utc)> {
        Some((self.runs.first()?.0, self.runs.last()?.1))
    }

    /// Does it run to its end, with all frames that it asks for?
    pub fn is_whole(&self) -> bool {
        self.status == RowStatus::Finished && self.frames_wanted.is_none_or(|wanted| self.frames >= wanted)
    }

    /// Adds to the note.
    pub(super) fn note(&mut self, words: &str) {
        if !words.is_empty() && !self.note.contains(words) {
            let between = if self.note.is_empty() { "" } else { "; " };
            self.note.push_str(&format!("{between}{words}"));
        }
    }
}

/// A night, or as much as one file has.
#[derive(Debug, Clone)]
pub struct PlannedNight {
    /// The rows, in the order of the schedule.
    pub rows: Vec<PlannedRow>,
    /// How long the roof is open, s.
    pub open_s: f64,
    /// When everything is closed after the last row, if it was ever open.
    pub closed: Option<Utc>,
    /// Dark time of the nights that the schedule touches: the Sun 18 deg down, s.
    pub dark_s: f64,
    /// ... and how much of it a shutter is open to the sky, s.
    pub dark_exposed_s: f64,
}

impl PlannedNight {
    /// Rows that will not run, or not whole.
    pub fn at_risk(&self) -> impl Iterator<Item = &PlannedRow> {
        self.rows.iter().filter(|row| !row.is_whole())
    }

    /// Bytes of all files.
    pub fn bytes(&self) -> f64 {
        self.rows.iter().map(|row| row.bytes).sum()
    }

    /// Frames that count.
    pub fn frames(&self) -> u64 {
        self.rows.iter().map(|row| u64::from(row.frames)).sum()
    }
}

/// How high a row's place stands from its begin to its end; none where it points nowhere, or the sky is not known then.
pub(super) fn heights(
    place: Option<Place>,
    looked: Option<Icrs>,
    span: (Utc, Utc),
    site: &mut Site,
) -> Option<Heights> {
    let (start, end) = span;
    let fixed = match (&place, looked) {
        (Some(Place::Moving(_)), _) => None,
        // The run follows the place that was at an altitude and azimuth when the row slewed.
        (_, Some(looked)) => Some(looked),
        (Some(Place::Icrs(place)), None) => Some(*place),
        (Some(Place::Horizontal(direction)), None) => Some(site.sky.at(start).ok()?.to_icrs(direction)),
        (None, None) => return None,
    };
    let mut altitude_deg = |at: Utc| -> Option<f64> {
        let observer = site.sky.at(at).ok()?;
        let place = match (&place, fixed) {
            (_, Some(fixed)) => fixed,
            (Some(Place::Moving(body)), None) => body.seen(&observer).ok()?.icrs,
            _ => return None,
        };
        Some(observer.to_horizontal(&place).altitude.degrees()).filter(|deg| deg.is_finite())
    };
    let span_s = end.seconds_since(start);
    let steps = (span_s / STEP_S).ceil().clamp(1.0, 2000.0);
    let at = |step: f64| start.plus_seconds((step * (span_s / steps).max(STEP_S)).min(span_s));
    let curve: Option<Vec<(Utc, f64)>> =
        (0..=steps as u32).map(|step| Some((at(f64::from(step)), altitude_deg(at(f64::from(step)))?))).collect();
    let curve = curve?;
    let middle_deg = altitude_deg(start.plus_seconds(0.5 * span_s))?;
    let ends = curve.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), (_, deg)| (a.min(*deg), b.max(*deg)));
    let airmass_at_mid = airmass(Angle::from_degrees(middle_deg));
    Some(Heights { min_deg: ends.0, max_deg: ends.1, airmass_at_mid, curve })
}
