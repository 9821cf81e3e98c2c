//! What the facts of several frames show together: the focus drifts, clouds come, the stars trail, the field is wrong, the
//! target is too bright.
//!
//! Pure: frames with their facts in, active triggers out. Frames are compared only within a *run*: one camera and
//! filter on one row of the schedule, with the same object, exposure time and binning, because another field has other
//! stars and another row may want another focus. Only `object` frames count: a focus sweep is blurred on purpose.

use std::collections::{BTreeMap, VecDeque};

use contract::device::camera::Frame;
use contract::observatory::{FrameFacts, Trigger, TriggerKind};
use units::Utc;

use super::widths::Widths;

/// Frames whose median width is compared: one frame of bad seeing proves nothing.
const WIDE: usize = 5;
/// Wider than the best by this ratio is a drift; it ends at the lower one.
const DRIFT: (f64, f64) = (1.3, 1.15);
/// The best width is that of so many frames: a width that has lasted for longer is the present one.
const WINDOW: usize = 60;
/// Fewer stars than this share of the usual number are clouds; it ends at the higher one.
const CLOUDS: (f64, f64) = (0.3, 0.5);
/// Extinction of clear air is no more, mag per airmass: that of the ultraviolet.
const EXTINCTION_MAG: f64 = 0.6;
/// Frames that give the usual number: at least, at most.
const USUAL: (usize, usize) = (3, 20);
/// Fewer stars than this come and go by themselves.
const FEWEST: f64 = 10.0;
/// A run whose last frame began so long ago, and twice its exposure, does not show what is now, sky s.
const STALE_S: f64 = 900.0;

/// The triggers of one telescope.
#[derive(Debug, Clone, Default)]
pub struct Triggers {
    runs: BTreeMap<(String, Option<String>), ComparableFrames>,
}

/// Frames that can be compared.
#[derive(Debug, Clone)]
struct ComparableFrames {
    field: Field,
    /// Start of the newest frame.
    newest: Utc,
    exposure_s: f64,
    /// Widths that are believed, with the starts of the frames that made them so.
    widths: VecDeque<(Utc, f64)>,
    believed: Widths,
    /// Star counts of frames without clouds.
    counts: VecDeque<f64>,
    /// Start of the first of the trailed frames that the run ends with.
    trailed: Option<Utc>,
    /// Start of the first of the frames of a wrong field that the run ends with.
    astray: Option<Utc>,
    /// Start of the first of the frames with a saturated target that the run ends with.
    too_bright: Option<Utc>,
    active: BTreeMap<TriggerKind, Trigger>,
}

/// What must be the same for frames to be compared.
#[derive(Debug, Clone)]
struct Field {
    night: String,
    row: Option<u32>,
    object: Option<String>,
    exposure_s: f64,
    bin: u32,
    size_px: [u32; 2],
}

impl Field {
    fn is_like(&self, other: &Self) -> bool {
        // Cameras report the time that the shutter was open, which differs a little from frame to frame.
        let as_long = (self.exposure_s - other.exposure_s).abs() <= 0.02 * self.exposure_s.max(other.exposure_s);
        let same = |field: &Self| (field.row, field.bin, field.size_px);
        as_long && same(self) == same(other) && self.night == other.night && self.object == other.object
    }
}

impl Triggers {
    /// Takes a measured frame in. One that is older than the newest of its run does not show what is now.
    pub fn observe(&mut self, frame: &Frame, facts: &FrameFacts) {
        let Some(stars) = facts.stars.filter(|_| frame.purpose.action == "object") else { return };
        let field = Field {
            night: frame.purpose.night.clone(),
            row: frame.purpose.row,
            object: frame.purpose.object.clone(),
            exposure_s: frame.exposure_s,
            bin: frame.bin,
            size_px: [frame.width_px, frame.height_px],
        };
        let at = frame.started_utc;
        let run = self.runs.entry((frame.camera.clone(), frame.purpose.filter.clone()));
        let run = run.or_insert_with(|| ComparableFrames::new(field.clone(), Utc::EPOCH));
        if at <= run.newest {
            return;
        }
        if !run.field.is_like(&field) {
            *run = ComparableFrames::new(field, at);
        }
        (run.newest, run.exposure_s) = (at, frame.exposure_s);
        let found = [
            (TriggerKind::Trailing, run.trailing(at, facts)),
            (TriggerKind::FocusDrift, run.drift(at, facts)),
            (TriggerKind::Clouds, run.clouds(at, stars, facts)),
            (TriggerKind::WrongField, run.wrong_field(at, facts)),
            (TriggerKind::TargetSaturated, run.target_saturated(at, facts)),
        ];
        for (kind, found) in found {
            match found {
                Some((since_utc, detail)) => {
                    let (camera, filter) = (frame.camera.clone(), frame.purpose.filter.clone());
                    let trigger = Trigger { kind, camera, filter, since_utc, detail: String::new() };
                    run.active.entry(kind).or_insert(trigger).detail = detail;
                }
                None => drop(run.active.remove(&kind)),
            }
        }
    }

    /// The active triggers, by camera, filter and kind.
    pub fn active(&self, now: Utc) -> Vec<Trigger> {
        let fresh = |run: &&ComparableFrames| now.seconds_since(run.newest) <= STALE_S + 2.0 * run.exposure_s;
        self.runs.values().filter(fresh).flat_map(|run| run.active.values().cloned()).collect()
    }
}

