//! What solved frames teach of the optics: scale, rotation, parity and distortion, once and for all frames after.
//!
//! Pure: solved frames in, what is known of the optics out. A solution that disagrees (the camera was turned, a reducer
//! put in) changes nothing by itself; a second one that agrees with it does.

use contract::Part;
use contract::device::camera::Frame;
use contract::device::telescope::PierSide;
use contract::observatory::{AlertKind, Distortion, Optics, OpticsState, ZeroPoint};
use imaging::Solution;
use imaging::solve::LearnedOptics;
use imaging::wcs::Sip;
use units::{Angle, Utc};

use super::zero_point;
use crate::persisted::replaced;
use crate::replicated::Replicate;

/// Two solutions agree when their scales differ by no more than this share ...
const SAME_SCALE: f64 = 0.005;
/// ... and their rotations by no more than this, degrees: flexure of a camera's mount, and north turning near the pole.
const SAME_ROTATION_DEG: f64 = 1.0;
/// The known optics are written again when they changed by so much of that, or are older than [`OLD_S`].
const MOVED: f64 = 0.02;
const OLD_S: f64 = 1800.0;
/// Optics that are remembered, at most: a wheel of ten filters on two cameras, both sides of the pier and some
/// binnings.
const MOST: usize = 200;
/// A zero point counts for the best one when its standard error is below this, mag.
const SURE_MAG: f64 = 0.05;
/// Mirrors grow dusty: the best zero point is forgotten at this rate, mag per day. This is our choice; washed mirrors
/// lose a few tenths a year.
const DUST_MAG_PER_DAY: f64 = 0.001;

/// A frame that was solved, as far as optics are concerned.
#[derive(Debug, Clone, PartialEq)]
pub struct Lesson {
    /// The optics that it shows.
    pub optics: Optics,
    /// Its zero point, where that is fit to be compared with others.
    pub zero_point: Option<(zero_point::Measured, ZeroPoint)>,
}

impl Lesson {
    /// What a solution teaches.
    pub fn of(frame: &Frame, pier_side: Option<PierSide>, solution: &Solution) -> Self {
        let optics = Optics {
            camera: frame.camera.clone(),
            filter: frame.purpose.filter.clone(),
            pier_side,
            bin: frame.bin,
            scale_arcsec_px: solution.scale_arcsec_px,
            rotation_deg: solution.rotation_deg,
            mirrored: solution.mirrored,
            sip: solution.wcs.sip.map(|sip| Distortion { a: sip.a, b: sip.b }),
            size_px: [frame.width_px, frame.height_px],
            origin_px: frame.origin_px,
            faintest_mag: solution.faintest_mag(),
            exposure_s: frame.exposure_s,
            frames: 1,
            at_utc: frame.started_utc,
        };
        Self { optics, zero_point: None }
    }
}

/// What is known of the optics with which a frame was taken.
pub fn known<'a>(state: &'a OpticsState, frame: &Frame, pier_side: Option<PierSide>) -> Option<&'a Optics> {
    state.optics.iter().find(|optics| {
        (&optics.camera, &optics.filter, optics.pier_side, optics.bin)
            == (&frame.camera, &frame.purpose.filter, pier_side, frame.bin)
    })
}

/// What the solver gets of known optics. Distortion is valid for the middle of one part of the sensor: a frame of
/// another part goes without.
pub fn learned(optics: &Optics, frame: &Frame) -> LearnedOptics {
    let same_part = (optics.size_px, optics.origin_px) == ([frame.width_px, frame.height_px], frame.origin_px);
    LearnedOptics {
        scale_arcsec_px: optics.scale_arcsec_px,
        rotation_deg: optics.rotation_deg,
        mirrored: optics.mirrored,
        sip: optics.sip.filter(|_| same_part).map(|Distortion { a, b }| Sip { a, b }),
    }
}

/// Magnitude of the faintest stars that such a frame shows under a clear sky: 1.25 mag more for ten times the exposure
/// on a frame that the sky limits.
pub fn faintest_mag(optics: &Optics, frame: &Frame) -> Option<f64> {
    let ratio = frame.exposure_s / optics.exposure_s;
    // Short frames are limited by readout instead, and lose more: far from this exposure time there is no value.
    let near = (0.1..=10.0).contains(&ratio);
    optics.faintest_mag.filter(|_| near).map(|mag| mag + 1.25 * ratio.log10())
}

/// The newest solutions that contradict what is known; one each.
#[derive(Debug, Clone, Default)]
pub struct Rivals {
    optics: Vec<Optics>,
    zero_points: Vec<ZeroPoint>,
}

impl Rivals {
    /// Takes a lesson in; whether what is known has changed so much that it is worth writing down.
    pub fn observe(&mut self, state: &mut OpticsState, lesson: Lesson) -> bool {
        let taught = self.observe_optics(state, lesson.optics);
        let brighter = lesson.zero_point.is_some_and(|(measured, zero)| self.observe_zero_point(state, measured, zero));
        taught || brighter
    }

