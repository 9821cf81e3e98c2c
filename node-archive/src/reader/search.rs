//! Frames by what they show: by night, target, filter, type and quality, by a place that they cover, and with the
//! frames that calibrate them.

use std::collections::{BTreeMap, BTreeSet};

use contract::CommandId;
use contract::archived_frame::FrameDetails;
use contract::device::camera::Frame;
use contract::frame_search::{CalibrationFrame, FoundFrame, FrameSearch, SkyPlace};
use contract::observatory::FrameFacts;
use rusqlite::types::Value;
use units::{Angle, Utc};

use super::{Reader, json, unreadable};
use crate::database::{DatabaseError, stamp};
use crate::solution;

/// A frame is calibrated by frames that are at most so far away in time.
const CALIBRATES_WITHIN_S: f64 = 30.0 * 86_400.0;
/// Exposure times of a dark and of a frame that it calibrates differ by less, as a share.
const SAME_EXPOSURE: f64 = 0.005;
/// No camera has a field whose middle is further from its corner, degrees: frames beyond are not looked at.
const WIDEST_FIELD_DEG: f64 = 45.0;

/// A condition in SQL and its values.
#[derive(Default)]
struct Conditions {
    sql: String,
    values: Vec<Value>,
}

impl Conditions {
    fn add(&mut self, sql: &str, value: impl Into<Value>) {
        self.sql.push_str(if self.sql.is_empty() { "WHERE " } else { " AND " });
        self.sql.push_str(sql);
        self.values.push(value.into());
    }

    fn text(&mut self, sql: &str, value: Option<String>) {
        if let Some(value) = value {
            self.add(sql, value);
        }
    }

    fn between(from: Option<Utc>, to: Option<Utc>) -> Self {
        let mut conditions = Self::default();
        if let Some(from) = from {
            conditions.add("images.date_obs >= ?", stamp(from));
        }
        if let Some(to) = to {
            conditions.add("images.date_obs < ?", stamp(to));
        }
        conditions
    }
}

/// What a frame and the frames that calibrate it have in common.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Setup {
    camera: String,
    bin: u32,
    size_px: [u32; 2],
    origin_px: [u32; 2],
}

impl Setup {
    fn of(frame: &Frame) -> Self {
        let size_px = [frame.width_px, frame.height_px];
        Self { camera: frame.camera.clone(), bin: frame.bin, size_px, origin_px: frame.origin_px }
    }
}

/// What was found.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundFrames {
    /// The newest frames that meet the conditions, the oldest first.
    pub frames: Vec<FoundFrame>,
    /// Frames that calibrate them.
    pub calibrating: Vec<FoundFrame>,
    /// There are older ones.
    pub has_more: bool,
}

/// The words that people use for kinds of frames, in any case, and their IMAGETYP keywords.
pub const IMAGE_TYPES: [(&str, &str); 6] = [
    ("light", "Light Frame"),
    ("acquisition", "Acquisition Frame"),
    ("bias", "Bias Frame"),
    ("dark", "Dark Frame"),
    ("flat", "Flat Frame"),
    ("test", "Test Frame"),
];

/// The IMAGETYP keyword of a kind; what is none is one itself.
fn image_type(word: &str) -> String {
    let kind = IMAGE_TYPES.into_iter().find(|(kind, _)| kind.eq_ignore_ascii_case(word));
    kind.map_or(word, |(_, keyword)| keyword).to_owned()
}

/// Frames that calibrate, by kind and setup, in the order of time.
type Calibrations = BTreeMap<(CalibrationFrame, Setup), Vec<(Frame, FoundFrame)>>;

impl Reader {
    /// The newest frames that meet the conditions, at most so many, and those that calibrate them.
    pub fn search(
        &self,
        search: &FrameSearch,
        between: (Option<Utc>, Option<Utc>),
        limit: usize,
    ) -> Result<FoundFrames, DatabaseError> {
        let _snapshot = self.snapshot()?;
        // One more shows that there are more.
        let mut found = self.matching(search, between, limit.saturating_add(1))?;
        let has_more = found.len() > limit;
        found.truncate(limit);
        found.reverse();
        let calibrating = if search.with_calibration { self.calibrating(&found)? } else { Vec::new() };
        Ok(FoundFrames { frames: found.into_iter().map(|(_, row)| row).collect(), calibrating, has_more })
    }

    /// What is known of one frame.
    pub fn stored_frame(&self, frame: &CommandId) -> Result<Option<FrameDetails>, DatabaseError> {
        let mut conditions = Conditions::default();
        conditions.add("images.frame_id = ?", frame.0.clone());
        let mut found = None;
        self.each_frame(conditions, |_, facts, frame| {
            found = Some(FrameDetails { frame, facts });
            false
        })?;
        Ok(found)
    }