impl ComparableFrames {
    fn new(field: Field, newest: Utc) -> Self {
        Self {
            field,
            newest,
            exposure_s: 0.0,
            widths: VecDeque::new(),
            believed: Widths::default(),
            counts: VecDeque::new(),
            trailed: None,
            astray: None,
            too_bright: None,
            active: BTreeMap::new(),
        }
    }

    /// A trigger as it is, for a frame that says nothing of it.
    fn standing(&self, kind: TriggerKind) -> Option<(Utc, String)> {
        self.active.get(&kind).map(|trigger| (trigger.since_utc, trigger.detail.clone()))
    }

    /// Two trailed frames, one after the other.
    fn trailing(&mut self, at: Utc, facts: &FrameFacts) -> Option<(Utc, String)> {
        if facts.trailed != Some(true) {
            self.trailed = None;
            return None;
        }
        let first = *self.trailed.get_or_insert(at);
        let detail = match (facts.ellipticity, facts.elongation_deg) {
            (Some(ellipticity), Some(angle_deg)) => {
                format!("the stars are drawn out at {angle_deg:.0} deg from +x, ellipticity {ellipticity:.2}")
            }
            _ => "the stars are drawn out".to_owned(),
        };
        (first < at).then_some((first, detail))
    }

    /// Two solved frames, one after the other, that are further off their target than half of the shorter side. A frame
    /// that is not solved does not count.
    fn wrong_field(&mut self, at: Utc, facts: &FrameFacts) -> Option<(Utc, String)> {
        let Some((off_arcmin, scale)) = facts.off_target_arcmin.zip(facts.scale_arcsec_px) else {
            return self.standing(TriggerKind::WrongField);
        };
        let half_arcmin = 0.5 * f64::from(self.field.size_px[0].min(self.field.size_px[1])) * scale / 60.0;
        if off_arcmin <= half_arcmin {
            self.astray = None;
            return None;
        }
        let first = *self.astray.get_or_insert(at);
        let detail = format!("{off_arcmin:.1} arcmin off the target, with half of a side of {half_arcmin:.1} arcmin");
        (first < at).then_some((first, detail))
    }

    /// Two frames, one after the other, on which the target's star is saturated. A frame without a star there does not
    /// count.
    fn target_saturated(&mut self, at: Utc, facts: &FrameFacts) -> Option<(Utc, String)> {
        match facts.target_saturated {
            Some(true) => {
                let first = *self.too_bright.get_or_insert(at);
                let detail = format!("the star of the target is saturated at {} s of exposure", self.exposure_s);
                (first < at).then_some((first, detail))
            }
            Some(false) => {
                self.too_bright = None;
                None
            }
            None => self.standing(TriggerKind::TargetSaturated),
        }
    }

    /// The median width of the last frames that are believed against the least that as many had.
    fn drift(&mut self, at: Utc, facts: &FrameFacts) -> Option<(Utc, String)> {
        let believed = self.believed.observe_facts(facts);
        self.widths.extend(believed.into_iter().map(|width| (at, width)));
        let many = self.widths.len().saturating_sub(WINDOW);
        self.widths.drain(..many);
        let widths: Vec<f64> = self.widths.iter().map(|(_, width)| *width).collect();
        let now = median(widths.len().checked_sub(WIDE).and_then(|from| widths.get(from..))?)?;
        let best = widths.windows(WIDE).filter_map(median).fold(f64::INFINITY, f64::min);
        let stands = self.active.contains_key(&TriggerKind::FocusDrift);
        let most = if stands { DRIFT.1 } else { DRIFT.0 };
        let since = self.widths.get(self.widths.len() - WIDE)?.0;
        let detail = format!("the median FWHM of {WIDE} frames is {now:.2} px, at best it was {best:.2} px");
        (now > most * best).then_some((since, detail))
    }

    /// The stars of this frame against the median of those before, and their light against that of a clear sky.
    fn clouds(&mut self, at: Utc, stars: u32, facts: &FrameFacts) -> Option<(Utc, String)> {
        let (stars, counts) = (f64::from(stars), self.counts.make_contiguous());
        let usual = median(counts).filter(|usual| counts.len() >= USUAL.0 && *usual >= FEWEST);
        let stands = self.active.contains_key(&TriggerKind::Clouds);
        let least = if stands { CLOUDS.1 } else { CLOUDS.0 };
        match usual {
            Some(usual) if stars < least * usual => {
                Some((at, format!("{stars:.0} stars, the frames before had {usual:.0}")))
            }
            _ if cloudless_share(facts).is_some_and(|share| share < least) => {
                let percent = 100.0 * facts.transparency.unwrap_or_default();
                Some((at, format!("{percent:.0} % of the starlight comes through")))
            }
            _ => {
                self.counts.push_back(stars);
                if self.counts.len() > USUAL.1 {
                    self.counts.pop_front();
                }
                None
            }
        }
    }
}

/// Share of the starlight that comes through, were it not for the clear air: with as much extinction as any band has.
fn cloudless_share(facts: &FrameFacts) -> Option<f64> {
    let (share, airmass) = facts.transparency.zip(facts.airmass)?;
    Some(share * 10_f64.powf(0.4 * EXTINCTION_MAG * (airmass - 1.0).max(0.0)))
}

/// The middle value, the mean of the two middle ones of an even number; None of nothing.
fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    let upper = *sorted.get(middle)?;
    Some(if sorted.len() % 2 == 1 { upper } else { 0.5 * (sorted[middle - 1] + upper) })
}

#[cfg(test)]
mod tests;
