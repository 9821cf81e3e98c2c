//! `calibrate_guiding`: learns from pulses how they move the stars of a camera, and how much play declination has.

use std::sync::Arc;
use std::time::Duration;

use contract::device::telescope::{Direction, PierSide};
use contract::observatory::CalibrationSource;
use imaging::Star;
use imaging::guide::Reference;
use imaging::guide::calibration::pulses::{self, Next, Run, Warning};
use schemars::JsonSchema;
use serde::Deserialize;
use sky::{Icrs, Observer};
use units::seconds;

use super::expose::{Series, Shot, expose, fits};
use super::parameters::{Defocus, LONGEST_S, Metadata, Readout, both, takes_light};
use super::{Action, Needs, Place, Stage, Wrong};
use crate::frames::looked::Looked;
use crate::guiding::calibrated::{pier, unbinned};
use crate::guiding::{guide_rates, pulse};
use crate::opening;
use crate::plan::{Course, Halt};
use crate::rig::telescope::Mount;
use crate::slit::Aimed;
use crate::trouble::Trouble;

/// Learns from pulses how they move the stars of the row's camera, and how much of a pulse declination loses when it turns
/// round.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct CalibrateGuiding {
    /// Length of a pulse; absent: the way that the stars shall go over its pulses, where scale and guide rates are known,
    /// else 750.
    #[schemars(range(min = 10, max = 60_000), extend("unit" = "ms"))]
    pulse_time: Option<u32>,
    /// Exposure time.
    #[serde(default = "one_second")]
    #[schemars(range(min = 0, max = LONGEST_S), extend("unit" = "s"))]
    exptime: f64,
    /// Rest between a pulse and the exposure.
    #[serde(default = "one_second")]
    #[schemars(range(min = 0, max = 600), extend("unit" = "s"))]
    settle_time: f64,
    /// Pulses in each direction, 4 at least, as far as the stars stay within a quarter of the frame; absent: as many as
    /// bring them 25 px away.
    #[schemars(range(min = 1, max = 60), extend("unit" = "pulses"))]
    number_of_cycles: Option<u32>,
    /// Right ascension, ICRS, with `dec`; absent: one hour west of the meridian.
    #[schemars(range(min = -360, max = 360), extend("unit" = "deg"))]
    ra: Option<f64>,
    /// Declination, ICRS, with `ra`; absent: the equator.
    #[schemars(range(min = -89, max = 89), extend("unit" = "deg"))]
    dec: Option<f64>,
    /// Filter; the one in the beam where absent.
    filter: Option<String>,
    #[serde(flatten)]
    defocus: Defocus,
    #[serde(flatten)]
    readout: Readout,
    /// Folder for the files, inside the folder of images.
    dir: Option<String>,
    /// For `action_metadata` rows of the FITS-header table.
    #[serde(default)]
    metadata: Metadata,
}

/// A frame is fetched and measured within this, machine time.
const MEASURED_WITHIN: Duration = Duration::from_secs(60);
/// Steps that the way shall take where the row does not say, and the limits of a pulse that is chosen so, ms.
const STEPS: f64 = 10.0;
/// Fewer pulses tell no line.
const FEWEST: u32 = 4;
/// Half of the sky's speed, to which mounts are usually set, deg/s; for plans, which do not ask the mount.
const USUAL_RATE_DEG_S: f64 = 0.5 * 15.041_067 / 3600.0;
/// A run is begun anew so often after the tube has changed its side of the pier; more is no flip.
const TURNS: u32 = 2;
/// A mount that turns over is at rest again within this, sky s.
const TURNS_WITHIN_S: f64 = 300.0;
const TOO_LATE: &str = "the window ended before the calibration";
const PULSE_MS: std::ops::RangeInclusive<f64> = 50.0..=5000.0;

fn one_second() -> f64 {
    1.0
}

