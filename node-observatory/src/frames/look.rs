//! One look at a frame: its stars, its place on the sky, and what that teaches.

use std::sync::Arc;

use contract::device::camera::Frame;
use contract::observatory::{FrameFacts, Unsolved, UnsolvedClass};
use imaging::solve::Level;

use super::Measuring;
use super::aim::{FrameAim, middle_of};
use super::looked::{Fetched, Looked};
use super::measure::{self, Plane, measure};
use super::optics::{self, Lesson};
use super::solving::{self, Known, solve_frame};

/// What the frames of a camera and binning before this one showed.
#[derive(Debug, Clone, Copy, Default)]
pub struct EarlierFrames {
    /// Width of the stars on the last one, px: where the next search begins.
    pub width: Option<f32>,
    /// Frames in a row that fitted the catalogue nowhere.
    pub unmatched: u32,
}

/// Looks at a frame's pixels, as the spool has them; takes a while. `on_measured` gets the facts as soon as the stars
/// are known, if the place is still to be found.
pub fn look(
    measuring: &Measuring,
    frame: Frame,
    bytes: Vec<u8>,
    before: EarlierFrames,
    on_measured: impl FnOnce(Option<FrameFacts>),
) -> (Looked, Option<Lesson>) {
    let clock = measuring.authority.node.bus.clock();
    let began = clock.machine();
    let camera = measure::camera(&measuring.authority.node.config, &frame);
    let plane = measuring.frames.darks.taken_off(&frame, &camera, Plane::of(&frame, bytes));
    let fetched = Arc::new(Fetched { frame, plane, camera });
    measuring.frames.looks.fetched(&fetched);
    let (facts, measured) = measure(&fetched.frame, &fetched.plane, &fetched.camera, before.width);
    let mut looked = Looked { frame: fetched.frame.clone(), facts, measured, solved: None };
    // A task that follows the pixels holds its own reference to them.
    drop(fetched);
    let is_sought = looked.measured.is_some() && measuring.authority.node.config.imaging.solve;
    let measuring_s = Some(clock.machine().since(began).as_secs_f64());
    on_measured(is_sought.then(|| FrameFacts { measuring_s, ..looked.facts.clone() }));
    let lesson = place(measuring, &mut looked, before.unmatched);
    looked.facts.measuring_s = Some(clock.machine().since(began).as_secs_f64());
    (looked, lesson)
}

/// Finds where a frame with stars points, and what that teaches.
fn place(measuring: &Measuring, looked: &mut Looked, unmatched: u32) -> Option<Lesson> {
    let Looked { frame, facts, measured, solved } = looked;
    let measured = measured.as_ref().filter(|_| measuring.authority.node.config.imaging.solve)?;
    let clock = measuring.authority.node.bus.clock();
    let began = clock.machine();
    let aim = FrameAim::of(&measuring.authority, &measuring.devices, &measuring.frames.mounts, frame);
    facts.pier_side = aim.pier_side;
    let state = measuring.frames.optics.get();
    let was_ever_solved = state.optics.iter().any(|known| (&known.camera, known.bin) == (&frame.camera, frame.bin));
    let known = Known::new(&aim, optics::known(&state, frame, aim.pier_side)).after(unmatched, was_ever_solved);
    let no_catalogue = || Unsolved {
        class: UnsolvedClass::NoCatalogue,
        detail: "the star catalogue is not open (yet); an alert says why if it cannot be opened".to_owned(),
    };
    let tried = match measuring.frames.catalogue.get() {
        Some(catalogue) => solve_frame(frame, measured, &catalogue, &known, clock),
        None => Err(no_catalogue()),
    };
    facts.solving_s = Some(clock.machine().since(began).as_secs_f64());
    let found = tried.map_err(|unsolved| facts.unsolved = Some(unsolved)).ok()?;
    let lesson = match &found {
        Ok(solution) => {
            if solution.level == Level::Scale {
                let (camera, scale_arcsec_px) = (&frame.camera, solution.scale_arcsec_px);
                let stated_arcsec_px = aim.scale_arcsec_px;
                tracing::warn!(
                    camera,
                    scale_arcsec_px,
                    stated_arcsec_px,
                    "the camera's pixels are not as large as configured"
                );
            }
            let observer = measuring.authority.observer(middle_of(frame)).ok();
            let lesson = solving::describe(facts, frame, solution, &aim, observer.as_ref());
            let star = aim.target_star(&solution.wcs, &measured.stars);
            facts.target_saturated = star.map(|star| star.flags.saturated);
            let best = optics::best_zero_point(&state, frame);
            let share = facts.zero_point_mag.zip(best).map(|(zero, best)| solving::transparency(zero, best));
            facts.transparency = share.and_then(measure::if_finite);
            Some(lesson)
        }
        Err(reason) => {
            facts.unsolved = Some(solving::unsolved(reason));
            None
        }
    };
    *solved = Some(found);
    lesson
}
