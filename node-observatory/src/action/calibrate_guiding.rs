//! `calibrate_guiding`: learns from pulses how they move the stars of a camera, and how much play declination has.

use std::sync::Arc;
use std::time::Duration;

use contract::device::telescope::{Direction, PierSide};
use contract::observatory::CalibrationSource;
use imaging::Star;
use imaging::guide::Reference;
use imaging::guide::calibration::pulses::{self, CalibrationRun, Next, Warning};
use schedule::action::calibrate_guiding::{CalibrateGuiding, TOO_LATE, pier};
use schedule::plan::TimedPart;
use schedule::shot::{Shot, fits};
use sky::Icrs;
use units::seconds;

use super::{Execute, Techniques, read_out};
use crate::action_error::ActionError;
use crate::devices::telescope::Mount;
use crate::expected::Lasts;
use crate::exposing::{Series, expose};
use crate::frames::looked::Looked;
use crate::guiding::calibrated::unbinned;
use crate::guiding::{GuidingData, guide_rates, pulse};
use crate::opening;
use crate::row_context::RowContext;
use crate::slit::Aimed;

/// A frame is fetched and measured within this, machine time.
const MEASURED_WITHIN: Duration = Duration::from_secs(60);
/// A run is begun anew so often after the tube has changed its side of the pier; more is no flip.
const TURNS: u32 = 2;
/// A mount that turns over is at rest again within this, sky s.
const TURNS_WITHIN_S: f64 = 300.0;

impl Execute for CalibrateGuiding {
    async fn run(&self, context: &RowContext, techniques: &Techniques) -> Result<String, ActionError> {
        let chain = context.chain()?;
        let mount = chain.mount;
        let mount = mount.ok_or_else(|| ActionError::Impossible(format!("{} has no mount", context.row.camera)))?;
        if !mount.instrument.capabilities().await?.pulse_guide {
            let name = &mount.instrument.device.name;
            let cannot =
                format!("{name} takes no guide pulses (CanPulseGuide is false): there is nothing to calibrate");
            return Err(ActionError::Impossible(cannot));
        }
        chain.camera.start_cooling().await?;
        let target = self.target(&context.observer(context.clock().utc())?).map_err(ActionError::Impossible)?;
        let _aimed = Aimed::at(&context.tools.slits, mount, target);
        let point = async {
            context.step("opening", TimedPart::Open);
            opening::open(&techniques.opener, &chain).await?;
            context.step("slewing", TimedPart::Slew);
            mount.point(&target, &context.observer(context.clock().utc())?).await
        };
        tokio::try_join!(point, context.filter_and_focus(self.filter.as_deref(), self.defocus.wanted()))?;
        context.step("cooling", TimedPart::Cool);
        context.cool().await?;
        let series = Series {
            action: None,
            focus: None,
            object: Some("Guiding calibration".to_owned()),
            target_deg: Some((target.ra.degrees(), target.dec.degrees())),
            filter: self.filter.clone(),
            bin: self.readout.bin,
            subframe: read_out(&self.readout, chain.camera).await?,
            folder: self.dir.clone(),
            open_sky: true,
            metadata: self.metadata.texts(),
        };
        context.step("calibrating", Lasts::Unbounded);
        let report = step(self, context, &techniques.guiding, &series, mount, &target).await?;
        context.leave_mount();
        Ok(report)
    }
}

