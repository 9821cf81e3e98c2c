//! The parts of a report that are counted: time by class, targets, rows, orders, guiding.

use std::collections::BTreeMap;

use contract::observatory::{RowState, RowStatus};
use serde::Serialize;
use units::Utc;

use crate::class::Group;
use crate::curve::median;
use crate::events::{FrameRecord, NightEvents};
use crate::timeline::Timeline;

/// The time of one group.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GroupTime {
    /// The group.
    pub group: Group,
    /// s.
    pub time_s: f64,
    /// Of the whole span, 0 to 1.
    pub share: f64,
    /// By kind, the longest first.
    pub kinds: Vec<KindTime>,
}

/// The time of one kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KindTime {
    /// The kind of overhead, the limit, the device or the reason.
    pub kind: String,
    /// s.
    pub time_s: f64,
}

/// The time by group; each group occurs, also one without time.
pub fn times(timeline: &Timeline) -> Vec<GroupTime> {
    let mut sums: BTreeMap<Group, BTreeMap<&str, i64>> = BTreeMap::new();
    for piece in &timeline.pieces {
        let kinds = sums.entry(piece.class.group).or_default();
        *kinds.entry(&piece.class.kind).or_default() += piece.to_ms - piece.from_ms;
    }
    let whole: i64 = timeline.pieces.iter().map(|piece| piece.to_ms - piece.from_ms).sum();
    let of = |group: Group| {
        let kinds = sums.get(&group).cloned().unwrap_or_default();
        let sum: i64 = kinds.values().sum();
        let mut kinds: Vec<KindTime> = kinds
            .into_iter()
            .map(|(kind, ms)| KindTime { kind: kind.to_owned(), time_s: ms as f64 / 1000.0 })
            .collect();
        kinds.sort_by(|a, b| b.time_s.total_cmp(&a.time_s));
        let share = if whole > 0 { sum as f64 / whole as f64 } else { 0.0 };
        GroupTime { group, time_s: sum as f64 / 1000.0, share, kinds }
    };
    Group::ALL.map(of).to_vec()
}

/// The frames of a target.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Target {
    /// OBJECT.
    pub object: String,
    /// Frames that the rows of the schedule ask for; absent where one of them asks for frames until its end.
    pub frames_asked: Option<u32>,
    /// Frames stored.
    pub frames_taken: u32,
    /// Frames stored that are not refused.
    pub frames_counted: u32,
    /// Light of the frames that count, s.
    pub exposure_s: f64,
    /// What was measured, by filter, camera, binning and exposure.
    pub quality: Vec<Quality>,
}

/// Medians of the frames of a target that can be compared: in one filter, of one camera, binning and exposure.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Quality {
    /// The filter.
    pub filter: Option<String>,
    /// The camera.
    pub camera: String,
    /// Its binning.
    pub bin: u32,
    /// Light of each frame, s.
    pub exposure_s: f64,
    /// Frames.
    pub frames: u32,
    /// Frames whose place on the sky was found.
    pub frames_solved: u32,
    /// Width of the stars, arcsec.
    pub fwhm_arcsec: Option<f64>,
    /// Sky, ADU.
    pub sky_adu: Option<f64>,
    /// Ellipticity of the stars, 0 to 1.
    pub ellipticity: Option<f64>,
    /// Share of the starlight that came through, 0 to 1.
    pub transparency: Option<f64>,
    /// How far from the target, arcmin.
    pub off_target_arcmin: Option<f64>,
}

fn is_science(frame: &FrameRecord) -> bool {
    crate::class::of_frame(&frame.action, &frame.image_type).is_some_and(|class| class.group == Group::OpenShutter)
}

/// The newest state of each row of the schedule that was active last.
pub fn rows(events: &NightEvents) -> Vec<RowState> {
    let mut rows: BTreeMap<u32, &RowState> = BTreeMap::new();
    for change in &events.rows {
        rows.insert(change.row.row, &change.row);
    }
    let count = events.schedules.iter().max_by_key(|held| held.from).map_or(u32::MAX, |held| held.state.rows);
    rows.into_iter().filter(|(row, _)| *row < count).map(|(_, state)| state.clone()).collect()
}

/// The targets, in the order of their first frames; those without a frame last.
pub fn targets(events: &NightEvents) -> Vec<Target> {
    let mut order: Vec<&str> = Vec::new();
    let mut by_object: BTreeMap<&str, Vec<&FrameRecord>> = BTreeMap::new();
    for frame in events.frames.iter().filter(|frame| is_science(frame)) {
        let object = frame.object.as_deref().unwrap_or_default();
        if !by_object.contains_key(object) {
            order.push(object);
        }
        by_object.entry(object).or_default().push(frame);
    }
    let rows = rows(events);
    let mut asked: BTreeMap<&str, Option<u32>> = BTreeMap::new();
    for row in rows.iter().filter(|row| row.action == "object") {
        let object = row.object.as_deref().unwrap_or_default();
        let sum = asked.entry(object).or_insert(Some(0));
        *sum = sum.zip(row.frames_wanted).map(|(sum, wanted)| sum.saturating_add(wanted));
        if !order.contains(&object) {
            order.push(object);
        }
    }
    let target = |object: &str| {
        let frames = by_object.get(object).cloned().unwrap_or_default();
        let counted = || frames.iter().filter(|frame| frame.refused.is_none());
        // Counts of two cameras, binnings or exposures have no median in common.
        let mut alike: BTreeMap<_, Vec<&FrameRecord>> = BTreeMap::new();
        for frame in &frames {
            alike
                .entry((frame.filter.as_deref(), &frame.camera, frame.bin, frame.exposure_us()))
                .or_default()
                .push(frame);
        }
        Target {
            object: object.to_owned(),
            frames_asked: asked.get(object).copied().flatten(),
            frames_taken: number(frames.len()),
            frames_counted: number(counted().count()),
            exposure_s: counted().map(|frame| frame.exposure_s).sum(),
            quality: alike.values().filter_map(|frames| quality(frames)).collect(),
        }
    };
    order.into_iter().map(target).collect()
}

