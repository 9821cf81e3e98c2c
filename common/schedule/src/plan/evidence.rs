//! Overheads from telemetry: from the frames that were taken, and from the nodes' diaries.

use std::collections::BTreeMap;

use config::Observatory;
use contract::device::camera::Frame;
use contract::frame_search::FoundFrame;
use units::Utc;

use super::overheads::{Figure, Overheads, Sensor, TOOK, TimedPart};

/// The telemetry of earlier nights.
#[derive(Debug, Clone, Default)]
pub struct Evidence {
    /// Frames in any order.
    pub frames: Vec<TakenFrame>,
    /// Lines of diaries: when, and the message with its fields as `name=value`.
    pub lines: Vec<(Utc, String)>,
}

/// A frame of an earlier night.
#[derive(Debug, Clone, PartialEq)]
pub struct TakenFrame {
    camera: String,
    action: String,
    night: String,
    row: Option<u32>,
    sequence: u32,
    started: Utc,
    exposure_s: f64,
    /// Unbinned px.
    size_px: [u32; 2],
    /// Pixels of the image, of all planes.
    pixels: f64,
    /// Of its file.
    bytes: u64,
}

impl TakenFrame {
    /// From its announcement, and the bytes of its file.
    pub fn of(frame: &Frame, bytes: u64) -> Self {
        let Frame { camera, purpose, width_px, height_px, planes, bin, started_utc, exposure_s, .. } = frame;
        Self {
            camera: camera.clone(),
            action: purpose.action.clone(),
            night: purpose.night.clone(),
            row: purpose.row,
            sequence: purpose.sequence,
            started: *started_utc,
            exposure_s: *exposure_s,
            size_px: [*width_px, *height_px].map(|px| px.saturating_mul((*bin).max(1))),
            pixels: f64::from(*width_px) * f64::from(*height_px) * f64::from((*planes).max(1)),
            bytes,
        }
    }
}

impl From<FoundFrame> for TakenFrame {
    fn from(frame: FoundFrame) -> Self {
        let size_px = [frame.width_px, frame.height_px].map(|px| px.saturating_mul(frame.bin.max(1)));
        Self {
            camera: frame.camera,
            action: frame.action.unwrap_or_default(),
            night: frame.night,
            row: frame.row,
            // Frames of an archive that does not number them follow no other.
            sequence: frame.sequence.unwrap_or(u32::MAX),
            started: frame.at_utc,
            exposure_s: frame.exposure_s,
            size_px,
            pixels: f64::from(frame.width_px) * f64::from(frame.height_px),
            bytes: frame.bytes,
        }
    }
}

/// Two frames of a row with more between them were not one after the other, s: the dome was shut, or a person stepped
/// in.
const LONGEST_GAP_S: f64 = 900.0;
/// The time per degree is learned where there are so many slews, ...
const FEWEST_SLEWS: usize = 5;
/// ... over ways that differ by so much, deg, ...
const SPREAD_DEG: f64 = 20.0;
/// ... the newest so many: all pairs are looked at.
const MOST_SLEWS: usize = 200;

/// A length that a diary contains.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Took {
    span: TimedPart,
    took_s: f64,
    deg: Option<f64>,
}

impl Evidence {
    /// The overheads that the telemetry gives, the rest as [`Overheads::assumed`] has it.
    pub fn overheads(&self, config: &Observatory) -> Overheads {
        let mut overheads = Overheads::assumed(config);
        let took: Vec<Took> = self.lines.iter().filter_map(|(_, line)| took(line)).collect();
        for span in TimedPart::ALL.into_iter().filter(|span| *span != TimedPart::Slew) {
            let lengths = took.iter().filter(|took| took.span == span).map(|took| took.took_s).collect();
            if let Some(figure) = median(lengths) {
                overheads.set_span(span, figure);
            }
        }
        learn_slews(&took, &mut overheads);
        for (action, gaps) in gaps(&self.frames) {
            overheads.frame_s.extend(median(gaps).map(|figure| (action, figure)));
        }
        overheads.sensors = sensors(&self.frames);
        overheads
    }
}

