//! From the stars of a frame to its place on the sky, and to what follows from that.
//!
//! The search first tries what is known: learned optics, and the place of the target or the mount. If that does not
//! fit, it widens within a budget, so that a hopeless frame does not delay the next.

use std::time::Duration;

use bus::{Clock, MachineTime};
use catalogue::{At, Catalogue};
use contract::device::camera::Frame;
use contract::observatory::{FrameFacts, FrameWcs, Optics, Unsolved, UnsolvedClass, ZeroPoint};
use imaging::solve::{Detected, FIRST_LIGHT, Hint, KNOWN_OPTICS, Stars, solve};
use imaging::{Measured, NoSolution, Solution, Wcs};
use sky::{Icrs, Observer};
use units::{Angle, Utc};

use super::aim::{FrameAim, middle_of};
use super::measure::if_finite;
use super::optics::{self, Lesson};
use super::zero_point;

/// Hypotheses that one try may cost: some 0.3 s of one core.
const MOST_HYPOTHESES: u64 = 15_000_000;
/// The cost of a search that also tries scales other than the given one, in units of it: there are 14 of them.
const WRONG_SCALES_COST: u64 = 4;
/// One in so many unsolved frames in a row tries them.
const WRONG_SCALES_EVERY: u32 = 3;
/// How far from where the telescope should point a frame is looked for.
const FURTHEST: Angle = Angle::from_degrees(2.0);
/// A search beyond the hinted field goes on for so long, machine time.
const TIMEOUT: Duration = Duration::from_millis(600);
/// Julian date of J2000.0.
const J2000_JD: f64 = 2_451_545.0;

/// How a frame may be solved, in addition to its stars.
#[derive(Debug, Clone)]
pub struct Known<'a> {
    /// Where it was pointed, and with what.
    pub aim: &'a FrameAim,
    /// Learned optics.
    pub optics: Option<&'a Optics>,
    /// How far away it is looked for ...
    pub furthest: Angle,
    /// ... and for how long, machine time.
    pub timeout: Duration,
    /// Hypotheses that one try may cost.
    pub most_hypotheses: u64,
    /// Scales other than the given one are tried too.
    pub wrong_scales: bool,
}

impl<'a> Known<'a> {
    /// With what each frame is solved.
    pub fn new(aim: &'a FrameAim, optics: Option<&'a Optics>) -> Self {
        let most_hypotheses = MOST_HYPOTHESES;
        Self { aim, optics, furthest: FURTHEST, timeout: TIMEOUT, most_hypotheses, wrong_scales: false }
    }

    /// As known of a camera of which so many frames in a row fitted nowhere: if no frame ever did, its pixels may have
    /// another size than configured (a reducer, another binning).
    pub fn after(self, unmatched: u32, was_ever_solved: bool) -> Self {
        let wrong_scales = !was_ever_solved && unmatched % WRONG_SCALES_EVERY == WRONG_SCALES_EVERY - 1;
        Self { wrong_scales, ..self }
    }
}

/// The catalogue for a search with an end: beyond the hinted field there are no stars any more once the time is up.
struct Hurried<'a> {
    stars: At<'a>,
    /// Around the hint, as far as the field itself extends, the search always gets the stars.
    near: (Angle, Angle),
    search_radius: Angle,
    clock: &'a Clock,
    began: MachineTime,
    timeout: Duration,
}

impl Stars for Hurried<'_> {
    fn cone(&self, ra: Angle, dec: Angle, radius: Angle, faintest_mag: f64) -> Vec<imaging::catalogue::CatalogueStar> {
        let far = imaging::tangent::separation(self.near, (ra, dec)).degrees() > self.search_radius.degrees();
        if far && self.clock.machine().since(self.began) > self.timeout {
            return Vec::new();
        }
        self.stars.cone(ra, dec, radius, faintest_mag)
    }
}