/// Of frames that are alike; absent of none.
fn quality(frames: &[&FrameRecord]) -> Option<Quality> {
    let first = frames.first()?;
    let middle = |value: fn(&FrameRecord) -> Option<f64>| {
        median(&frames.iter().filter_map(|frame| value(frame)).collect::<Vec<f64>>())
    };
    Some(Quality {
        filter: first.filter.clone(),
        camera: first.camera.clone(),
        bin: first.bin,
        exposure_s: first.exposure_s,
        frames: number(frames.len()),
        frames_solved: number(frames.iter().filter(|frame| frame.is_solved).count()),
        fwhm_arcsec: middle(|frame| Some(frame.fwhm_px? * frame.scale_arcsec_px?)),
        sky_adu: middle(|frame| frame.sky_adu),
        ellipticity: middle(|frame| frame.ellipticity),
        transparency: middle(|frame| frame.transparency),
        off_target_arcmin: middle(|frame| frame.off_target_arcmin),
    })
}

/// How well a field was held.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Guiding {
    /// OBJECT.
    pub object: Option<String>,
    /// The camera that guided.
    pub camera: String,
    /// Its binning; absent where that is not stored.
    pub bin: Option<u32>,
    /// Frames that were measured.
    pub frames: u32,
    /// Root of the mean squared distance from the reference, px of those frames.
    pub rms_px: f64,
}

/// The guiding, by object, camera and binning: their px are different units.
pub fn guiding(events: &NightEvents) -> Vec<Guiding> {
    let mut sums: BTreeMap<_, (u32, f64)> = BTreeMap::new();
    for record in events.guiding.iter().filter(|record| record.off_px.is_finite()) {
        let sum = sums.entry((&record.object, &record.camera, record.bin)).or_default();
        *sum = (sum.0 + 1, sum.1 + record.off_px.powi(2));
    }
    let held = sums.into_iter().map(|((object, camera, bin), (frames, sum))| Guiding {
        object: object.clone(),
        camera: camera.clone(),
        bin,
        frames,
        rms_px: (sum / f64::from(frames)).sqrt(),
    });
    held.collect()
}

/// A frame that does not count, or of which not all is known.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RefusedFrame {
    /// The file below the folder of images.
    pub file: String,
    /// When it began.
    pub started_utc: Utc,
    /// OBJECT.
    pub object: Option<String>,
    /// Why.
    pub why: String,
}

/// The frames that do not count.
pub fn refused(events: &NightEvents) -> Vec<RefusedFrame> {
    let of = |frame: &FrameRecord| {
        Some(RefusedFrame {
            file: frame.file.clone(),
            started_utc: frame.started,
            object: frame.object.clone(),
            why: frame.refused.clone()?,
        })
    };
    events.frames.iter().filter_map(of).collect()
}

/// What is on disk.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Disk {
    /// Frames of all kinds.
    pub frames: u32,
    /// Their files, bytes.
    pub bytes: u64,
    /// Frames whose header lacks values yet.
    pub headers_incomplete: u32,
    /// Frames of which not all could be measured.
    pub frames_unmeasured: u32,
    /// Bytes that are free in the folder of images.
    pub free_bytes: Option<u64>,
}

/// What is on disk.
pub fn disk(events: &NightEvents) -> Disk {
    let count = |is: fn(&FrameRecord) -> bool| number(events.frames.iter().filter(|frame| is(frame)).count());
    Disk {
        frames: count(|_| true),
        bytes: events.frames.iter().map(|frame| frame.bytes).sum(),
        headers_incomplete: count(|frame| !frame.is_complete),
        frames_unmeasured: count(|frame| frame.unmeasured.is_some()),
        free_bytes: events.free_bytes,
    }
}

/// A length of time as people read it.
pub(crate) fn hours(time_s: f64) -> String {
    // `as` saturates.
    let whole = time_s.round() as i64;
    match whole {
        3600.. => format!("{} h {:02} min", whole / 3600, whole % 3600 / 60),
        60.. => format!("{} min {:02} s", whole / 60, whole % 60),
        // Adding 0 makes of -0 none.
        _ => format!("{:.1} s", (10.0 * time_s).round() / 10.0 + 0.0),
    }
}

/// Why no action was begun and no frame was taken; absent where one was.
pub fn nothing_tried(events: &NightEvents, times: &[GroupTime]) -> Option<String> {
    let has_action = events.doings.iter().any(|held| !held.state.actions.is_empty());
    if has_action || !events.frames.is_empty() {
        return None;
    }
    let of_time = |time: &GroupTime| {
        let longest = time.kinds.first().map_or("", |kind| kind.kind.as_str());
        format!("{} {} ({longest})", time.group.words(), hours(time.time_s))
    };
    let spent: Vec<String> = times.iter().filter(|time| time.time_s > 0.0).map(of_time).collect();
    Some(match spent.as_slice() {
        [] => "The Sun did not set.".to_owned(),
        spent => format!("The night was {}.", spent.join(", ")),
    })
}

/// How the rows ended.
pub fn status_word(status: RowStatus) -> &'static str {
    match status {
        RowStatus::Pending => "pending",
        RowStatus::Running => "running",
        RowStatus::Interrupted => "interrupted",
        RowStatus::Finished => "finished",
        RowStatus::Failed => "failed",
        RowStatus::Skipped => "skipped",
    }
}

fn number(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}
