//! The guider: a shift per frame in, pulses with their reason out; and what to do when the stars are gone.

use super::axis::GuideAxis;
use super::bank::Learned;
use super::calibration::{Calibration, CalibrationError, Rates};
use super::decision::{Ask, AxisLog, Decision, Log, Pulses, State, Unstable, Why};
use super::lost::{LostField, LostFieldOutcome};
use super::rotation::Rotation;
use super::settings::GuideSettings;
use super::{Exposure, usable};
use crate::shift::{NoShift, Shift};

/// Stabilising ends after this many frames, or after so many in a row with less than so many px.
const STABILISE_FRAMES: u32 = 3;
const CALM_FRAMES: u32 = 2;
const CALM_PX: f64 = 1.0;
/// So many frames after a slew or a dither no measurement counts as an outlier: gears turn round then.
const UNGATED_FRAMES: u32 = 10;
/// Frames in a row without a star, or beyond the cap, that mean a lost field.
const LOST_FRAMES: u32 = 2;
/// Frames in a row from the past that mean that the clock was set back.
const SET_BACK_FRAMES: u32 = 3;
/// Longest interval that is planned ahead, s.
const LONGEST_AHEAD_S: f64 = 600.0;
/// After a slew a star may stand anywhere within this, px.
const ANYWHERE_PX: f64 = 1e4;
/// No detector reaches further, px.
const FURTHEST_AIM_PX: f64 = 1e6;

/// Holds a field in its place. Fed with each frame's time and shift, it answers with pulses.
///
/// Times are s on any clock that does not jump (sky time); shifts are check minus reference, px.
#[derive(Debug, Clone)]
pub struct Guider {
    settings: GuideSettings,
    rates: Rates,
    /// Right ascension (East), declination (North).
    axes: [GuideAxis; 2],
    state: State,
    last_s: Option<f64>,
    interval_s: Option<f64>,
    last_seen_s: Option<f64>,
    /// Counts of frames: measured since stabilising began; in a row: calm, without a star, beyond the cap, from the past.
    stabilised: u32,
    calm: u32,
    missed: u32,
    beyond: u32,
    set_back: u32,
    search: LostField,
    rotation: Rotation,
    /// Where the field shall be on the detector, px from the reference.
    target_px: [f64; 2],
    /// Pulses of an axis were seen to move the stars against the calibration, and are given the other way.
    turned_round: Option<Unstable>,
    /// The last shift that was seen.
    last_shift: Option<Shift>,
}

impl Guider {
    /// A guider for a field at this declination (degrees).
    ///
    /// # Errors
    /// [`CalibrationError`] when the calibration does not hold there.
    pub fn new(settings: GuideSettings, calibration: &Calibration, dec_deg: f64) -> Result<Self, CalibrationError> {
        let rates = calibration.at(dec_deg)?;
        let [east, north] = settings.control;
        // without a gear that resists there is no play to look for
        let play_s = if settings.resist_dec_reversal { calibration.backlash_s } else { Some(0.0) };
        Ok(Self {
            settings,
            rates,
            axes: [
                GuideAxis::new(east, false, settings.worm_period_s, Some(0.0)),
                GuideAxis::new(north, settings.resist_dec_reversal, None, play_s),
            ],
            state: State::Acquire,
            last_s: None,
            interval_s: None,
            last_seen_s: None,
            stabilised: 0,
            calm: 0,
            missed: 0,
            beyond: 0,
            set_back: 0,
            search: LostField::default(),
            rotation: Rotation::default(),
            target_px: [0.0; 2],
            turned_round: None,
            last_shift: None,
        })
    }