/// The length in a line of a diary, if it is about one.
fn took(line: &str) -> Option<Took> {
    let fields = line.strip_prefix(TOOK)?.strip_prefix(' ')?;
    let field = |name: &str| fields.split(' ').find_map(|word| word.strip_prefix(name)?.strip_prefix('='));
    let word = field("span")?;
    let span = TimedPart::ALL.into_iter().find(|span| span.word() == word)?;
    let number = |name| field(name).and_then(|text| text.parse::<f64>().ok()).filter(|number| number.is_finite());
    Some(Took { span, took_s: number("took_s").filter(|took_s| *took_s >= 0.0)?, deg: number("deg") })
}

/// The median, of so many; `None` of nothing.
fn median(mut values: Vec<f64>) -> Option<Figure> {
    values.retain(|value| value.is_finite());
    values.sort_by(f64::total_cmp);
    let (low, high) = (values.get(values.len().checked_sub(1)? / 2)?, values.get(values.len() / 2)?);
    Some(Figure { value: 0.5 * (low + high), measured: values.len() })
}

/// The time of a slew apart from its way, and per degree: the median of the slopes of all pairs (Theil 1950, Sen 1968),
/// which a few odd slews do not move.
fn learn_slews(took: &[Took], overheads: &mut Overheads) {
    let slews: Vec<(f64, f64)> = took
        .iter()
        .filter(|took| took.span == TimedPart::Slew)
        .filter_map(|took| Some((took.deg?, took.took_s)))
        .collect();
    let slews = slews.get(slews.len().saturating_sub(MOST_SLEWS)..).unwrap_or_default();
    let ends = slews.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), (deg, _)| (a.min(*deg), b.max(*deg)));
    if slews.len() >= FEWEST_SLEWS && ends.1 - ends.0 >= SPREAD_DEG {
        let pairs = slews.iter().enumerate().flat_map(|(n, a)| slews.iter().skip(n + 1).map(move |b| (a, b)));
        let slopes = pairs.filter(|(a, b)| (a.0 - b.0).abs() > 1.0).map(|(a, b)| (b.1 - a.1) / (b.0 - a.0));
        if let Some(slope) = median(slopes.collect()) {
            overheads.slew_s_per_deg = Figure { value: slope.value.max(0.0), measured: slews.len() };
        }
    }
    let per_deg = overheads.slew_s_per_deg.value;
    if let Some(base) = median(slews.iter().map(|(deg, took_s)| (took_s - per_deg * deg).max(0.0)).collect()) {
        overheads.set_span(TimedPart::Slew, base);
    }
}

/// From the end of each exposure to the begin of the next one of the same row, by action, s.
fn gaps(frames: &[TakenFrame]) -> BTreeMap<String, Vec<f64>> {
    let mut in_order: Vec<&TakenFrame> = frames.iter().collect();
    in_order.sort_by(|a, b| (&a.camera, a.started).cmp(&(&b.camera, b.started)));
    let mut gaps: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for (before, after) in in_order.iter().zip(in_order.iter().skip(1)) {
        let follows = before.camera == after.camera
            && (&before.action, &before.night, before.row) == (&after.action, &after.night, after.row)
            && before.sequence.checked_add(1) == Some(after.sequence);
        let gap_s = after.started.seconds_since(before.started) - before.exposure_s;
        if follows && (0.0..=LONGEST_GAP_S).contains(&gap_s) {
            gaps.entry(before.action.clone()).or_default().push(gap_s);
        }
    }
    gaps
}

/// The sensor of each camera: the largest frame gives its size, and all frames the bytes of a pixel on disk.
fn sensors(frames: &[TakenFrame]) -> BTreeMap<String, Sensor> {
    let mut sensors: BTreeMap<String, (Sensor, Vec<f64>)> = BTreeMap::new();
    for frame in frames {
        let nothing = || (Sensor { size_px: [0, 0], bytes_per_px: 0.0, measured: 0 }, Vec::new());
        let (sensor, per_px) = sensors.entry(frame.camera.clone()).or_insert_with(nothing);
        sensor.size_px = [0, 1].map(|axis: usize| sensor.size_px[axis].max(frame.size_px[axis]));
        if frame.pixels > 0.0 {
            per_px.push(frame.bytes as f64 / frame.pixels);
        }
    }
    let known = sensors.into_iter().filter_map(|(camera, (sensor, per_px))| {
        let figure = median(per_px)?;
        Some((camera, Sensor { bytes_per_px: figure.value, measured: figure.measured, ..sensor }))
    });
    known.collect()
}