impl CalibrateGuiding {
    /// Where to calibrate: pulses in right ascension move the stars fastest at the equator.
    fn target(&self, observer: &Observer) -> Result<Icrs, Trouble> {
        let target = match (self.ra, self.dec) {
            (Some(ra), Some(dec)) => Icrs::from_degrees(ra, dec).checked()?,
            _ => Icrs::from_degrees((observer.sidereal_time().degrees() - 15.0).rem_euclid(360.0), 0.0),
        };
        let altitude_deg = observer.to_horizontal(&target).altitude.degrees();
        if altitude_deg > 0.0 {
            return Ok(target);
        }
        let (ra, dec) = (target.ra.degrees(), target.dec.degrees());
        let below = format!("ra {ra:.4}, dec {dec:.4} deg stands {altitude_deg:.1} deg, below the horizon");
        Err(Trouble::Impossible(below))
    }

    fn bin(&self) -> f64 {
        f64::from(self.readout.bin)
    }

    /// Takes a frame and waits for what it shows.
    async fn frame(&self, stage: &Stage, series: &Series, words: String) -> Result<Arc<Looked>, Trouble> {
        let (camera, began) = (stage.row.camera.as_str(), stage.clock().utc());
        let mut pixels = stage.room.looks.follow_pixels();
        let shot = Shot { exposure_s: self.exptime, image_type: "Light Frame", words };
        let mut wanted = Some(shot).filter(|shot| fits(began, shot.exposure_s, stage.row.end));
        if wanted.is_none() {
            return Err(Trouble::Impossible(TOO_LATE.to_owned()));
        }
        expose(stage, series, |_, _| wanted.take()).await?;
        let looked = async {
            loop {
                match pixels.recv().await {
                    // the frames before were waited for, so the next one of the row is this one
                    Ok(fetched) if fetched.frame.camera == camera && fetched.frame.purpose.row == Some(stage.index) => {
                        return stage.room.looks.of(&fetched.frame.id).await;
                    }
                    Ok(_) | Err(tokio::sync::broadcast::error::RecvError::Lagged(_)) => {}
                    Err(tokio::sync::broadcast::error::RecvError::Closed) => std::future::pending().await,
                }
            }
        };
        tokio::time::timeout(MEASURED_WITHIN, looked).await.map_err(|_| Trouble::Deadline {
            device: stage.room.node.config.address().device(contract::Kind::Camera, &stage.row.camera).to_string(),
            what: "a measured frame".to_owned(),
            after_s: MEASURED_WITHIN.as_secs_f64(),
        })
    }

    /// How to step: as the row says, or so that the stars go their way in as many steps as it says, or ten.
    fn settings(&self, looked: &Looked, mount: &Mount, target: &Icrs) -> pulses::Settings {
        let rates = mount.instrument.can().as_ref().and_then(guide_rates);
        let scale = looked.solved.as_ref().and_then(|solved| solved.as_ref().ok()).map(|s| s.scale_arcsec_px);
        let frame = &looked.frame;
        self.settings_of(rates.zip(scale), Some(frame.width_px.min(frame.height_px)), side(mount), target)
    }

    /// ... where the guide rates, deg/s, and the scale, arcsec/px, are known together, the shorter side of the frame, px, and
    /// the side of the pier.
    fn settings_of(
        &self,
        known: Option<([f64; 2], f64)>,
        frame_px: Option<u32>,
        side: Option<PierSide>,
        target: &Icrs,
    ) -> pulses::Settings {
        let expected_px_s = known.map(|([ra, dec], scale_arcsec_px)| {
            [3600.0 * ra * target.dec.cos() / scale_arcsec_px, 3600.0 * dec / scale_arcsec_px]
        });
        let plain = pulses::Settings::default();
        let cycles = self.number_of_cycles.map(|cycles| cycles.max(FEWEST));
        let (steps, way) = (cycles.map(|cycles| cycles as usize), cycles.map_or(STEPS, f64::from));
        let chosen = expected_px_s.map(|[east, north]| 1000.0 * plain.distance_px / way / east.min(north));
        let chosen = chosen.filter(|ms| ms.is_finite()).map(|ms| ms.clamp(*PULSE_MS.start(), *PULSE_MS.end()));
        let pulse_ms = self.pulse_time.or(chosen.map(|ms| ms.round() as u32)).unwrap_or(plain.pulse_ms);
        let distance_px = match (steps, frame_px) {
            (Some(_), Some(frame_px)) => f64::from(frame_px) / 4.0,
            _ => plain.distance_px,
        };
        let dec_deg = target.dec.degrees();
        pulses::Settings { pulse_ms, distance_px, steps, dec_deg, pier: pier(side), expected_px_s, ..plain }
    }

