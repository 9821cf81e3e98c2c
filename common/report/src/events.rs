//! What was recorded of a night: the values that a report is made of.

use contract::observatory::{ActionNow, Posture, RowState, Verdict};
use serde::{Deserialize, Serialize};
use units::Utc;

/// Everything that was recorded of a night.
#[derive(Debug, Clone, PartialEq)]
pub struct NightEvents {
    /// The site's name.
    pub site: String,
    /// The telescope's name.
    pub telescope: String,
    /// The date of the evening, such as 20261121.
    pub night: String,
    /// The noon at which the night begins.
    pub from: Utc,
    /// The noon at which it ends.
    pub to: Utc,
    /// Until when something can have happened: now, while the night runs.
    pub now: Utc,
    /// Sunset and sunrise; the two noons in a polar night; absent where the Sun does not set.
    pub dark: Option<(Utc, Utc)>,
    /// What the telescope did.
    pub doings: Vec<Held<Doing>>,
    /// The verdicts.
    pub verdicts: Vec<Held<VerdictRecord>>,
    /// The schedules that were active.
    pub schedules: Vec<Held<ScheduleRecord>>,
    /// Each change of a row, the oldest first.
    pub rows: Vec<RowChange>,
    /// Parts of rows whose duration the observatory node measured.
    pub timed: Vec<Timed>,
    /// The frames that are stored.
    pub frames: Vec<FrameRecord>,
    /// Alerts that were active in the night.
    pub alerts: Vec<AlertRecord>,
    /// Orders of people.
    pub orders: Vec<OrderRecord>,
    /// Focus runs.
    pub focus: Vec<FocusRecord>,
    /// Guided frames that held the frames of targets, each once for an object.
    pub guiding: Vec<GuideRecord>,
    /// Fluxes of stars, by frame.
    pub fluxes: Vec<FluxRecord>,
    /// Bytes that are free where the frames are stored, where that is known.
    pub free_bytes: Option<u64>,
    /// Stored rows that could not be read and are left out, each with the reason.
    pub unreadable: Vec<String>,
}

impl NightEvents {
    /// A night of which nothing was recorded.
    pub fn new(from: Utc, to: Utc, now: Utc) -> Self {
        Self {
            site: String::new(),
            telescope: String::new(),
            night: String::new(),
            from,
            to,
            now,
            dark: None,
            doings: Vec::new(),
            verdicts: Vec::new(),
            schedules: Vec::new(),
            rows: Vec::new(),
            timed: Vec::new(),
            frames: Vec::new(),
            alerts: Vec::new(),
            orders: Vec::new(),
            focus: Vec::new(),
            guiding: Vec::new(),
            fluxes: Vec::new(),
            free_bytes: None,
            unreadable: Vec::new(),
        }
    }
}

/// A state that was received from one instant to another, without a gap.
#[derive(Debug, Clone, PartialEq)]
pub struct Held<T> {
    /// When it was received first.
    pub from: Utc,
    /// When it was received last.
    pub until: Utc,
    /// The incarnation of its publisher.
    pub boot: String,
    /// The sequence number of its first sample: an incarnation begins with 0.
    pub seq: u64,
    /// The state.
    pub state: T,
}

/// What a telescope does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Doing {
    /// The robotic switch.
    pub robotic: bool,
    /// Dome and mount.
    pub posture: Posture,
    /// The schedule has ended and everything is closed.
    pub ended: bool,
    /// Speed of sky time.
    pub speed: f64,
    /// The devices, and the time, are simulated.
    pub simulated: bool,
    /// The actions under way.
    pub actions: Vec<ActionNow>,
}

/// A verdict with its reasons.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VerdictRecord {
    /// The verdict.
    pub verdict: Verdict,
    /// Why the dome has to be closed.
    pub reasons: Vec<Reason>,
    /// Why the sky is not exposed although the dome may be open.
    pub suspended: Vec<Reason>,
}

/// A reason to be unsafe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reason {
    /// The input, such as `wx/Humidity`.
    pub input: String,
    /// In words, as they were at first.
    pub why: String,
    /// The input has no usable value: a fault of the device, and no weather.
    #[serde(default)]
    pub is_missing: bool,
}

/// The schedule that is active.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ScheduleRecord {
    /// Its file.
    pub file: String,
    /// Counts its versions.
    pub revision: u64,
    /// Why the newest file was not taken.
    pub refused: Option<String>,
    /// How many rows it has.
    pub rows: u32,
}