/// Solves a frame; takes up to a second: not for async threads.
///
/// # Errors
/// Why it was not even tried: nothing is known of place or scale, or the catalogue cannot be read.
pub fn solve_frame(
    frame: &Frame,
    measured: &Measured,
    catalogue: &Catalogue,
    known: &Known<'_>,
    clock: &Clock,
) -> Result<Result<Solution, NoSolution>, Unsolved> {
    let detected = Detected {
        stars: &measured.stars,
        width: frame.width_px as usize,
        height: frame.height_px as usize,
        quality: Some(&measured.quality),
    };
    if let Some(streaked) = streaked(measured) {
        return Ok(Err(streaked));
    }
    let began = clock.machine();
    let search = |hint: &Hint| {
        let side = f64::from(frame.width_px.max(frame.height_px));
        let stars = Hurried {
            stars: catalogue.at_epoch(epoch_year(middle_of(frame))),
            near: (hint.ra, hint.dec),
            search_radius: Angle::from_arcseconds(1.5 * side * hint.scale_arcsec_px),
            clock,
            began,
            timeout: known.timeout,
        };
        let found = solve(&detected, hint, &stars);
        stars.stars.checked().map_err(|error| {
            let detail = format!("the star catalogue cannot be read: {error}");
            Unsolved { class: UnsolvedClass::NoCatalogue, detail }
        })?;
        Ok(found)
    };
    if let Some(optics) = known.optics {
        let hint = learned_hint(frame, known, optics)?;
        // A part of the sensor does not look at the target until pointing has brought it there.
        let brought = known.aim.part_on_target(frame).map(|at| Hint { ra: at.ra, dec: at.dec, ..hint.clone() });
        for hint in [Some(hint), brought].into_iter().flatten() {
            let found = search(&hint)?;
            if !matches!(found, Err(NoSolution::NoMatch { .. } | NoSolution::Ambiguous { .. })) {
                return Ok(found);
            }
        }
    }
    // Another place, or other optics: as on first light.
    search(&first_hint(frame, known)?)
}

/// Why stars that are drawn out so far that each is seen as several are not solved: a solution would fit pieces of
/// them.
fn streaked(measured: &Measured) -> Option<NoSolution> {
    measured.quality.trail_px.map(|length_px| NoSolution::Trailed { stars: measured.quality.stars, length_px })
}

fn learned_hint(frame: &Frame, known: &Known<'_>, optics: &Optics) -> Result<Hint, Unsolved> {
    let learned = optics::learned(optics, frame);
    let at = known.aim.frame_centre(frame, Some(&learned))?;
    Ok(Hint {
        scale_tolerance: KNOWN_OPTICS,
        learned: Some(learned),
        // Within one field; whatever is further away may as well have other optics.
        furthest: Angle::default(),
        most_hypotheses: known.most_hypotheses,
        faintest_mag: optics::faintest_mag(optics, frame),
        ..Hint::new(at.ra, at.dec, learned.scale_arcsec_px)
    })
}

fn first_hint(frame: &Frame, known: &Known<'_>) -> Result<Hint, Unsolved> {
    let aim = known.aim;
    let at = aim.frame_centre(frame, None)?;
    let scale_arcsec_px = aim.scale_arcsec_px.or(known.optics.map(|optics| optics.scale_arcsec_px));
    let scale_arcsec_px = scale_arcsec_px.ok_or_else(|| Unsolved {
        class: UnsolvedClass::NoScale,
        detail: format!(
            "the size of a pixel on the sky is not known: neither the camera's PixelSizeX and the mount's FocalLength nor \
             scale_arcsec_px of the camera {} give it",
            frame.camera
        ),
    })?;
    // A part of the sensor lies so far from the middle, on a side that is not known.
    let away = Angle::from_arcseconds(scale_arcsec_px * aim.off_middle_px(frame));
    Ok(Hint {
        scale_tolerance: FIRST_LIGHT,
        furthest: known.furthest + away,
        wrong_scales: known.wrong_scales,
        most_hypotheses: known.most_hypotheses * if known.wrong_scales { WRONG_SCALES_COST } else { 1 },
        ..Hint::new(at.ra, at.dec, scale_arcsec_px)
    })
}