    /// Steps until a run has ended; one during which the tube went to the other side of the pier, or of which the mount told
    /// that only now, is begun anew where it stands then.
    async fn step(&self, stage: &Stage, series: &Series, mount: &Mount, target: &Icrs) -> Result<String, Trouble> {
        let mut again = 0;
        loop {
            match self.once(stage, series, mount, target).await? {
                Ended::Calibrated(told) => return Ok(told),
                Ended::Turned(why) if again < TURNS => {
                    again += 1;
                    tracing::info!(mount = %mount.instrument.device.name, why, "the calibration begins anew");
                    stage.step(format!("calibrating anew: {why}"));
                    still(stage, mount).await?;
                }
                Ended::Turned(why) => return Err(failed(mount, why)),
            }
        }
    }

    async fn once(&self, stage: &Stage, series: &Series, mount: &Mount, target: &Icrs) -> Result<Ended, Trouble> {
        let first = self.frame(stage, series, "exposing the reference".to_owned()).await?;
        let settings = self.settings(&first, mount, target);
        let pier_side = settings.pier;
        let (mut reference, mut run) = (reference(&first)?, Run::new(settings));
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
                    if let Some(why) = pulse::objection(&stage.room, &stage.row, mount) {
                        return Err(failed(mount, why));
                    }
                    count += 1;
                    pulse::pulse(mount, ascom(*direction), *length_ms).await?;
                    format!("calibrating: pulse {count}, {direction:?} {length_ms} ms")
                }
                Next::Measure => "calibrating: the last frame showed no star".to_owned(),
                Next::Failed(failure) => return Err(failed(mount, failure.to_string())),
                Next::Done { calibration, warnings } => {
                    let (now, camera) = (stage.clock().utc(), stage.row.camera.as_str());
                    let made = unbinned(calibration, self.readout.bin, CalibrationSource::Pulses, now);
                    let told = told(calibration, warnings, count);
                    tracing::info!(camera, told, "guiding is calibrated");
                    stage.room.guide_learnt.change(|learnt| {
                        learnt.keep_calibration(camera, made);
                        true
                    });
                    return Ok(Ended::Calibrated(told));
                }
            };
            stage.clock().sleep_sky(seconds(self.settle_time)).await;
            let looked = self.frame(stage, series, words).await?;
            (mid_s, place) = (middle_s(&looked), seen(&mut reference, &looked));
        }
    }
}

/// How a run ended.
enum Ended {
    /// With what is worth telling.
    Calibrated(String),
    /// The tube went elsewhere meanwhile: what was measured so far holds for neither place.
    Turned(String),
}

fn slews(mount: &Mount) -> bool {
    mount.instrument.fresh().is_some_and(|state| state.fields.slewing.known() == Some(&true))
}

/// Waits until the mount has come to rest.
async fn still(stage: &Stage, mount: &Mount) -> Result<(), Trouble> {
    let began = stage.clock().utc();
    loop {
        stage.clock().sleep_sky(seconds(2.0)).await;
        if mount.instrument.fresh().is_some() && !slews(mount) {
            return Ok(());
        }
        if stage.clock().utc().seconds_since(began) > TURNS_WITHIN_S {
            return Err(failed(mount, format!("it did not come to rest within {TURNS_WITHIN_S} s")));
        }
    }
}