/// A row from this instant on.
#[derive(Debug, Clone, PartialEq)]
pub struct RowChange {
    /// When.
    pub at: Utc,
    /// The row.
    pub row: RowState,
}

/// A part of a row whose duration was measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Timed {
    /// When it ended.
    pub until: Utc,
    /// How long it took, s.
    pub took_s: f64,
    /// The word of the part, such as `filter`.
    pub part: String,
}

/// A stored frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameRecord {
    /// Its id.
    pub id: String,
    /// The path of the file below the folder of images.
    pub file: String,
    /// Which camera.
    pub camera: String,
    /// The action that it was taken for.
    pub action: String,
    /// IMAGETYP.
    pub image_type: String,
    /// OBJECT.
    pub object: Option<String>,
    /// The filter.
    pub filter: Option<String>,
    /// The row of the schedule.
    pub row: Option<u32>,
    /// When the shutter opened.
    pub started: Utc,
    /// Seconds of light.
    pub exposure_s: f64,
    /// Binning: px and counts of two binnings are two units.
    pub bin: u32,
    /// Size of the file.
    pub bytes: u64,
    /// All keywords are in the header.
    pub is_complete: bool,
    /// Why it does not count.
    pub refused: Option<String>,
    /// Why nothing, or not all, could be measured.
    pub unmeasured: Option<String>,
    /// It was solved.
    pub is_solved: bool,
    /// Width of the stars, px.
    pub fwhm_px: Option<f64>,
    /// Size of a pixel, arcsec.
    pub scale_arcsec_px: Option<f64>,
    /// Ellipticity of the stars.
    pub ellipticity: Option<f64>,
    /// Sky, ADU.
    pub sky_adu: Option<f64>,
    /// Share of the starlight that came through.
    pub transparency: Option<f64>,
    /// How far from the target, arcmin.
    pub off_target_arcmin: Option<f64>,
    /// Airmass in the middle of the exposure.
    pub airmass: Option<f64>,
}

impl FrameRecord {
    /// The exposure as it was asked for, so that frames of one exposure are known to be such; `as` saturates.
    pub(crate) fn exposure_us(&self) -> i64 {
        (1e6 * self.exposure_s).round() as i64
    }
}

/// An alert from when it was raised.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AlertRecord {
    /// Names the cause, such as `dome-not-closed/dome_1`.
    pub id: String,
    /// How urgent, in a word.
    pub priority: String,
    /// When it was raised.
    pub raised_utc: Utc,
    /// When it was no longer active.
    pub cleared_utc: Option<Utc>,
    /// What happened.
    pub cause: String,
    /// The person who acknowledged it.
    pub acknowledged_by: Option<String>,
}

/// An order of a person.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct OrderRecord {
    /// When.
    pub at_utc: Utc,
    /// Who.
    pub from: String,
    /// What.
    pub verb: String,
    /// What became of it.
    pub outcome: String,
}

/// A focus run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FocusRecord {
    /// When it began.
    pub started_utc: Utc,
    /// Which camera.
    pub camera: String,
    /// The filter.
    pub filter: Option<String>,
    /// How it ended.
    pub outcome: String,
    /// Why it failed.
    pub reason: Option<String>,
    /// The best position, steps.
    pub best_position: Option<f64>,
    /// Its standard error, steps.
    pub best_position_error: Option<f64>,
}

/// What guiding measured on a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct GuideRecord {
    /// The object that was held.
    pub object: Option<String>,
    /// The camera that guided.
    pub camera: String,
    /// Binning of its frame; absent where that is not stored.
    pub bin: Option<u32>,
    /// How far the field was from its reference, px of that frame.
    pub off_px: f64,
}

/// The flux of a star on a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FluxRecord {
    /// The frame.
    pub frame: String,
    /// The series of frames that are compared: object, filter, camera and so on.
    pub series: String,
    /// 0 is the target, others are comparison stars.
    pub star: u32,
    /// Column, px.
    pub x_px: f64,
    /// Row, px.
    pub y_px: f64,
    /// Flux above the sky, ADU.
    pub flux_adu: f64,
    /// Its standard error, ADU.
    pub error_adu: f64,
    /// A pixel of it is saturated.
    pub is_saturated: bool,
}
