//! How long to expose: light that changes exponentially, estimated from the levels of the earlier frames.
//!
//! With the rate `R` at the start of an exposure and `b` the slope of its logarithm, an exposure of `T` collects
//! `R (exp(b T) - 1) / b`, so a wanted signal `S` takes `T = ln(1 + b S / R) / b`, and `S / R` where nothing changes
//! (docs/formulae.md, "Twilight"). For a panel `b` is 0.

use units::Utc;

/// The wanted level of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Want {
    /// Median, bias included, ADU.
    pub target_adu: f64,
    /// A frame counts this close to it, ADU.
    pub tolerance_adu: f64,
    /// Median without light, ADU.
    pub bias_adu: f64,
    /// Shortest exposure, s.
    pub min_s: f64,
    /// Longest exposure, s.
    pub max_s: f64,
}

/// The brightness of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Level {
    /// Its median, ADU.
    Adu(f64),
    /// So bright that the median has no value.
    Saturated,
}

/// A frame that was measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// When its exposure began.
    pub started: Utc,
    /// Its length, s.
    pub exposure_s: f64,
    /// Its brightness.
    pub level: Level,
    /// It shows a part of the sensor only, whose mean need not be that of a whole frame.
    pub is_part: bool,
}

/// Whether a filter can be used at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ready {
    /// A good frame takes so long, s.
    Now(f64),
    /// The shortest exposure is too bright.
    TooBright,
    /// The longest exposure is too dark.
    TooDark,
}

/// Target and tolerance where the camera's block names none: of the largest value, and of the target.
const TARGET: f64 = 0.45;
const TOLERANCE: f64 = 0.2;
/// Less of the wanted signal than this share shows the bias rather than the light.
const LEAST_SHARE: f64 = 0.01;
/// ... and less than this, ADU.
const LEAST_ADU: f64 = 20.0;
/// A median that is cut off is taken for so many times the wanted signal.
const SATURATED: f64 = 4.0;
/// An exposure at its limit is taken while its level is expected within this share of the tolerance.
const AT_LIMIT: f64 = 0.5;
/// Two frames give the slope if they are so far apart, s; nearer ones show noise.
const APART_S: f64 = 5.0;
/// ... and no further: the slope itself changes.
const TOGETHER_S: f64 = 300.0;
/// The limits of a slope, as a factor of the expected one: beyond them the change comes from clouds.
const SLOPES: (f64, f64) = (0.3, 2.5);

impl Want {
    /// As a camera's block has it, with its largest value, ADU; without a bias level where that is to be found first.
    pub fn of(config: &config::Flats, max_adu: f64) -> Self {
        let target_adu = config.target_adu.unwrap_or(TARGET * max_adu);
        Self {
            target_adu,
            tolerance_adu: config.tolerance_adu.unwrap_or(TOLERANCE * target_adu),
            bias_adu: config.bias_adu.unwrap_or(0.0),
            min_s: config.exposure_min_s,
            max_s: config.exposure_max_s,
        }
    }

    /// The exposure of a first look, s, where so much is known of the light.
    pub fn first_look_s(&self, ready: Option<Ready>) -> f64 {
        let most_s = self.sounding_max_s();
        match ready {
            Some(Ready::Now(exposure_s)) => exposure_s.min(most_s),
            Some(Ready::TooDark) => most_s,
            Some(Ready::TooBright) | None => self.min_s,
        }
    }

    /// Does a frame count?
    pub fn accepts(&self, level: Level) -> bool {
        matches!(level, Level::Adu(adu) if (adu - self.target_adu).abs() <= self.tolerance_adu)
    }

    /// The wanted signal, ADU.
    pub fn signal_adu(&self) -> f64 {
        self.target_adu - self.bias_adu
    }

    fn least_adu(&self) -> f64 {
        (LEAST_SHARE * self.signal_adu()).max(LEAST_ADU)
    }

    /// Longest exposure that is worth taking only to measure the brightness, s: a filter that is dark in it cannot be
    /// used.
    pub fn sounding_max_s(&self) -> f64 {
        (0.1 * self.max_s).max(self.min_s)
    }

    /// The exposure of another look, s, after a frame that was too bright or too dark to measure; `None` when it was
    /// good enough.
    pub fn sound_again_s(&self, seen: &Seen) -> Option<f64> {
        let most_s = self.sounding_max_s();
        match seen.level {
            Level::Saturated if seen.exposure_s > self.min_s => Some((seen.exposure_s / 8.0).max(self.min_s)),
            Level::Adu(adu) if adu - self.bias_adu < self.least_adu() && seen.exposure_s < most_s => Some(most_s),
            Level::Saturated | Level::Adu(_) => None,
        }
    }

    /// The mean rate of a frame, ADU per s; a bound where the frame gives no better value.
    fn rate(&self, seen: &Seen) -> (f64, bool) {
        let exposure_s = seen.exposure_s.max(1e-3);
        match seen.level {
            Level::Saturated => (SATURATED * self.signal_adu() / exposure_s, false),
            Level::Adu(adu) if adu - self.bias_adu < self.least_adu() => (self.least_adu() / exposure_s, false),
            Level::Adu(adu) => ((adu - self.bias_adu) / exposure_s, true),
        }
    }
}

/// The light of one filter, as its last frame showed it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Point {
    middle: Utc,
    ln_rate: f64,
    is_part: bool,
    is_sure: bool,
}