/// Takes a frame and waits for what it shows.
async fn frame(
    calibrate: &CalibrateGuiding,
    context: &RowContext,
    series: &Series,
    words: String,
) -> Result<Arc<Looked>, ActionError> {
    let (camera, began) = (context.row.camera.as_str(), context.clock().utc());
    let mut pixels = context.tools.frames.looks.follow_pixels();
    let shot = Shot { exposure_s: calibrate.exptime, image_type: "Light Frame", words };
    let mut wanted = Some(shot).filter(|shot| fits(began, shot.exposure_s, context.row.end));
    if wanted.is_none() {
        return Err(ActionError::Impossible(TOO_LATE.to_owned()));
    }
    expose(context, series, |_, _| wanted.take()).await?;
    let looked = async {
        loop {
            match pixels.recv().await {
                // The frames before were waited for, so the next one of the row is this one.
                Ok(fetched) if fetched.frame.camera == camera && fetched.frame.purpose.row == Some(context.index) => {
                    return context.tools.frames.looks.of(&fetched.frame.id).await;
                }
                Ok(_) | Err(tokio::sync::broadcast::error::RecvError::Lagged(_)) => {}
                Err(tokio::sync::broadcast::error::RecvError::Closed) => std::future::pending().await,
            }
        }
    };
    tokio::time::timeout(MEASURED_WITHIN, looked).await.map_err(|_| ActionError::Deadline {
        device: context
            .tools
            .authority
            .node
            .config
            .address()
            .device(contract::Kind::Camera, &context.row.camera)
            .to_string(),
        what: "a measured frame".to_owned(),
        after_s: MEASURED_WITHIN.as_secs_f64(),
    })
}

/// How to step: as the row orders, or so that the stars go their way in as many steps as it orders, or ten.
fn settings(
    calibrate: &CalibrateGuiding,
    looked: &Looked,
    mount: &Mount,
    target: &Icrs,
) -> pulses::CalibrationSettings {
    let rates = mount.instrument.can().as_ref().and_then(guide_rates);
    let scale = looked.solved.as_ref().and_then(|solved| solved.as_ref().ok()).map(|s| s.scale_arcsec_px);
    let frame = &looked.frame;
    calibrate.settings_of(rates.zip(scale), Some(frame.width_px.min(frame.height_px)), side(mount), target)
}

/// Steps until a run has ended. A run begins anew at the present place when the tube went to the other side of the pier
/// during it, or when the mount reported only during it that the tube had gone there.
async fn step(
    calibrate: &CalibrateGuiding,
    context: &RowContext,
    guiding: &GuidingData,
    series: &Series,
    mount: &Mount,
    target: &Icrs,
) -> Result<String, ActionError> {
    let mut again = 0;
    loop {
        match once(calibrate, context, guiding, series, mount, target).await? {
            Ended::Calibrated(report) => return Ok(report),
            Ended::Turned(why) if again < TURNS => {
                again += 1;
                tracing::info!(mount = %mount.instrument.device.name, why, "the calibration begins anew");
                context.step(format!("calibrating anew: {why}"), Lasts::Unbounded);
                still(context, mount).await?;
            }
            Ended::Turned(why) => return Err(failed(mount, why)),
        }
    }
}

async fn once(
    calibrate: &CalibrateGuiding,
    context: &RowContext,
    guiding: &GuidingData,
    series: &Series,
    mount: &Mount,
    target: &Icrs,
) -> Result<Ended, ActionError> {
    let first = frame(calibrate, context, series, "exposing the reference".to_owned()).await?;
    let settings = settings(calibrate, &first, mount, target);
    let pier_side = settings.pier;
    let (mut reference, mut run) = (reference(&first)?, CalibrationRun::new(settings));
    let (mut mid_s, mut place) = (middle_s(&first), Some([0.0, 0.0]));
    let mut count = 0_u32;
    loop {
        let next = run.next(mid_s, place);
        let words = match &next {
            Next::Pulse { direction, length_ms } => {
                if pier(side(mount)) != pier_side {
                    return Ok(Ended::Turned("the side of the pier changed".to_owned()));
                }
                if slews(mount) {
                    return Ok(Ended::Turned("the mount slews".to_owned()));
                }
                if let Some(refused) = pulse::objection(&context.tools.authority, &context.row, mount) {
                    return Err(failed(mount, refused.why));
                }
                count += 1;
                pulse::pulse(mount, ascom(*direction), *length_ms).await?;
                format!("calibrating: pulse {count}, {direction:?} {length_ms} ms")
            }
            Next::Measure => "calibrating: the last frame showed no star".to_owned(),
            Next::Failed(failure) => return Err(failed(mount, failure.to_string())),
            Next::Done { calibration, warnings } => {
                let (now, camera) = (context.clock().utc(), context.row.camera.as_str());
                let made = unbinned(calibration, calibrate.readout.bin, CalibrationSource::Pulses, now);
                let report = summary(calibration, warnings, count);
                tracing::info!(camera, report, "guiding is calibrated");
                guiding.learned.change(|learned| {
                    learned.keep_calibration(camera, made);
                    true
                });
                return Ok(Ended::Calibrated(report));
            }
        };
        context.clock().sleep_sky(seconds(calibrate.settle_time)).await;
        let looked = frame(calibrate, context, series, words).await?;
        (mid_s, place) = (middle_s(&looked), seen(&mut reference, &looked));
    }
}

