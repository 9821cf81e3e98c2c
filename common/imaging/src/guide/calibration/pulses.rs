//! Learning the matrix from pulses, for mounts without a plate solution.
//!
//! ```text
//!   West ----25 px----> East back ----> ClearNorth --3 good moves--> North ----25 px----> South back ----> Done
//!     '--60 steps--> Failed                 '--60 steps--> Failed      '--60 steps--> Failed
//! ```
//! The way South goes on until the gear holds there too; if it never does, the play is taken to be more than that. A
//! pure state machine: it is given when and where the star was (px from where it was at the start), it says which pulse
//! comes next. Steps and limits are PHD2's (docs/formulae.md, "Pulses to pixels"). At the end all ways are fitted
//! together with the mount's drift and the play of the declination gear ([`super::fit`]).

pub use super::direction::Direction;
use super::fit::{self, CalibrationFrame, StarMotion, Way};
pub use super::oddity::{NoCalibration, Warning};
use super::{Calibration, Pier};

/// How to calibrate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibrationSettings {
    /// Length of a pulse, ms.
    pub pulse_ms: u32,
    /// How far the star shall go, px; with `steps` the farthest that it may.
    pub distance_px: f64,
    /// Pulses West and North; absent: as many as the distance takes.
    pub steps: Option<usize>,
    /// Most pulses in one direction.
    pub most_steps: usize,
    /// Declination, degrees.
    pub dec_deg: f64,
    /// Side of the pier.
    pub pier: Option<Pier>,
    /// Speeds along East and North that are expected there, px/s, where the guide rates and the scale are known.
    pub expected_px_s: Option<[f64; 2]>,
}

impl Default for CalibrationSettings {
    fn default() -> Self {
        Self {
            pulse_ms: 750,
            distance_px: 25.0,
            steps: None,
            most_steps: 60,
            dec_deg: 0.0,
            pier: None,
            expected_px_s: None,
        }
    }
}

/// What to do next.
#[derive(Debug, Clone, PartialEq)]
pub enum Next {
    /// Give this pulse, let it settle, measure, and ask again.
    Pulse {
        /// Where to.
        direction: Direction,
        /// How long, ms.
        length_ms: u32,
    },
    /// Measure again: the last frame showed nothing.
    Measure,
    /// The calibration, and what is odd about it.
    Done {
        /// What pulses do.
        calibration: Calibration,
        /// What an observer should look at.
        warnings: Vec<Warning>,
    },
    /// There is no calibration.
    Failed(NoCalibration),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    West,
    East,
    ClearNorth,
    North,
    South,
    Over,
}

/// A calibration under way.
#[derive(Debug, Clone)]
pub struct CalibrationRun {
    settings: CalibrationSettings,
    phase: Phase,
    /// This phase, from where the last one ended.
    steps: Vec<CalibrationFrame>,
    ra: Way,
    dec: Way,
    /// What right ascension alone shows, once it is back.
    found: Option<StarMotion>,
    good_moves: usize,
    misses: usize,
}

/// Frames without a star in a row that are too many.
const MOST_MISSES: usize = 3;
/// Moves that show that the gear has taken hold, as a share of the RA move, and how many there must be.
const GOOD_MOVE: f64 = 0.25;
const GOOD_MOVES: usize = 3;
/// Least part of a star's way that must be by pulses and not by drift.
const LEAST_BY_PULSES: f64 = 0.25;
const ORTHOGONAL_DEG: f64 = 12.5;
const FEWEST_STEPS: usize = 4;
/// A shorter way is lost in the noise of places: a tenth of a pixel each.
const SHORTEST_WAY_PX: f64 = 3.0;
const SPEED_TOLERANCE: f64 = 0.2;
/// A way back shorter or longer than this share of the way out is odd.
const WAY_BACK: std::ops::Range<f64> = 0.7..1.3;

impl CalibrationRun {
    /// A calibration that begins with the next place.
    pub fn new(settings: CalibrationSettings) -> Self {
        let (ra, dec) = (Way::default(), Way::default());
        Self { settings, phase: Phase::West, steps: Vec::new(), ra, dec, found: None, good_moves: 0, misses: 0 }
    }

