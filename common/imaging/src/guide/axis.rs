//! One axis of the mount: what it would do alone, what pulses have done to it, and which pulse comes next.
//!
//! The bank of filters sees the axis as it would be without pulses: the measured error less the motion by all pulses
//! that fell before or into the exposure. So pulses of any kind at any time disturb neither drift nor worm.

use super::Exposure;
use super::bank::{Bank, Learned};
use super::decision::{AxisLog, Unstable, Why};
use super::pid::{Gains, Pid};
use super::reversal::Reversal;
use super::settings::{Control, GuideSettings};
use super::slack::Slack;
use super::watch::Watch;

/// A pulse shows whether the gear takes hold if it moves the star by this many standard deviations of what is expected.
const CLEAR_PULSE: f64 = 3.0;
/// While that is being found out, pulses are not shorter than this many standard deviations, nor need they be longer
/// than this, px; and the drift must be known from this many frames.
const SEARCH_SIGMA: f64 = 4.0;
const SEARCH_PX: f64 = 2.0;
const SEARCH_FRAMES: u32 = 2;
/// Pulses that look for the flank are longer than they need be by no more than this, px.
const SEARCH_MORE_PX: f64 = 1.0;
/// Dec turns round for no less than a multiple of this, px: the least dead band for which the rule was made.
const REVERSAL_BAND_PX: f64 = 0.15;
/// A drift known to this many standard errors is taken back without stars.
const KNOWN_DRIFT: f64 = 3.0;
/// After an oscillation pulses are for this share of what they should be, for so many frames.
const GENTLE: f64 = 0.6;
const GENTLE_FRAMES: u32 = 20;
/// No mount drifts or errs by its worm faster than this share of its guide speed (0.4 arcsec/s of half the sidereal rate):
/// what seems faster is not foreseen.
const MOST_DRIFT: f64 = 0.05;
/// Weight of the newest pulse in what is known of how late pulses come.
const NEWEST_LATENESS: f64 = 0.3;

#[derive(Debug, Clone, Copy, PartialEq)]
struct Given {
    /// When it began, s; None: at once, between the frames.
    begun_s: Option<f64>,
    pulse_s: f64,
    moved_px: f64,
    speed_px_s: f64,
}

impl Given {
    /// Share of the motion that an exposure saw, in the mean.
    fn share(&self, exposure: Exposure) -> f64 {
        let Some(begun_s) = self.begun_s else { return 1.0 };
        let length_s = exposure.length_s.max(1e-3);
        let end_s = exposure.mid_s + 0.5 * length_s;
        ((end_s - begun_s - 0.5 * self.pulse_s.abs()) / length_s).clamp(0.0, 1.0)
    }
}

#[derive(Debug, Clone)]
pub(super) struct GuideAxis {
    control: Control,
    bank: Bank,
    pid: Pid,
    reversal: Option<Reversal>,
    slack: Slack,
    /// Motion by all pulses that are wholly in the past, px.
    settled_px: f64,
    given: Vec<Given>,
    /// Share of a pulse that the exposure after its decision does not see, in the mean of late: frames are downloaded and
    /// measured while the next one is exposed already.
    late_share: f64,
    /// Where the star shall be, px.
    target_px: f64,
    watch: Watch,
    /// Where the last frame was measured, and how far pulses had moved the star in the last one that was, px.
    last_px: Option<f64>,
    last_motion_px: f64,
    /// Frames that pulses stay gentle for.
    gentle: u32,
}

impl GuideAxis {
    pub(super) fn new(
        control: Control,
        resist_reversal: bool,
        worm_period_s: Option<f64>,
        backlash_s: Option<f64>,
    ) -> Self {
        Self {
            control,
            bank: Bank::new(worm_period_s),
            pid: Pid::new(Gains::WHOLE),
            reversal: resist_reversal.then(Reversal::default),
            slack: Slack::new(backlash_s),
            settled_px: 0.0,
            given: Vec::new(),
            late_share: 0.0,
            target_px: 0.0,
            watch: Watch::default(),
            last_px: None,
            last_motion_px: 0.0,
            gentle: 0,
        }
    }

    /// An axis that knows nothing of its motion yet, with the same gear.
    pub(super) fn anew(&self, worm_period_s: Option<f64>) -> Self {
        Self {
            control: self.control,
            bank: Bank::new(worm_period_s),
            pid: Pid::new(Gains::WHOLE),
            reversal: self.reversal.clone(),
            slack: self.slack.clone(),
            settled_px: 0.0,
            given: Vec::new(),
            late_share: self.late_share,
            target_px: 0.0,
            watch: Watch::default(),
            last_px: None,
            last_motion_px: 0.0,
            gentle: 0,
        }
    }

    /// What a frame is expected to show: error (px) and standard deviation of a measurement of this variance.
    pub(super) fn expected_px(&self, exposure: Exposure, variance: f64) -> (f64, f64) {
        let ahead_s = self.bank.time_s().map_or(0.0, |last_s| exposure.mid_s - last_s);
        let (alone_px, spread_px) = self.bank.expected(ahead_s, variance);
        (alone_px + self.moved_px(exposure) - self.target_px, spread_px)
    }