/// The light of all filters of a row: how bright each is, and how fast all of them change together.
#[derive(Debug, Clone)]
pub struct Light {
    want: Want,
    /// The slope that follows from the Sun's motion, per s.
    expected: f64,
    slope: f64,
    points: Vec<Option<Point>>,
}

impl Light {
    /// Of so many filters, with the slope of the logarithm of their light that is expected, per s.
    pub fn new(want: Want, filters: usize, expected: f64) -> Self {
        Self { want, expected, slope: expected, points: vec![None; filters] }
    }

    /// The slope of the logarithm of the light, per s.
    pub fn slope(&self) -> f64 {
        self.slope
    }

    /// Learns from a frame.
    pub fn see(&mut self, filter: usize, seen: &Seen) {
        let (rate, is_sure) = self.want.rate(seen);
        let half = 0.5 * self.slope * seen.exposure_s;
        // The mean over the exposure is a little more than the value in its middle.
        let more = if half.abs() < 1e-6 { 1.0 } else { half.sinh() / half };
        let middle = seen.started.plus_seconds(0.5 * seen.exposure_s);
        let point = Point { middle, ln_rate: (rate / more).ln(), is_part: seen.is_part, is_sure };
        let Some(place) = self.points.get_mut(filter) else { return };
        let before = place.replace(point);
        if let Some(before) = before.filter(|it| it.is_sure && is_sure && it.is_part == point.is_part) {
            self.learn_slope(&before, &point);
        }
    }

    fn learn_slope(&mut self, before: &Point, now: &Point) {
        let apart_s = now.middle.seconds_since(before.middle);
        if self.expected == 0.0 || !(APART_S..=TOGETHER_S).contains(&apart_s) {
            return;
        }
        let share = (now.ln_rate - before.ln_rate) / apart_s / self.expected;
        self.slope = 0.5 * (self.slope + self.expected * share.clamp(SLOPES.0, SLOPES.1));
    }

    /// Forgets how bright a filter was.
    pub fn forget(&mut self, filter: usize) {
        if let Some(place) = self.points.get_mut(filter) {
            *place = None;
        }
    }

    /// The time since a filter's light was last seen, s; `None`: never.
    pub fn age_s(&self, filter: usize, now: Utc) -> Option<f64> {
        Some(now.seconds_since((*self.points.get(filter)?)?.middle))
    }

    /// The rate expected at a moment, ADU per s; `None` where nothing is known of it.
    pub fn rate(&self, filter: usize, at: Utc) -> Option<f64> {
        let point = (*self.points.get(filter)?)?;
        Some((point.ln_rate + self.slope * at.seconds_since(point.middle)).exp())
    }

    /// Whether a filter can be used in an exposure that begins then; `None` where nothing is known of its light.
    pub fn ready(&self, filter: usize, at: Utc) -> Option<Ready> {
        let (rate, want) = (self.rate(filter, at)?, &self.want);
        let exposure_s = exposure_s(want.signal_adu(), rate, self.slope);
        if (want.min_s..=want.max_s).contains(&exposure_s) {
            return Some(Ready::Now(exposure_s));
        }
        let limit_s = if exposure_s < want.min_s { want.min_s } else { want.max_s };
        let off_adu = signal_adu(limit_s, rate, self.slope) - want.signal_adu();
        Some(match off_adu {
            off if off.abs() <= AT_LIMIT * want.tolerance_adu => Ready::Now(limit_s),
            off if off > 0.0 => Ready::TooBright,
            _ => Ready::TooDark,
        })
    }

    /// How long until a good frame of a filter can be begun, s; infinite where the light goes the other way.
    pub fn wait_s(&self, filter: usize, at: Utc) -> f64 {
        let limit_s = match self.ready(filter, at) {
            None | Some(Ready::Now(_)) => return 0.0,
            Some(Ready::TooBright) if self.slope < 0.0 => self.want.min_s,
            Some(Ready::TooDark) if self.slope > 0.0 => self.want.max_s,
            Some(Ready::TooBright | Ready::TooDark) => return f64::INFINITY,
        };
        let now_adu = self.rate(filter, at).map_or(0.0, |rate| signal_adu(limit_s, rate, self.slope));
        // Signals go with the rate: all of them change alike.
        let wait_s = (self.want.signal_adu() / now_adu).ln() / self.slope;
        if wait_s.is_finite() { wait_s.max(0.0) } else { f64::INFINITY }
    }
}

/// The exposure that collects a signal, s, from a rate at its start whose logarithm changes with `slope` per s;
/// infinite where the light fades before so much is collected.
pub fn exposure_s(signal_adu: f64, rate: f64, slope: f64) -> f64 {
    if rate <= 0.0 || !rate.is_finite() {
        return f64::INFINITY;
    }
    let steady_s = signal_adu / rate;
    let grown = slope * steady_s;
    if grown.abs() < 1e-6 {
        steady_s
    } else if grown <= -1.0 {
        f64::INFINITY
    } else {
        grown.ln_1p() / slope
    }
}

/// The signal that an exposure collects, ADU; the inverse of [`exposure_s`].
pub fn signal_adu(exposure_s: f64, rate: f64, slope: f64) -> f64 {
    let grown = slope * exposure_s;
    if grown.abs() < 1e-6 { rate * exposure_s } else { rate * grown.exp_m1() / slope }
}

#[cfg(test)]
#[path = "exposure_tests.rs"]
mod tests;