/// Where the stars of the first frame stand.
fn reference(looked: &Looked) -> Result<Reference, Trouble> {
    let (width, height) = (looked.frame.width_px as usize, looked.frame.height_px as usize);
    Reference::from_lists(&[stars(looked)], width, height).map_err(|why| {
        let reason = looked.facts.reason.clone().unwrap_or_else(|| why.to_string());
        Trouble::Impossible(format!("no stars to calibrate on: {reason}"))
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

fn failed(mount: &Mount, reason: String) -> Trouble {
    Trouble::Failed { device: mount.instrument.device.to_string(), verb: "be calibrated".to_owned(), reason }
}

fn told(calibration: &imaging::guide::Calibration, warnings: &[Warning], pulses: u32) -> String {
    let way = |[x, y]: [f64; 2]| format!("{:.2} px/s at {:.0} deg", x.hypot(y), y.atan2(x).to_degrees());
    let (east, north) = (way(calibration.east_px_s), way(calibration.north_px_s));
    let play_s = calibration.backlash_s.unwrap_or(0.0);
    let mut told = format!("East {east}, North {north}, declination loses {play_s:.2} s, {pulses} pulses");
    for warning in warnings {
        told.push_str(&format!("; {warning}"));
    }
    told
}

impl Action for CalibrateGuiding {
    const NAME: &'static str = "calibrate_guiding";
    const EXAMPLE: &'static str = r#"{"filter": "V", "exptime": 2, "pulse_time": 1000}"#;

    fn check(&self) -> Result<(), Wrong> {
        self.readout.check()?;
        takes_light(self.exptime)?;
        both("ra", self.ra.is_some(), "dec", self.dec.is_some())
    }

    fn needs(&self) -> Needs {
        Needs { safe: true, mount: true, parallel: false, all_before: false }
    }

    fn azimuth_deg(&self, sky: &Observer) -> Option<f64> {
        self.target(sky).ok().map(|target| sky.to_horizontal(&target).azimuth.degrees())
    }

    fn looks_at(&self) -> Option<Place> {
        let (ra, dec) = self.ra.zip(self.dec)?;
        Some(Place::Icrs(Icrs::from_degrees(ra, dec)))
    }

    fn filters(&self) -> Vec<&str> {
        self.filter.as_deref().into_iter().collect()
    }

    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        let observer = course.observer(course.now)?;
        let target = self.target(&observer).map_err(|why| Halt::Failed(why.to_string()))?;
        course.begin(Some(Some(&target)), self.filter.as_deref())?;
        course.reads(&self.readout);
        let scale = course.camera().and_then(|camera| camera.scale_arcsec_px).map(|scale| scale * self.bin());
        let settings = self.settings_of(scale.map(|scale| ([USUAL_RATE_DEG_S; 2], scale)), None, None, &target);
        let [east, north] = settings.expected_px_s.unwrap_or([settings.distance_px / STEPS / 0.75; 2]);
        let mut run = Run::new(settings);
        let (mut place, began) = ([0.0, 0.0], course.now);
        let late = || Halt::Failed(TOO_LATE.to_owned());
        loop {
            if !fits(course.now, self.exptime, course.row.end) {
                return Err(late());
            }
            let middle_s = course.now.seconds_since(began) + 0.5 * self.exptime;
            course.frame(self.exptime, true)?;
            match run.next(middle_s, Some(place)) {
                Next::Pulse { direction, length_ms } => {
                    let length_s = f64::from(length_ms) / 1000.0;
                    let [x, y] = &mut place;
                    match direction {
                        pulses::Direction::East => *x += east * length_s,
                        pulses::Direction::West => *x -= east * length_s,
                        pulses::Direction::North => *y += north * length_s,
                        pulses::Direction::South => *y -= north * length_s,
                    }
                    course.pass(length_s + self.settle_time)?;
                }
                Next::Measure => course.pass(self.settle_time)?,
                Next::Done { .. } => return Ok(()),
                Next::Failed(why) => return Err(Halt::Failed(why.to_string())),
            }
        }
    }

    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        let chain = stage.chain()?;
        let mount = chain.mount;
        let mount = mount.ok_or_else(|| Trouble::Impossible(format!("{} has no mount", stage.row.camera)))?;
        if !mount.instrument.capabilities().await?.pulse_guide {
            let name = &mount.instrument.device.name;
            let cannot =
                format!("{name} takes no guide pulses (CanPulseGuide is false): there is nothing to calibrate");
            return Err(Trouble::Impossible(cannot));
        }
        chain.camera.start_cooling().await?;
        let target = self.target(&stage.observer(stage.clock().utc())?)?;
        let _aimed = Aimed::at(&stage.room, mount, target);
        let point = async {
            stage.step("opening");
            opening::open(&stage.room, &chain).await?;
            stage.step("slewing");
            mount.point(&target, &stage.observer(stage.clock().utc())?).await
        };
        tokio::try_join!(point, stage.filter_and_focus(self.filter.as_deref(), self.defocus.wanted()))?;
        stage.step("cooling");
        stage.cool().await?;
        let series = Series {
            action: None,
            focus: None,
            object: Some("Guiding calibration".to_owned()),
            target_deg: Some((target.ra.degrees(), target.dec.degrees())),
            filter: self.filter.clone(),
            bin: self.readout.bin,
            subframe: self.readout.on(chain.camera).await?,
            folder: self.dir.clone(),
            open_sky: true,
            metadata: self.metadata.texts(),
        };
        stage.step("calibrating");
        let told = self.step(stage, &series, mount, &target).await?;
        mount.track(false).await?;
        Ok(told)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn action(value: &str) -> Result<CalibrateGuiding, String> {
        crate::action::read_text(value)
    }

    #[test]
    fn it_calibrates_one_hour_west_of_the_meridian_on_the_equator_unless_told_otherwise() {
        let place = sky::Place::new(units::Angle::from_degrees(-24.6), units::Angle::from_degrees(-70.4), 2600.0);
        let at = "2026-11-21T03:00:00Z".parse().unwrap();
        let observer = Observer::new(&place.unwrap(), &Default::default(), at).unwrap();
        let target = action("{}").unwrap().target(&observer).unwrap();
        let hour_angle_deg = observer.hour_angle(&target).wrapped_signed().degrees();
        // the difference is that of J2000 and date
        assert!((hour_angle_deg - 15.0).abs() < 0.6 && target.dec.degrees() == 0.0, "{hour_angle_deg}");
        let chosen = action(r#"{"ra": 45.0, "dec": -24.6}"#).unwrap().target(&observer).unwrap();
        assert_eq!((chosen.ra.degrees(), chosen.dec.degrees()), (45.0, -24.6));
        let below = action(r#"{"ra": 45.0, "dec": 80.0}"#).unwrap().target(&observer);
        assert!(below.unwrap_err().to_string().contains("below the horizon"));
    }

    #[test]
    fn parameters_that_no_mount_can_follow_are_refused_by_name() {
        for (value, name) in [
            (r#"{"pulse_time": 0}"#, "pulse_time"),
            (r#"{"exptime": -1}"#, "exptime"),
            (r#"{"settle_time": 1e9}"#, "settle_time"),
            (r#"{"ra": 10}"#, "ra"),
        ] {
            assert!(action(value).unwrap_err().starts_with(name), "{value}");
        }
        assert!(action(r#"{"number_of_cycles": 10, "pulse_time": 5000, "focus_shift": 10}"#).is_ok());
    }
}