    /// What to do after a frame with this middle of its exposure (s, from any moment on) showed the star at `place_px`
    /// (x, y), or did not.
    pub fn next(&mut self, mid_s: f64, place_px: Option<[f64; 2]>) -> Next {
        if self.phase == Phase::Over {
            return Next::Failed(NoCalibration::Over);
        }
        let Some(place_px) = place_px.filter(|place| place.iter().all(|value| value.is_finite())) else {
            self.misses += 1;
            return if self.misses < MOST_MISSES { Next::Measure } else { self.fail(NoCalibration::StarLost) };
        };
        self.misses = 0;
        let before = self.steps.last().copied();
        let before_s = before.map_or(f64::NEG_INFINITY, |step| step.mid_s);
        if !(mid_s.is_finite() && mid_s > before_s) {
            return self.fail(NoCalibration::Clock { before_s, mid_s });
        }
        let pulse_s = before.map_or(0.0, |step| step.pulse_s + self.direction().sign() * self.pulse_s());
        self.steps.push(CalibrationFrame { mid_s, pulse_s, place_px });
        let moved_px = apart(place_px, self.steps[0].place_px);
        let is_long = self.made() >= self.settings.steps.unwrap_or(self.settings.most_steps);
        let is_enough = self.settings.steps.is_some() && is_long && moved_px >= SHORTEST_WAY_PX;
        let is_far = is_enough || moved_px >= self.settings.distance_px;
        match self.phase {
            Phase::West if is_far => self.turn(Phase::East),
            Phase::North if is_far => self.turn(Phase::South),
            Phase::West | Phase::North if is_long => self.did_not_move(self.direction(), self.made(), moved_px),
            Phase::East if self.made() >= self.ra.out.len() - 1 => self.right_ascension(),
            Phase::ClearNorth => self.clear(),
            Phase::South => self.back_south(),
            Phase::West | Phase::North | Phase::East => self.pulse(),
            Phase::Over => self.fail(NoCalibration::Over),
        }
    }

    /// Both ways of right ascension are made: what they show helps to see declination take hold.
    fn right_ascension(&mut self) -> Next {
        self.keep(Phase::ClearNorth);
        self.found = fit::motion(&self.ra, &self.dec);
        match self.found.map(|found| too_little_px(&self.ra, found.speeds_px_s[0])) {
            None => self.fail(NoCalibration::Parallel),
            Some(Some(moved_px)) => self.did_not_move(Direction::West, self.ra.out.len() - 1, moved_px),
            Some(None) => self.pulse(),
        }
    }

    /// Three good moves in a row show that the gear has taken hold.
    fn clear(&mut self) -> Next {
        if self.takes_hold() {
            self.turn(Phase::North)
        } else if self.made() >= self.settings.most_steps {
            self.fail(NoCalibration::Backlash { steps: self.made() })
        } else {
            self.pulse()
        }
    }

    /// The way back ends when it was as long as the way out and the gear has taken hold: a play that is longer than the
    /// way would pass for a drift.
    fn back_south(&mut self) -> Next {
        let takes_hold = self.takes_hold();
        let is_long = self.made() >= self.settings.most_steps;
        if is_long || (takes_hold && self.made() >= self.dec.out.len() - 1) {
            self.done(takes_hold)
        } else {
            self.pulse()
        }
    }

    /// Whether the last moves were good ones: across right ascension, without what the mount drifts meanwhile. Along
    /// right ascension its drift is not distinguished from a mount that sticks.
    fn takes_hold(&mut self) -> bool {
        let is_good = match (self.steps.as_slice(), self.found) {
            ([.., before, last], Some(found)) => {
                let [x, y] = found.speeds_px_s[0];
                let [dx, dy] = moved(before, last, found.drifts_px_s[0]);
                (x * dy - y * dx).abs() >= GOOD_MOVE * (x * x + y * y) * self.pulse_s()
            }
            _ => false,
        };
        self.good_moves = if is_good { self.good_moves + 1 } else { 0 };
        self.good_moves >= GOOD_MOVES
    }

    fn turn(&mut self, phase: Phase) -> Next {
        self.keep(phase);
        self.pulse()
    }

    /// Keeps the way that was made, and begins a phase where it ended.
    fn keep(&mut self, phase: Phase) {
        self.good_moves = 0;
        let steps = std::mem::take(&mut self.steps);
        let mut here = steps.last().copied();
        match self.phase {
            Phase::West => self.ra.out = steps,
            Phase::East => self.ra.back = steps,
            Phase::North => self.dec.out = steps,
            Phase::South => self.dec.back = steps,
            Phase::ClearNorth | Phase::Over => {}
        }
        if phase == Phase::North
            && let Some(here) = &mut here
        {
            here.pulse_s = 0.0;
        }
        self.steps.extend(here);
        self.phase = phase;
    }