    /// Learns from a measured shift along the axis, px, variance px^2.
    pub(super) fn learn(&mut self, exposure: Exposure, place_px: f64, variance: f64, gated: bool) -> Learned {
        let motion_px = self.moved_px(exposure) - self.last_motion_px;
        if let Some(last_px) = self.last_px.replace(place_px) {
            self.watch.moved(place_px - last_px, motion_px, variance.sqrt());
        }
        if self.bank.time_s().is_some() {
            self.blame_gear(exposure, place_px, variance, motion_px);
            self.note_lateness(exposure);
        }
        self.last_motion_px = self.moved_px(exposure);
        let found = self.watch.observe(place_px - self.target_px, variance.sqrt());
        if let Some(found) = found {
            self.doubt(found, place_px - self.moved_px(exposure));
        }
        let learned = self.bank.learn(exposure.mid_s, place_px - self.moved_px(exposure), variance, gated);
        if learned == Learned::Taken
            && let Some(reversal) = &mut self.reversal
        {
            reversal.note(place_px - self.target_px);
        }
        self.settle(exposure);
        learned
    }

    /// A frame showed nothing.
    pub(super) fn pass(&mut self, exposure: Exposure) {
        self.bank.pass(exposure.mid_s);
        self.last_px = None;
        self.settle(exposure);
    }

    /// Why the axis is not held, if it is not.
    pub(super) fn unstable(&self) -> Option<Unstable> {
        self.watch.unstable()
    }

    /// What was believed of place, drift and gear keeps the errors going: it is learned anew, with gentle pulses.
    fn doubt(&mut self, found: Unstable, alone_px: f64) {
        self.bank.begin_anew(alone_px);
        self.slack = self.slack.forgotten();
        if found == Unstable::Oscillates {
            self.gentle = GENTLE_FRAMES;
        }
    }

    /// The pulse (s, signed) that brings the star to its place in `ahead_s` from the last frame.
    pub(super) fn correct(
        &mut self,
        ahead_s: f64,
        error_px: f64,
        dead_band_px: f64,
        speed_px_s: f64,
        settings: &GuideSettings,
    ) -> (f64, Why) {
        let wanted_px = match self.control {
            Control::Predict => -self.led_px(ahead_s, speed_px_s),
            Control::Pid(_) => -self.pid.output_px(error_px),
        };
        self.pulse(wanted_px, dead_band_px, speed_px_s, settings)
    }

    /// The pulse that what was known before asks for, when the measurement is not to be believed.
    pub(super) fn foresee(
        &mut self,
        ahead_s: f64,
        dead_band_px: f64,
        speed_px_s: f64,
        settings: &GuideSettings,
    ) -> (f64, Why) {
        match self.control {
            Control::Predict => self.pulse(-self.led_px(ahead_s, speed_px_s), dead_band_px, speed_px_s, settings),
            Control::Pid(_) => (0.0, Why::Outlier),
        }
    }

    /// The pulse against a drift that is known well, when nothing was measured.
    pub(super) fn hold(
        &mut self,
        ahead_s: f64,
        dead_band_px: f64,
        speed_px_s: f64,
        settings: &GuideSettings,
    ) -> (f64, Why) {
        let (drift_px_s, error_px_s) = self.bank.drift_px_s();
        if drift_px_s.abs() <= KNOWN_DRIFT * error_px_s {
            return (0.0, Why::NotMeasured);
        }
        match self.pulse(-self.led_px(ahead_s, speed_px_s), dead_band_px, speed_px_s, settings) {
            (pulse_s, Why::Corrected | Why::Clipped) => (pulse_s, Why::DriftHeld),
            other => other,
        }
    }

    /// The last pulse began at this time, and so much of it was given, s. One that was reported already stays as it is:
    /// it is of an earlier decision, and this one asked for none.
    pub(super) fn report(&mut self, begun_s: f64, pulse_s: f64) {
        if let Some(last) = self.given.last_mut().filter(|last| last.begun_s.is_none()) {
            let share = if last.pulse_s == 0.0 { 0.0 } else { (pulse_s / last.pulse_s).clamp(0.0, 1.0) };
            *last = Given {
                begun_s: Some(begun_s),
                pulse_s: last.pulse_s * share,
                moved_px: last.moved_px * share,
                ..*last
            };
        }
    }

    /// The star shall be there from now on, px.
    pub(super) fn aim(&mut self, target_px: f64) {
        self.target_px = target_px;
        self.watch.forget();
        self.pid = Pid::new(Gains::WHOLE);
    }

    /// The place changed by an unknown way; drift, worm and gear stay known.
    pub(super) fn forget_place(&mut self, spread_px: f64) {
        self.bank.forget_place(spread_px);
        self.slack.moved();
        self.last_px = None;
        self.aim(0.0);
    }

    /// The gains for stabilising, or those of every day.
    pub(super) fn set_stabilising(&mut self, stabilising: bool) {
        if let Control::Pid(gains) = self.control {
            self.pid = Pid::new(if stabilising { Gains::WHOLE } else { gains });
        }
    }