    /// What to do after a frame that showed this shift, or none.
    pub fn step(&mut self, exposure: Exposure, seen: Result<&Shift, &NoShift>) -> Decision {
        if self.state == State::Stopped {
            return self.nothing(Why::Stopped, Some(Ask::Alarm));
        }
        if !(exposure.mid_s.is_finite() && exposure.length_s.is_finite() && exposure.length_s >= 0.0) {
            return self.nothing(Why::Unusable, None);
        }
        if self.last_s.is_some_and(|last_s| exposure.mid_s <= last_s) {
            self.set_back += 1;
            if self.set_back >= SET_BACK_FRAMES {
                self.restart();
            }
            return self.nothing(Why::Unusable, None);
        }
        self.set_back = 0;
        self.interval_s = self.last_s.map(|last_s| exposure.mid_s - last_s).or(self.interval_s);
        self.last_s = Some(exposure.mid_s);
        match seen.map_err(Clone::clone).and_then(|shift| usable(*shift)) {
            // two exposures never show the same noise: the camera repeats a frame, which shows nothing of now
            Ok(shift) if self.last_shift == Some(shift) => self.repeated(exposure),
            Ok(shift) => {
                self.last_shift = Some(shift);
                self.measured(exposure, &shift)
            }
            Err(why) => self.not_measured(exposure, &why),
        }
    }

    /// What became of the last decision's pulses: for each axis (East, North) that was to be pulsed, when its pulse began,
    /// s, and how much of it was given, ms. Without this they count as given in full between the frames; a pulse that was
    /// reported already stays as it is.
    pub fn report(&mut self, given: [Option<(f64, i32)>; 2]) {
        for (axis, (begun_s, ms)) in self.axes.iter_mut().zip(given).filter_map(|(axis, given)| Some((axis, given?))) {
            if begun_s.is_finite() {
                axis.report(begun_s, f64::from(ms) / 1000.0);
            }
        }
    }

    /// Holds the field at this place on the detector, px from the reference: a dither by guiding. A place that no
    /// detector has changes nothing.
    pub fn aim(&mut self, dx_px: f64, dy_px: f64) {
        if dx_px.abs() <= FURTHEST_AIM_PX && dy_px.abs() <= FURTHEST_AIM_PX {
            self.target_px = [dx_px, dy_px];
            let along = self.rates.along_axes(self.target_px);
            self.axes.iter_mut().zip(along).for_each(|(axis, target_px)| axis.aim(target_px));
            if self.state == State::Guide {
                self.stabilise();
            }
        }
    }

    /// The mount was slewed, or the reference is a new one: what was learned of drift and worm stays.
    pub fn moved(&mut self) {
        self.target_px = [0.0; 2];
        self.axes.iter_mut().for_each(|axis| axis.forget_place(ANYWHERE_PX));
        self.state = State::Acquire;
        (self.missed, self.beyond, self.search) = (0, 0, LostField::default());
        self.rotation = Rotation::default();
    }

    /// The tube is on the other side of the pier, or the field at another declination: begins anew with what holds
    /// there.
    ///
    /// # Errors
    /// [`CalibrationError`] when the calibration does not hold there; the guider is then as before.
    pub fn recalibrated(&mut self, calibration: &Calibration, dec_deg: f64) -> Result<(), CalibrationError> {
        *self = Self { last_shift: self.last_shift, ..Self::new(self.settings, calibration, dec_deg)? };
        Ok(())
    }

    /// Where it stands.
    pub fn state(&self) -> State {
        self.state
    }

    /// Where the field is expected in the next frame, px from the reference: where to look for the stars.
    pub fn expected_px(&self, exposure: Exposure) -> [f64; 2] {
        let along = [0, 1].map(|n| self.axes[n].expected_px(exposure, 0.0).0);
        let [dx, dy] = self.rates.on_detector(along);
        [self.target_px[0] + dx, self.target_px[1] + dy]
    }