/// How a run ended.
enum Ended {
    /// With a summary for the row's status.
    Calibrated(String),
    /// The tube went elsewhere meanwhile: the measurements so far are valid for neither place.
    Turned(String),
}

fn slews(mount: &Mount) -> bool {
    mount.instrument.fresh().is_some_and(|state| state.fields.slewing.known() == Some(&true))
}

/// Waits until the mount has come to rest.
async fn still(context: &RowContext, mount: &Mount) -> Result<(), ActionError> {
    let began = context.clock().utc();
    loop {
        context.clock().sleep_sky(seconds(2.0)).await;
        if mount.instrument.fresh().is_some() && !slews(mount) {
            return Ok(());
        }
        if context.clock().utc().seconds_since(began) > TURNS_WITHIN_S {
            return Err(failed(mount, format!("it did not come to rest within {TURNS_WITHIN_S} s")));
        }
    }
}

/// Where the stars of the first frame are.
fn reference(looked: &Looked) -> Result<Reference, ActionError> {
    let (width, height) = (looked.frame.width_px as usize, looked.frame.height_px as usize);
    Reference::from_lists(&[stars(looked)], width, height).map_err(|why| {
        let reason = looked.facts.reason.clone().unwrap_or_else(|| why.to_string());
        ActionError::Impossible(format!("no stars to calibrate on: {reason}"))
    })
}

fn stars(looked: &Looked) -> Vec<Star> {
    looked.measured.as_ref().map(|measured| measured.stars.clone()).unwrap_or_default()
}

/// Middle of its exposure, s since 1970.
fn middle_s(looked: &Looked) -> f64 {
    looked.frame.started_utc.seconds() + 0.5 * looked.frame.exposure_s
}

/// How far the stars went, px.
fn seen(reference: &mut Reference, looked: &Looked) -> Option<[f64; 2]> {
    let shift = reference.register(&stars(looked)).ok()?.shift;
    Some([shift.dx_px, shift.dy_px])
}

fn side(mount: &Mount) -> Option<PierSide> {
    mount.instrument.fresh().and_then(|state| state.fields.pier_side.known().copied())
}

fn ascom(direction: pulses::Direction) -> Direction {
    match direction {
        pulses::Direction::North => Direction::North,
        pulses::Direction::South => Direction::South,
        pulses::Direction::East => Direction::East,
        pulses::Direction::West => Direction::West,
    }
}

fn failed(mount: &Mount, reason: String) -> ActionError {
    ActionError::Failed { device: mount.instrument.device.to_string(), verb: "be calibrated".to_owned(), reason }
}

fn summary(calibration: &imaging::guide::Calibration, warnings: &[Warning], pulses: u32) -> String {
    let way = |[x, y]: [f64; 2]| format!("{:.2} px/s at {:.0} deg", x.hypot(y), y.atan2(x).to_degrees());
    let (east, north) = (way(calibration.east_px_s), way(calibration.north_px_s));
    let play_s = calibration.backlash_s.unwrap_or(0.0);
    let mut report = format!("East {east}, North {north}, declination loses {play_s:.2} s, {pulses} pulses");
    for warning in warnings {
        report.push_str(&format!("; {warning}"));
    }
    report
}