/// Puts a solution into the facts of its frame; what it teaches is returned.
pub fn describe(
    facts: &mut FrameFacts,
    frame: &Frame,
    solution: &Solution,
    aim: &FrameAim,
    observer: Option<&Observer>,
) -> Lesson {
    facts.ra_deg = finite(solution.ra.degrees());
    facts.dec_deg = finite(solution.dec.degrees());
    facts.scale_arcsec_px = finite(solution.scale_arcsec_px);
    facts.rotation_deg = if_finite(solution.rotation_deg);
    facts.mirrored = Some(solution.mirrored);
    facts.matched = u32::try_from(solution.matched).ok();
    facts.rms_px = if_finite(solution.rms_px);
    facts.false_alarm = finite(solution.false_alarm);
    facts.wcs = Some(wcs(&solution.wcs));
    facts.off_target_arcmin = aim.off_target(frame, &solution.wcs).and_then(|off| if_finite(off.degrees() * 60.0));
    let centre = Icrs { ra: solution.ra, dec: solution.dec };
    let altitude = observer.map(|observer| observer.to_horizontal(&centre).altitude);
    facts.airmass = altitude.and_then(sky::airmass).and_then(if_finite);
    let mut lesson = Lesson::of(frame, aim.pier_side, solution);
    if let Some(zero) = zero_point::measure(solution, frame.exposure_s) {
        facts.zero_point_mag = if_finite(zero.mag);
        facts.zero_point_error_mag = if_finite(zero.error_mag);
        // A frame of a focus run has blurred stars, and the dome's wall may take some of their light. The purpose of
        // the frame shows that it is one.
        if frame.purpose.action != "autofocus" {
            let best = ZeroPoint {
                camera: frame.camera.clone(),
                filter: frame.purpose.filter.clone(),
                gain: optics::gain(frame),
                best_mag: zero.mag,
                airmass: facts.airmass,
                at_utc: frame.started_utc,
            };
            lesson.zero_point = Some((zero, best));
        }
    }
    lesson
}

/// The class of a failure.
pub fn unsolved(reason: &NoSolution) -> Unsolved {
    let class = match reason {
        NoSolution::Hint { .. } => UnsolvedClass::BadHint,
        NoSolution::TooFewStars { .. } => UnsolvedClass::TooFewStars,
        NoSolution::Clouds { .. } => UnsolvedClass::Clouds,
        NoSolution::Trailed { .. } => UnsolvedClass::Trailed,
        NoSolution::Saturated { .. } => UnsolvedClass::Saturated,
        NoSolution::CatalogueTooShallow { .. } => UnsolvedClass::CatalogueTooShallow,
        NoSolution::Ambiguous { .. } => UnsolvedClass::Ambiguous,
        NoSolution::NoMatch { .. } | NoSolution::Blind { .. } => UnsolvedClass::NoMatch,
    };
    Unsolved { class, detail: reason.to_string() }
}

/// May a frame fail like this because its pixels have another size than configured?
pub fn may_be_scale(class: UnsolvedClass) -> bool {
    use UnsolvedClass::{Ambiguous, CatalogueTooShallow, NoMatch};
    matches!(class, NoMatch | Ambiguous | CatalogueTooShallow)
}

/// Share of the starlight that comes through, by zero points, 0 to 1.
pub fn transparency(zero_point_mag: f64, best_mag: f64) -> f64 {
    10_f64.powf(0.4 * (zero_point_mag - best_mag)).min(1.0)
}

fn epoch_year(at: Utc) -> f64 {
    2000.0 + (at.jd() - J2000_JD) / 365.25
}

/// A WCS as it travels.
pub fn wcs(wcs: &Wcs) -> FrameWcs {
    FrameWcs {
        ra_deg: wcs.ra.degrees(),
        dec_deg: wcs.dec.degrees(),
        x_px: wcs.x_px,
        y_px: wcs.y_px,
        cd_deg_px: wcs.cd_deg_px,
        sip: wcs.sip.map(|sip| contract::observatory::Distortion { a: sip.a, b: sip.b }),
    }
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}