    fn measured(&mut self, exposure: Exposure, shift: &Shift) -> Decision {
        let off_px = [shift.dx_px - self.target_px[0], shift.dy_px - self.target_px[1]];
        let size_px = off_px[0].hypot(off_px[1]);
        (self.missed, self.last_seen_s) = (0, Some(exposure.mid_s));
        match self.state {
            State::Acquire if size_px <= self.settings.stabilise_cap_px => self.stabilise(),
            State::Acquire | State::Lost => match self.search.seen(off_px, exposure.mid_s, &self.settings) {
                LostFieldOutcome::Near => self.stabilise(),
                LostFieldOutcome::Not(ask) => return self.lost(exposure, ask),
                LostFieldOutcome::GivenUp => return self.stop(),
            },
            State::Stabilise if size_px > self.settings.stabilise_cap_px => return self.is_beyond(exposure),
            State::Guide if size_px > self.settings.cap_px => return self.is_beyond(exposure),
            State::Stabilise | State::Guide | State::Stopped => {}
        }
        self.beyond = 0;
        if shift.covariance[2][2] > 0.0 {
            self.rotation.note(exposure.mid_s, shift.rotation_deg);
        }
        let decision = self.correct(exposure, shift, off_px);
        self.count_calm(size_px);
        Decision { state: self.state, ..decision }
    }

    fn correct(&mut self, exposure: Exposure, shift: &Shift, off_px: [f64; 2]) -> Decision {
        let gated = self.state == State::Guide && self.stabilised >= UNGATED_FRAMES;
        let ahead_s = self.ahead_s(exposure);
        let place = self.rates.along_axes([shift.dx_px, shift.dy_px]);
        let error = self.rates.along_axes(off_px);
        let variances = self.rates.variances(&shift.covariance);
        let speeds = self.rates.speeds_px_s();
        let (mut pulses, mut why, mut logs) = ([0.0; 2], [Why::Corrected; 2], [AxisLog::default(); 2]);
        let mut wrong_way = [false; 2];
        for (n, axis) in self.axes.iter_mut().enumerate() {
            let expected = axis.expected_px(exposure, variances[n]);
            let learned = axis.learn(exposure, place[n], variances[n], gated);
            let dead_band_px = self.settings.dead_band_px(variances[n].sqrt());
            (pulses[n], why[n]) = match learned {
                Learned::Taken => axis.correct(ahead_s, error[n], dead_band_px, speeds[n], &self.settings),
                Learned::Outlier => {
                    let (pulse_s, _) = axis.foresee(ahead_s, dead_band_px, speeds[n], &self.settings);
                    (pulse_s, Why::Outlier)
                }
                Learned::Unusable => (0.0, Why::Unusable),
            };
            logs[n] = axis.log(Some(error[n]), expected);
            wrong_way[n] = axis.unstable() == Some(Unstable::WrongWay);
        }
        for n in (0..2).filter(|n| wrong_way[*n]) {
            pulses[n] = 0.0;
            self.turn_round(n);
        }
        let log = Log { transparency: shift.transparency, stars: shift.stars, ..self.log(logs) };
        Decision { log, ..self.pulsed(pulses, why) }
    }

    fn repeated(&mut self, exposure: Exposure) -> Decision {
        self.axes.iter_mut().for_each(|axis| axis.pass(exposure));
        self.nothing(Why::Unusable, None)
    }

    fn not_measured(&mut self, exposure: Exposure, why: &NoShift) -> Decision {
        self.axes.iter_mut().for_each(|axis| axis.pass(exposure));
        self.missed += 1;
        let since_s = exposure.mid_s - *self.last_seen_s.get_or_insert(exposure.mid_s);
        let mut ask = None;
        if self.missed >= LOST_FRAMES {
            match self.search.missed(why, since_s, &self.settings) {
                LostFieldOutcome::Not(what) => ask = Some(what),
                LostFieldOutcome::Near | LostFieldOutcome::GivenUp => return self.stop(),
            }
            if self.state != State::Acquire {
                self.state = State::Lost;
            }
        }
        // a drift goes on behind clouds; a field that went beyond the cap did not go by drift
        if self.state == State::Acquire || self.beyond > 0 || since_s > self.settings.hold_drift_s {
            return self.nothing(Why::NotMeasured, ask);
        }
        let (ahead_s, dead_band_px) = (self.ahead_s(exposure), self.settings.dead_band_px(f64::INFINITY));
        let (mut pulses, mut why) = ([0.0; 2], [Why::NotMeasured; 2]);
        for (n, speed_px_s) in self.rates.speeds_px_s().into_iter().enumerate() {
            (pulses[n], why[n]) = self.axes[n].hold(ahead_s, dead_band_px, speed_px_s, &self.settings);
        }
        Decision { ask, ..self.pulsed(pulses, why) }
    }