    pub(super) fn log(&self, error_px: Option<f64>, expected: (f64, f64)) -> AxisLog {
        AxisLog {
            error_px,
            expected_px: expected.0,
            spread_px: expected.1,
            drift_px_s: self.bank.drift_px_s().0,
            worm_period_s: self.bank.worm_period_s(),
        }
    }

    /// Error to be expected in `ahead_s` from the last frame if no pulse is given, px; and what the next exposure drifts
    /// before its pulse comes: a steady drift is then seen around the target, not always on one side of it. Being made of
    /// the drift alone, this does not swing, however late pulses come.
    fn led_px(&self, ahead_s: f64, speed_px_s: f64) -> f64 {
        let all_px = self.settled_px + self.given.iter().map(|given| given.moved_px).sum::<f64>();
        let (now_px, most_px) = (self.bank.expected(0.0, 0.0).0, MOST_DRIFT * speed_px_s * ahead_s);
        let drift_px = (self.bank.expected(ahead_s, 0.0).0 - now_px).clamp(-most_px, most_px);
        now_px + all_px - self.target_px + (1.0 + self.late_share) * drift_px
    }

    /// The first exposure after a pulse shows how late it came.
    fn note_lateness(&mut self, exposure: Exposure) {
        let last_s = self.bank.time_s().unwrap_or(f64::INFINITY);
        if let Some(last) = self.given.last().filter(|last| last.begun_s.is_some_and(|begun_s| begun_s > last_s)) {
            self.late_share += NEWEST_LATENESS * (1.0 - last.share(exposure) - self.late_share);
        }
    }

    fn pulse(&mut self, wanted_px: f64, dead_band_px: f64, speed_px_s: f64, settings: &GuideSettings) -> (f64, Why) {
        let wanted_px = if self.gentle > 0 { GENTLE * wanted_px } else { wanted_px };
        self.gentle = self.gentle.saturating_sub(1);
        let mut least_px = dead_band_px;
        if self.slack.is_searching() || self.slack.turns(wanted_px.signum()) {
            if self.bank.frames() < SEARCH_FRAMES {
                return (0.0, Why::WithinDeadBand);
            }
            least_px = least_px.max((SEARCH_SIGMA * self.bank.expected(0.0, 0.0).1).min(SEARCH_PX));
        }
        if !(wanted_px.is_finite() && wanted_px.abs() > least_px) {
            return (0.0, Why::WithinDeadBand);
        }
        let band_px = dead_band_px.max(REVERSAL_BAND_PX);
        if self.reversal.as_mut().is_some_and(|reversal| !reversal.allows(wanted_px, band_px)) {
            return (0.0, Why::ReversalResisted);
        }
        let side = wanted_px.signum();
        let longest_s = f64::from(settings.longest_pulse_ms) / 1000.0;
        // what was lost is likely to be lost again, until the gear takes hold
        let search_s = if self.slack.turns(side) { 0.0 } else { self.slack.lost_s().min(SEARCH_MORE_PX / speed_px_s) };
        let wanted_s = wanted_px.abs() / speed_px_s + self.slack.before(side) + search_s;
        // mounts count in ms
        let pulse_s = side * (wanted_s.min(longest_s) * 1000.0).round() / 1000.0;
        if pulse_s == 0.0 {
            return (0.0, Why::WithinDeadBand);
        }
        let moved_px = self.slack.pulse(pulse_s) * speed_px_s;
        self.watch.asked(moved_px);
        self.given.push(Given { begun_s: None, pulse_s, moved_px, speed_px_s });
        (pulse_s, if wanted_s > longest_s { Why::Clipped } else { Why::Corrected })
    }

    /// Motion by pulses that this exposure saw, px.
    fn moved_px(&self, exposure: Exposure) -> f64 {
        self.settled_px + self.given.iter().map(|given| given.moved_px * given.share(exposure)).sum::<f64>()
    }

    /// Pulses that were over before this exposure ended need not be remembered singly.
    fn settle(&mut self, exposure: Exposure) {
        let mut settled_px = self.settled_px;
        self.given.retain(|given| {
            let is_over = given.share(exposure) >= 1.0;
            if is_over {
                settled_px += given.moved_px;
            }
            !is_over
        });
        self.settled_px = settled_px;
    }

    /// What pulses did not move since the last frame, the gear lost, as far as it may have.
    fn blame_gear(&mut self, exposure: Exposure, place_px: f64, variance: f64, motion_px: f64) {
        let Some(speed_px_s) = self.given.last().map(|given| given.speed_px_s) else { return };
        let (expected_px, spread_px) = self.expected_px(exposure, variance);
        if motion_px.abs() > CLEAR_PULSE * spread_px {
            let share = 1.0 + (place_px - self.target_px - expected_px) / motion_px;
            let lost_s = self.slack.blame(motion_px / speed_px_s, share);
            self.settled_px -= motion_px.signum() * lost_s * speed_px_s;
        }
    }
}