    /// The newest frames that meet the conditions, the newest first.
    fn matching(
        &self,
        search: &FrameSearch,
        (from, to): (Option<Utc>, Option<Utc>),
        most: usize,
    ) -> Result<Vec<(Frame, FoundFrame)>, DatabaseError> {
        let mut conditions = Conditions::between(from, to);
        conditions.text("night = ?", search.night.as_ref().map(|night| night.replace('-', "")));
        conditions.text("images.camera_name = ?", search.camera.clone());
        conditions.text("object = ? COLLATE NOCASE", search.object.clone());
        conditions.text("images.filter = ?", search.filter.clone());
        conditions.text("images.image_type = ?", search.image_type.as_deref().map(image_type));
        if let Some(stars) = search.stars_min {
            conditions.add("stars >= ?", i64::from(stars));
        }
        if let Some(most) = search.fwhm_max_arcsec {
            conditions.add("facts.fwhm_px * facts.scale_arcsec_px <= ?", most);
        }
        if let Some(place) = &search.covers {
            conditions.add("facts.dec_deg >= ?", place.dec_deg - WIDEST_FIELD_DEG);
            conditions.add("facts.dec_deg <= ?", place.dec_deg + WIDEST_FIELD_DEG);
            // An upper bound of the distance from the middle to a corner, arcsec in degrees.
            let near = "abs(facts.dec_deg - ?) * 7200.0 <= facts.scale_arcsec_px * \
                        (json_extract(frame, '$.width_px') + json_extract(frame, '$.height_px'))";
            conditions.add(near, place.dec_deg);
        }
        let mut found: Vec<(Frame, FoundFrame)> = Vec::new();
        if most > 0 {
            self.each_frame(conditions, |frame, facts, row| {
                if search.covers.is_none_or(|place| covers(facts.as_ref(), &frame, place)) {
                    found.push((frame, row));
                }
                found.len() < most
            })?;
        }
        Ok(found)
    }

    /// The frames that calibrate these, each once.
    fn calibrating(&self, found: &[(Frame, FoundFrame)]) -> Result<Vec<FoundFrame>, DatabaseError> {
        let known = self.calibrations(found)?;
        let (mut rows, mut ids, mut looked) = (Vec::new(), BTreeSet::new(), BTreeSet::new());
        for (frame, found) in found {
            for kind in CalibrationFrame::ALL {
                let detail = match kind {
                    CalibrationFrame::Bias => String::new(),
                    CalibrationFrame::Dark => format!("{:.6}", frame.exposure_s),
                    CalibrationFrame::Flat => found.filter.clone().unwrap_or_default(),
                };
                // One look for all frames of a night that are alike.
                if !looked.insert((kind, Setup::of(frame), detail, found.night.clone())) {
                    continue;
                }
                let of_setup = known.get(&(kind, Setup::of(frame))).map_or(&[][..], Vec::as_slice);
                let nearest = nearest_calibration(kind, (frame, found), of_setup);
                rows.extend(nearest.filter(|row| ids.insert(row.id.0.clone())));
            }
        }
        Ok(rows)
    }

    /// All frames that are near enough in time to calibrate one of these; each is read once, however many these are.
    fn calibrations(&self, found: &[(Frame, FoundFrame)]) -> Result<Calibrations, DatabaseError> {
        let mut known = Calibrations::new();
        let mut times: Vec<Utc> = found.iter().map(|(frame, _)| frame.started_utc).collect();
        times.sort_unstable();
        // Times whose spans touch make one span.
        let is_one = |a: &Utc, b: &Utc| b.seconds_since(*a) <= 2.0 * CALIBRATES_WITHIN_S;
        for span in times.chunk_by(is_one) {
            let (Some(first), Some(last)) = (span.first(), span.last()) else { continue };
            for kind in CalibrationFrame::ALL {
                let (from, to) = (first.plus_seconds(-CALIBRATES_WITHIN_S), last.plus_seconds(CALIBRATES_WITHIN_S));
                let mut conditions = Conditions::between(Some(from), Some(to));
                conditions.add("images.image_type = ?", kind.image_type().to_owned());
                self.each_frame(conditions, |frame, _, row| {
                    known.entry((kind, Setup::of(&frame))).or_default().push((frame, row));
                    true
                })?;
            }
        }
        for frames in known.values_mut() {
            frames.sort_by_key(|(frame, _)| frame.started_utc);
        }
        Ok(known)
    }