    /// A shift beyond the cap: once it may be a fluke, twice it is none.
    fn is_beyond(&mut self, exposure: Exposure) -> Decision {
        self.beyond += 1;
        if self.beyond >= LOST_FRAMES {
            self.search = LostField::default();
            return self.lost(exposure, Ask::Register);
        }
        self.axes.iter_mut().for_each(|axis| axis.pass(exposure));
        self.nothing(Why::BeyondCap, None)
    }

    fn lost(&mut self, exposure: Exposure, ask: Ask) -> Decision {
        self.axes.iter_mut().for_each(|axis| axis.pass(exposure));
        self.state = State::Lost;
        self.nothing(Why::Lost, Some(ask))
    }

    fn stop(&mut self) -> Decision {
        self.state = State::Stopped;
        self.nothing(Why::Stopped, Some(Ask::Alarm))
    }

    fn stabilise(&mut self) {
        self.state = State::Stabilise;
        (self.stabilised, self.calm, self.search) = (0, 0, LostField::default());
        self.axes.iter_mut().for_each(|axis| axis.set_stabilising(true));
    }

    fn count_calm(&mut self, size_px: f64) {
        self.stabilised += 1;
        if self.state == State::Stabilise {
            self.calm = if size_px < CALM_PX { self.calm + 1 } else { 0 };
            let is_long = self.stabilised >= STABILISE_FRAMES && size_px <= self.settings.cap_px;
            if self.calm >= CALM_FRAMES || is_long {
                self.state = State::Guide;
                self.axes.iter_mut().for_each(|axis| axis.set_stabilising(false));
            }
        }
    }

    /// Pulses of an axis move the stars against the calibration: from now on it is taken the other way round.
    fn turn_round(&mut self, n: usize) {
        self.turned_round = Some(Unstable::WrongWay);
        self.rates.turn_round(n);
        let period_s = if n == 0 { self.settings.worm_period_s } else { None };
        self.axes[n] = self.axes[n].anew(period_s);
        self.axes[n].aim(self.rates.along_axes(self.target_px)[n]);
    }

    /// The clock was set back: nothing that was learned has a time any more.
    fn restart(&mut self) {
        let [east, north] = &self.axes;
        self.axes = [east.anew(self.settings.worm_period_s), north.anew(None)];
        (self.last_s, self.interval_s, self.last_seen_s, self.set_back) = (None, None, None, 0);
        self.moved();
    }

    /// From this frame's middle to that of the next one, s, which is as far away as the last one was.
    fn ahead_s(&self, exposure: Exposure) -> f64 {
        self.interval_s.unwrap_or(exposure.length_s).clamp(0.0, LONGEST_AHEAD_S)
    }

    fn nothing(&self, why: Why, ask: Option<Ask>) -> Decision {
        Decision { ask, ..self.pulsed([0.0; 2], [why; 2]) }
    }

    fn pulsed(&self, pulses_s: [f64; 2], why: [Why; 2]) -> Decision {
        let [east_ms, north_ms] = pulses_s.map(|seconds| (seconds * 1000.0).round() as i32);
        let logs = [0, 1].map(|n: usize| self.axes[n].log(None, (0.0, 0.0)));
        Decision {
            pulses: Pulses { east_ms, north_ms },
            east: why[0],
            north: why[1],
            state: self.state,
            ask: None,
            log: self.log(logs),
        }
    }

    fn log(&self, [east, north]: [AxisLog; 2]) -> Log {
        let (rotation_deg_h, rotates) = (self.rotation.rate_deg_h(), self.rotation.is_measured());
        let unstable = self.turned_round.or_else(|| self.axes.iter().find_map(GuideAxis::unstable));
        Log { east, north, transparency: None, stars: 0, rotation_deg_h, rotates, unstable }
    }
}