    fn observe_optics(&mut self, state: &mut OpticsState, new: Optics) -> bool {
        let rival = self.optics.iter().position(|rival| is_for(rival, &new)).map(|at| self.optics.swap_remove(at));
        let Some(at) = state.optics.iter().position(|known| is_for(known, &new)) else {
            if state.optics.len() >= MOST {
                let oldest = (0..MOST).min_by_key(|n| state.optics[*n].at_utc);
                oldest.map(|oldest| state.optics.swap_remove(oldest));
            }
            state.optics.push(new);
            return true;
        };
        let known = &mut state.optics[at];
        if new.at_utc < known.at_utc {
            return false;
        }
        if agree(known, &new, 1.0) {
            let same_part = (known.size_px, known.origin_px) == (new.size_px, new.origin_px);
            let sip = new.sip.or(known.sip.filter(|_| same_part));
            let new = Optics { frames: known.frames.saturating_add(1), sip, ..new };
            let is_news = !agree(known, &new, MOVED)
                || (known.sip.is_none() && new.sip.is_some())
                || known.frames == 1
                || new.at_utc.seconds_since(known.at_utc) > OLD_S;
            if is_news {
                *known = new;
            }
            return is_news;
        }
        if rival.is_some_and(|rival| agree(&rival, &new, 1.0)) {
            *known = Optics { frames: 2, ..new };
            return true;
        }
        self.optics.push(new);
        false
    }

    /// The best zero point is the brightest that two frames of a camera, filter and gain showed one after the other.
    fn observe_zero_point(&mut self, state: &mut OpticsState, measured: zero_point::Measured, new: ZeroPoint) -> bool {
        if measured.error_mag.is_nan() || measured.error_mag > SURE_MAG {
            return false;
        }
        let is_for = |a: &ZeroPoint| (&a.camera, &a.filter, a.gain) == (&new.camera, &new.filter, new.gain);
        let rival = self.zero_points.iter().position(is_for).map(|at| self.zero_points.swap_remove(at));
        let Some(at) = state.zero_points.iter().position(is_for) else {
            state.zero_points.push(new);
            return true;
        };
        let known = &mut state.zero_points[at];
        if new.best_mag <= best_mag(known, new.at_utc) {
            return false;
        }
        let Some(rival) = rival else {
            self.zero_points.push(new);
            return false;
        };
        // The fainter of the two brighter values, which both frames showed.
        if rival.best_mag < new.best_mag {
            *known = rival;
            self.zero_points.push(new);
        } else {
            *known = new;
        }
        true
    }
}

/// The best zero point known for a frame of this camera, filter and gain at an instant.
pub fn best_zero_point(state: &OpticsState, frame: &Frame) -> Option<f64> {
    let gain = gain(frame);
    let same =
        |known: &&ZeroPoint| (&known.camera, &known.filter, known.gain) == (&frame.camera, &frame.purpose.filter, gain);
    state.zero_points.iter().find(same).map(|known| best_mag(known, frame.started_utc))
}

/// Gain that a camera was set to, as ASCOM reports it: a number of the camera's own scale.
pub fn gain(frame: &Frame) -> Option<f64> {
    frame.readings.get("Gain")?.value()?.number().filter(|gain| gain.is_finite())
}

fn best_mag(known: &ZeroPoint, now: Utc) -> f64 {
    known.best_mag - DUST_MAG_PER_DAY * now.seconds_since(known.at_utc).max(0.0) / 86_400.0
}

fn is_for(a: &Optics, b: &Optics) -> bool {
    (&a.camera, &a.filter, a.pier_side, a.bin) == (&b.camera, &b.filter, b.pier_side, b.bin)
}

/// Do two agree within a share of what still counts as the same?
fn agree(a: &Optics, b: &Optics, share: f64) -> bool {
    let turned = Angle::from_degrees(a.rotation_deg - b.rotation_deg).wrapped_signed().degrees().abs();
    let scaled = (a.scale_arcsec_px / b.scale_arcsec_px - 1.0).abs();
    a.mirrored == b.mirrored && turned <= share * SAME_ROTATION_DEG && scaled <= share * SAME_SCALE
}

impl Replicate for OpticsState {
    type Payload = Self;
    const PART: Part = Part::Optics;
    const FILE: &'static str = "optics";
    const WHAT: &'static str = "what is known of the optics";
    const NOT_SAVED: AlertKind = AlertKind::OpticsNotSaved;

    fn put_in(&self, payload: &mut Self) -> bool {
        replaced(payload, self)
    }

    fn adopt(&mut self, payload: Self) -> bool {
        payload != Self::default() && replaced(self, &payload)
    }
}

#[cfg(test)]
mod tests;