    /// Hands over the frames of the telescope that meet the conditions, the newest first, until `take` returns false.
    fn each_frame(
        &self,
        mut conditions: Conditions,
        mut take: impl FnMut(Frame, Option<FrameFacts>, FoundFrame) -> bool,
    ) -> Result<(), DatabaseError> {
        conditions.add("images.telescope IN (?, '')", self.telescope.clone());
        let sql = format!(
            "SELECT frame, file, bytes, complete_hdr, facts FROM images LEFT JOIN facts USING (frame_id) {}
             ORDER BY images.date_obs DESC",
            conditions.sql
        );
        let values: Vec<&dyn rusqlite::ToSql> =
            conditions.values.iter().map(|value| value as &dyn rusqlite::ToSql).collect();
        self.each_row(&sql, &values, |row| {
            let frame: Frame = json(row, 0)?;
            let facts = row.get_ref(4)?.as_str_or_null()?.map(serde_json::from_str).transpose();
            let facts = facts.map_err(|error| unreadable(4, error))?;
            let bytes = row.get::<_, i64>(2)?.unsigned_abs();
            let found = found_frame(&frame, facts.as_ref(), (row.get(1)?, bytes, row.get(3)?));
            Ok(take(frame, facts, found))
        })
    }
}

/// The frames of one kind and setup that calibrate a frame, of the nearest night that has some. `all` is in the order of time.
fn nearest_calibration(
    kind: CalibrationFrame,
    (frame, found): (&Frame, &FoundFrame),
    all: &[(Frame, FoundFrame)],
) -> impl Iterator<Item = FoundFrame> {
    let away_s = |other: &Frame| other.started_utc.seconds_since(frame.started_utc);
    let first = all.partition_point(|(other, _)| away_s(other) < -CALIBRATES_WITHIN_S);
    let end = all.partition_point(|(other, _)| away_s(other) < CALIBRATES_WITHIN_S);
    let is_alike = |(other, row): &&(Frame, FoundFrame)| {
        let is_alike = match kind {
            CalibrationFrame::Bias => true,
            CalibrationFrame::Dark => {
                (other.exposure_s - frame.exposure_s).abs() <= SAME_EXPOSURE * frame.exposure_s.abs()
            }
            CalibrationFrame::Flat => row.filter == found.filter && row.refused.is_none(),
        };
        is_alike && row.id != found.id
    };
    let fitting: Vec<&(Frame, FoundFrame)> = all.get(first..end).unwrap_or_default().iter().filter(is_alike).collect();
    let nearest = fitting.iter().min_by(|(a, _), (b, _)| away_s(a).abs().total_cmp(&away_s(b).abs()));
    let night = nearest.map(|(_, row)| row.night.clone());
    let of_night: Vec<FoundFrame> = fitting
        .into_iter()
        .filter(|(_, row)| Some(&row.night) == night.as_ref())
        .map(|(_, row)| FoundFrame { calibrates: Some(kind), ..row.clone() })
        .collect();
    of_night.into_iter()
}

/// A frame as it is answered: its announcement, its facts, and file, bytes and whether the header is complete.
fn found_frame(
    frame: &Frame,
    facts: Option<&FrameFacts>,
    (file, bytes, header_complete): (String, u64, bool),
) -> FoundFrame {
    let fact = |value: fn(&FrameFacts) -> Option<f64>| facts.and_then(value).filter(|value| value.is_finite());
    FoundFrame {
        id: frame.id.clone(),
        at_utc: frame.started_utc,
        camera: frame.camera.clone(),
        file,
        bytes,
        header_complete,
        night: frame.purpose.night.clone(),
        action: Some(frame.purpose.action.clone()),
        row: frame.purpose.row,
        sequence: Some(frame.purpose.sequence),
        object: frame.purpose.object.clone(),
        filter: frame.purpose.filter.clone(),
        image_type: frame.purpose.image_type.clone(),
        exposure_s: frame.exposure_s,
        bin: frame.bin,
        width_px: frame.width_px,
        height_px: frame.height_px,
        ra_deg: fact(|facts| facts.ra_deg),
        dec_deg: fact(|facts| facts.dec_deg),
        fwhm_arcsec: fact(|facts| Some(facts.fwhm_px? * facts.scale_arcsec_px?)),
        stars: facts.and_then(|facts| facts.stars),
        sky_adu: fact(|facts| facts.sky_adu),
        refused: facts.and_then(|facts| facts.refused.clone()),
        calibrates: None,
    }
}

/// Is this place on a pixel of the frame, by its solution?
fn covers(facts: Option<&FrameFacts>, frame: &Frame, place: SkyPlace) -> bool {
    let Some(wcs) = facts.and_then(|facts| facts.wcs.as_ref()) else { return false };
    let [ra, dec] = [place.ra_deg, place.dec_deg].map(Angle::from_degrees);
    let within = |at: f64, length_px: u32| at >= -0.5 && at < f64::from(length_px) - 0.5;
    let pixel = solution::wcs(wcs).sky_to_pixel(ra, dec);
    pixel.is_some_and(|(x, y)| within(x, frame.width_px) && within(y, frame.height_px))
}

#[cfg(test)]
#[path = "search_tests.rs"]
mod tests;
