//! The verdict with its reasons, and the permit that carries it to a dome.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::{BootId, Payload};

/// May the sky be let in?
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Yes, on evidence over the whole dwell time.
    Safe,
    /// No, or not known.
    Unsafe,
}

/// The verdict and what it rests on, every second and at each change.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct SafetyState {
    /// The verdict.
    pub verdict: Verdict,
    /// Sky time since when it stands.
    pub since_utc: Utc,
    /// Why it is unsafe; empty when safe.
    pub reasons: Vec<Unsafe>,
    /// Why the sky is not exposed although it may be safe; the dome stays open.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub suspended: Vec<Unsafe>,
    /// What is close to a limit, and changes nothing.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub advisories: Vec<Unsafe>,
    /// Sky seconds until all known dwell times have run out; absent where nobody can know.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_to_safe_s: Option<f64>,
    /// Every input with its newest value and age.
    pub inputs: Vec<InputState>,
    /// Directions that no telescope is to point to now; the rest of the sky may be observed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub avoid: Vec<Sector>,
    /// The verdicts of late, the newest last, which lasts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub intervals: Vec<Interval>,
}

impl Payload for SafetyState {
    const NAME: &'static str = "observatory.safety";
}

/// A sector of the sky, from the horizon to the zenith.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Sector {
    /// Its middle, degrees from north through east.
    pub azimuth_deg: f64,
    /// It reaches so far to both sides, degrees.
    pub half_width_deg: f64,
    /// Why, in words.
    pub why: String,
}

impl Sector {
    /// Does it contain this azimuth, degrees?
    pub fn contains(&self, azimuth_deg: f64) -> bool {
        let apart = (azimuth_deg - self.azimuth_deg + 180.0).rem_euclid(360.0) - 180.0;
        apart.abs() <= self.half_width_deg
    }
}

/// A verdict from its beginning to its end.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Interval {
    /// The verdict.
    pub verdict: Verdict,
    /// Sky time when it began.
    pub from_utc: Utc,
    /// Sky time when it ended; absent for the one that lasts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_utc: Option<Utc>,
    /// Why it was unsafe, each input in the words of its first time.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub reasons: Vec<String>,
}

/// One reason to be unsafe.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Unsafe {
    /// The input, such as `safetymonitor/monitor` or `wx/Humidity`.
    pub input: String,
    /// What is wrong with it, in words with the value and the limit.
    pub why: String,
    /// Sky seconds until this reason can end by itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clears_in_s: Option<f64>,
}

/// One input of the verdict.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct InputState {
    /// The input.
    pub input: String,
    /// Newest value in words.
    pub value: String,
    /// Machine seconds since it arrived; absent where none did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub age_s: Option<f64>,
    /// True while it speaks for safety.
    pub good: bool,
    /// What it is held against; empty for inputs without a number.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub limits: Vec<InputLimit>,
}

/// A limit of an input, as the configuration has it.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct InputLimit {
    /// Bad above this, in the property's ASCOM unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub upper: Option<f64>,
    /// Bad below this, in the same unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lower: Option<f64>,
    /// The dwell after a violation, sky seconds; absent where it never ends by itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dwell_s: Option<f64>,
}

/// May this dome be open? Renewed every second; silence is a no.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Permit {
    /// The verdict.
    pub verdict: Verdict,
    /// The commander, such as `observatory/alpha`.
    pub commander: String,
    /// Fencing token of the commander's lease.
    pub token: u64,
    /// The newest number received from this dome's guard; the permit is as old as that number.
    pub guard_number: u64,
    /// Incarnation of the guard that published the number.
    pub guard_boot_id: BootId,
}

impl Payload for Permit {
    const NAME: &'static str = "observatory.permit";
}