    fn done(&mut self, takes_hold: bool) -> Next {
        self.keep(Phase::Over);
        // all that is known of the play is that it is more than the way
        let lost_s = (!takes_hold).then_some(self.dec.back_s());
        if !takes_hold {
            self.dec.back.truncate(1);
        }
        let Some(motion) = fit::motion(&self.ra, &self.dec) else {
            return self.fail(NoCalibration::Parallel);
        };
        let [east_px_s, north_px_s] = motion.speeds_px_s;
        if let Some(moved_px) = too_little_px(&self.dec, north_px_s) {
            return self.did_not_move(Direction::North, self.dec.out.len() - 1, moved_px);
        }
        let (dec_deg, pier) = (self.settings.dec_deg, self.settings.pier);
        let backlash_s = lost_s.or(Some(motion.play_s));
        let calibration = Calibration { east_px_s, north_px_s, dec_deg, pier, backlash_s };
        let Ok(rates) = calibration.at(dec_deg) else {
            return self.fail(NoCalibration::Parallel);
        };
        let mut warnings = self.warnings(&calibration, rates.speeds_px_s(), motion.drifts_px_s[1]);
        warnings.extend(lost_s.map(|play_s| Warning::OneWay { play_s }));
        Next::Done { calibration, warnings }
    }

    fn did_not_move(&mut self, direction: Direction, steps: usize, moved_px: f64) -> Next {
        self.fail(NoCalibration::DidNotMove { direction, steps, pulse_ms: self.settings.pulse_ms, moved_px })
    }

    fn warnings(&self, calibration: &Calibration, speeds: [f64; 2], drift_px_s: [f64; 2]) -> Vec<Warning> {
        let mut warnings = Vec::new();
        let angle = |v: [f64; 2]| v[1].atan2(v[0]).to_degrees();
        let between = (angle(calibration.north_px_s) - angle(calibration.east_px_s)).rem_euclid(180.0);
        let off_deg = (between - 90.0).abs();
        if off_deg > ORTHOGONAL_DEG {
            warnings.push(Warning::NotOrthogonal { off_deg });
        }
        for (axis, steps) in [("RA", self.ra.out.len() - 1), ("Dec", self.dec.out.len() - 1)] {
            if steps < FEWEST_STEPS {
                warnings.push(Warning::FewSteps { axis, steps });
            }
        }
        let expected = self.settings.expected_px_s.into_iter().flatten();
        for ((axis, px_s), expected_px_s) in ["RA", "Dec"].into_iter().zip(speeds).zip(expected) {
            if (px_s / expected_px_s - 1.0).abs() > SPEED_TOLERANCE {
                warnings.push(Warning::Speed { axis, px_s, expected_px_s });
            }
        }
        if self.settings.dec_deg.abs() > super::HIGHEST_DEC_DEG {
            warnings.push(Warning::NearPole { dec_deg: self.settings.dec_deg });
        }
        // with the drift that declination saw: right ascension's own cannot be distinguished from a mount that sticks
        let way_px = |steps: &[CalibrationFrame]| match steps {
            [first, .., last] => apart(moved(first, last, drift_px_s), [0.0, 0.0]),
            _ => 0.0,
        };
        let share = way_px(&self.ra.back) / way_px(&self.ra.out);
        if !WAY_BACK.contains(&share) {
            warnings.push(Warning::NotBack { share });
        }
        warnings
    }

    fn fail(&mut self, failure: NoCalibration) -> Next {
        self.phase = Phase::Over;
        Next::Failed(failure)
    }

    fn pulse(&self) -> Next {
        Next::Pulse { direction: self.direction(), length_ms: self.settings.pulse_ms }
    }

    fn direction(&self) -> Direction {
        match self.phase {
            Phase::West => Direction::West,
            Phase::East => Direction::East,
            Phase::ClearNorth | Phase::North => Direction::North,
            Phase::South | Phase::Over => Direction::South,
        }
    }

    /// Pulses made in this phase.
    fn made(&self) -> usize {
        self.steps.len() - 1
    }

    fn pulse_s(&self) -> f64 {
        f64::from(self.settings.pulse_ms) / 1000.0
    }
}

/// How far pulses moved the star on its way out, px, if that is too little: most of the way was by drift.
fn too_little_px(way: &Way, speed_px_s: [f64; 2]) -> Option<f64> {
    let (first, last) = (way.out.first()?, way.out.last()?);
    let by_pulses_px = (last.pulse_s - first.pulse_s).abs() * speed_px_s[0].hypot(speed_px_s[1]);
    (by_pulses_px < LEAST_BY_PULSES * apart(first.place_px, last.place_px)).then_some(by_pulses_px)
}

/// From one step to another without what the mount drifted, px.
fn moved(from: &CalibrationFrame, to: &CalibrationFrame, drift_px_s: [f64; 2]) -> [f64; 2] {
    [0, 1].map(|n| to.place_px[n] - from.place_px[n] - drift_px_s[n] * (to.mid_s - from.mid_s))
}

fn apart(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}
