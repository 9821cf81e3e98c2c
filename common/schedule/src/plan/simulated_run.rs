//! The simulated run of one row: an action executes its steps on it, and time passes instead of devices moving.
//!
//! Each step may end the run, as each `.await` may in the observatory node: when the sky is no longer safe, or the
//! target goes beyond the mount's limits.

use config::{Camera, Observatory, Telescope};
use contract::device::telescope::PierSide;
use sky::{Icrs, Observer, separation};
use units::Utc;

use super::Site;
use super::overheads::TimedPart;
use super::world::{Aim, World};
use crate::action::Place;
use crate::action::parameters::Readout;
use crate::horizon_limits::HorizonLimits;
use crate::meridian_flip;
use crate::row::Row;
use crate::shot::Shot;
use crate::slew_limits;

/// A slew from the park position, or from an unknown position, goes so far, deg.
const UNKNOWN_WAY_DEG: f64 = 60.0;
/// A dome's slit is wide enough for shorter ways, deg.
const SLIT_WAY_DEG: f64 = 5.0;
/// The tube of a German mount turns by about this to look at the same place from the other side, deg.
const FLIP_WAY_DEG: f64 = 180.0;
/// No camera begins its next frame sooner, s; it bounds the work for a row of biases without end.
const LEAST_GAP_S: f64 = 0.01;
/// Frames of one row that are followed.
const MOST_FRAMES: u32 = 1_000_000;
/// The time when a target sets is searched in steps of this, s, ...
const REACH_STEP_S: f64 = 1200.0;
/// ... and the moment is narrowed down to this, s.
const REACH_PRECISION_S: f64 = 1.0;

/// Why a simulated run ends before its end.
#[derive(Debug, Clone, PartialEq)]
pub enum Halt {
    /// The row may not run from now on; it goes on when it may again.
    Interrupted,
    /// Its target is hidden until then, in words; the row waits, and others go meanwhile.
    Hidden(Utc, String),
    /// It cannot be done; the text is the reason.
    Failed(String),
}

/// The simulated run.
pub struct SimulatedRun<'a> {
    /// The row.
    pub row: &'a Row,
    /// Sky time.
    pub now: Utc,
    /// Frames that count, those of before an interruption included.
    pub taken: u32,
    site: &'a mut Site,
    world: &'a mut World,
    /// When the run must end, and how.
    ends: Vec<(Utc, Halt)>,
    readout: Option<Readout>,
    pub(super) notes: Vec<String>,
    /// When the shutter was open to the sky.
    pub(super) light: Vec<(Utc, Utc)>,
    pub(super) exposed_s: f64,
    pub(super) bytes: f64,
    /// The direction where it looked, if the row itself does not contain it.
    pub(super) looked: Option<Icrs>,
}

impl<'a> SimulatedRun<'a> {
    pub(super) fn new(
        row: &'a Row,
        (now, taken): (Utc, u32),
        site: &'a mut Site,
        world: &'a mut World,
        ends: Vec<(Utc, Halt)>,
    ) -> Self {
        let (notes, light) = (Vec::new(), Vec::new());
        Self {
            row,
            now,
            taken,
            site,
            world,
            ends,
            readout: None,
            notes,
            light,
            exposed_s: 0.0,
            bytes: 0.0,
            looked: None,
        }
    }

    /// The configuration.
    pub fn config(&self) -> &Observatory {
        &self.site.config
    }

    /// The row's camera, as it is configured.
    pub fn camera(&self) -> Option<&Camera> {
        self.site.config.camera.iter().find(|camera| camera.common.name == self.row.camera)
    }

    /// The mount that carries it.
    pub fn mount(&self) -> Option<&Telescope> {
        let name = self.camera()?.telescope.as_ref();
        self.site.config.telescope.iter().find(|mount| Some(&mount.common.name) == name)
    }

    /// The place of the site, and the orientation of the Earth.
    pub fn site(&self) -> (sky::Place, sky::EarthOrientation) {
        self.site.sky.site()
    }

    /// The overheads of all steps.
    pub fn overheads(&self) -> &super::Overheads {
        &self.site.overheads
    }

    /// The sky at an instant.
    pub fn observer(&mut self, at: Utc) -> Result<Observer, Halt> {
        self.site.sky.at(at).map_err(failed)
    }

    /// Adds a remark for the astronomer.
    pub fn note(&mut self, words: impl Into<String>) {
        self.notes.push(words.into());
    }

    /// Time passes, s.
    pub fn pass(&mut self, span_s: f64) -> Result<(), Halt> {
        let then = self.now.plus_seconds(span_s.max(0.0));
        let first = self.ends.iter().filter(|(at, _)| *at <= then).min_by_key(|(at, _)| *at);
        match first {
            Some((at, halt)) => {
                self.now = self.now.max(*at);
                Err(halt.clone())
            }
            None => {
                self.now = then;
                Ok(())
            }
        }
    }

    /// Waits for an instant; none that has passed.
    pub fn wait_until(&mut self, at: Utc) -> Result<(), Halt> {
        self.pass(at.seconds_since(self.now))
    }

    /// Ends the run at that time.
    pub fn ends_at(&mut self, at: Utc, halt: Halt) {
        self.ends.push((at, halt));
    }

    /// The cooler runs from now on.
    pub fn start_cooling(&mut self) {
        if self.camera().is_some_and(|camera| camera.temperature_c.is_some()) {
            let cold = self.now.plus_seconds(self.site.overheads.span(TimedPart::Cool).value);
            self.world.cold.entry(self.row.camera.clone()).or_insert(cold);
        }
    }

    /// Waits until the sensor is cold.
    pub fn cool(&mut self) -> Result<(), Halt> {
        self.start_cooling();
        match self.world.cold.get(&self.row.camera) {
            Some(cold) => self.wait_until(*cold),
            None => Ok(()),
        }
    }

    /// Opens, unless it is open.
    pub fn open(&mut self) -> Result<(), Halt> {
        if !self.world.is_open() {
            if !self.config().dome.is_empty() || !self.config().covercalibrator.is_empty() {
                self.pass(self.site.overheads.span(TimedPart::Open).value)?;
            }
            self.world.open(self.now);
        }
        Ok(())
    }

    /// Closes, unless it is closed.
    pub fn close(&mut self) -> Result<(), Halt> {
        if self.world.is_open() {
            let takes_s = self.site.overheads.span(TimedPart::Close).value;
            self.world.close(self.now, takes_s);
            self.pass(takes_s)?;
        }
        Ok(())
    }

    /// The horizon limits of the row's mount.
    pub fn horizon_limits(&self) -> HorizonLimits {
        let mount = self.mount().map(|mount| &mount.common.name);
        mount.and_then(|mount| self.site.horizon_limits.get(mount)).cloned().unwrap_or_default()
    }

    /// Refuses a place that the site hides or that is beyond the mount's limits.
    pub fn reaches(&mut self, target: &Icrs) -> Result<(), Halt> {
        let observer = self.observer(self.now)?;
        let limits = self.mount().map(|mount| mount.limits.clone()).unwrap_or_default();
        let horizon = self.horizon_limits();
        if let Some(why) = horizon.hides(target, &observer) {
            let (place, orientation) = self.site();
            let sky = |at| Observer::new(&place, &orientation, at).ok();
            let clear = horizon.clear_from(target, self.now, self.row.end, sky);
            return Err(clear.map_or(Halt::Failed(why.clone()), |clear| Halt::Hidden(clear, why)));
        }
        let why = slew_limits::beyond(&limits, target, &observer);
        why.map_or(Ok(()), |why| Err(Halt::Failed(why)))
    }

    /// Slews, and settles; an unknown place counts as a slew of typical length.
    pub fn slew(&mut self, target: Option<&Icrs>) -> Result<(), Halt> {
        let Some(mount) = self.mount().map(|mount| mount.common.name.clone()) else {
            return Err(Halt::Failed(format!("{} has no mount", self.row.camera)));
        };
        if let Some(target) = target {
            self.reaches(target)?;
        }
        let from = self.world.aims.get(&mount).map(|aim| aim.at(self.now));
        let way = from.zip(target).map(|(from, to)| separation(&from, to).degrees());
        let way_deg = way.unwrap_or(UNKNOWN_WAY_DEG);
        self.pass(self.site.overheads.slew_s(way_deg))?;
        if way_deg >= SLIT_WAY_DEG {
            self.pass(self.site.overheads.span(TimedPart::Slit).value)?;
        }
        match target {
            Some(target) => {
                let looks_east = self.observer(self.now)?.hour_angle(target).wrapped_signed().hours() < 0.0;
                let side = if looks_east { PierSide::West } else { PierSide::East };
                self.world.aims.insert(mount, Aim { place: *target, stands_since: None, side });
                self.looked.get_or_insert(*target);
            }
            None => drop(self.world.aims.remove(&mount)),
        }
        Ok(())
    }

    /// Tracking ends.
    pub fn stand_still(&mut self) {
        let (mount, now) = (self.mount().map(|mount| mount.common.name.clone()), self.now);
        if let Some(aim) = mount.and_then(|mount| self.world.aims.get_mut(&mount)) {
            *aim = Aim { place: aim.at(now), stands_since: Some(now), ..*aim };
        }
    }

    /// Brings a filter into the beam; returns how long that takes, s, for the filter wheel turns while the mount slews.
    pub fn turn_to(&mut self, filter: Option<&str>) -> f64 {
        let Some(filter) = filter else { return 0.0 };
        let before = self.world.filters.insert(self.row.camera.clone(), filter.to_owned());
        if before.as_deref() == Some(filter) { 0.0 } else { self.site.overheads.span(TimedPart::Filter).value }
    }

    /// The steps with which most actions begin: the cooler starts; where the row moves the telescope, the dome opens
    /// and the mount slews while the filter wheel turns; then the camera is cold.
    pub fn begin(&mut self, target: Option<Option<&Icrs>>, filter: Option<&str>) -> Result<(), Halt> {
        self.start_cooling();
        let filter_there = self.now.plus_seconds(self.turn_to(filter));
        if let Some(target) = target {
            if let Some(target) = target {
                self.reaches(target)?;
            }
            self.open()?;
            self.slew(target)?;
        }
        self.wait_until(filter_there)?;
        self.cool()
    }

    /// Sets how the frames from now on are read.
    pub fn reads(&mut self, readout: &Readout) {
        self.readout = Some(*readout);
    }

    /// One frame, until the next may begin: its exposure, and the camera's overhead. It counts, unless it is taken
    /// `aside`.
    fn take(&mut self, exposure_s: f64, is_light: bool, aside: bool, gap_s: f64) -> Result<(), Halt> {
        let began = self.now;
        self.pass(exposure_s)?;
        if is_light && exposure_s > 0.0 {
            self.light.push((began, self.now));
        }
        self.world.last_exposure = self.world.last_exposure.max(Some(self.now));
        self.bytes += self.frame_bytes();
        if !aside {
            self.exposed_s += exposure_s;
            self.taken = self.taken.saturating_add(1);
        }
        if self.taken > MOST_FRAMES {
            return Err(Halt::Failed(format!("the plan follows no more than {MOST_FRAMES} frames of one row")));
        }
        self.pass(gap_s.max(LEAST_GAP_S))
    }

    /// One frame that counts, until the next may begin.
    pub fn frame(&mut self, exposure_s: f64, is_light: bool) -> Result<(), Halt> {
        let gap_s = self.site.overheads.frame(self.row.action.name()).value;
        self.take(exposure_s, is_light, false, gap_s)
    }

    /// One frame that does not count, until it was evaluated.
    pub fn aside(&mut self, exposure_s: f64, is_light: bool) -> Result<(), Halt> {
        let gap_s = self.site.overheads.frame(self.row.action.name()).value;
        self.take(exposure_s, is_light, true, gap_s)
    }

    /// Frames and corrections until the telescope is proven to be on target; the frames do not count.
    pub fn acquire(&mut self) -> Result<(), Halt> {
        self.bytes += self.frame_bytes();
        self.pass(self.site.overheads.span(TimedPart::Acquire).value)
    }

    /// Takes frames until `next` has none left; the last are then on disk.
    pub fn expose(&mut self, mut next: impl FnMut(&mut Self) -> Option<Shot>) -> Result<(), Halt> {
        let before = self.taken;
        while let Some(shot) = next(self) {
            self.frame(shot.exposure_s, !matches!(shot.image_type, "Bias Frame" | "Dark Frame"))?;
        }
        self.spool(before)
    }

    /// Waits until the frames are on disk, if there are more than before.
    pub fn spool(&mut self, before: u32) -> Result<(), Halt> {
        if self.taken > before { self.pass(self.site.overheads.span(TimedPart::Spool).value) } else { Ok(()) }
    }

    /// Must the mount be turned over before a frame of this length that begins now?
    pub fn flip_is_due(&mut self, target: &Icrs, exposure_s: f64) -> bool {
        let Some(mount) = self.mount().filter(|mount| mount.meridian_flip) else { return false };
        let (name, margin_min) = (mount.common.name.clone(), mount.meridian_flip_min);
        let side = self.world.aims.get(&name).map(|aim| aim.side);
        let Ok(then) = self.observer(self.now.plus_seconds(exposure_s)) else { return false };
        meridian_flip::is_past(side, then.hour_angle(target), margin_min)
    }

    /// Flips the mount: a slew to the place where it points.
    pub fn turn_over(&mut self) -> Result<(), Halt> {
        let at = self.now.strftime("%H:%M");
        self.pass(self.site.overheads.slew_s(FLIP_WAY_DEG))?;
        let mount = self.mount().map(|mount| mount.common.name.clone());
        if let Some(aim) = mount.and_then(|mount| self.world.aims.get_mut(&mount)) {
            aim.side = meridian_flip::turned(aim.side);
        }
        self.note(format!("meridian flip at {at}"));
        Ok(())
    }

    /// Ends the run where the target goes beyond the mount's limits within the row's window.
    pub fn ends_out_of_reach(&mut self, target: &Icrs) -> Result<(), Halt> {
        let limits = self.mount().map(|mount| mount.limits.clone()).unwrap_or_default();
        let end = self.row.end;
        let (mut within, mut at) = (self.now, self.now);
        let mut why = None;
        while at < end && why.is_none() {
            within = at;
            at = at.plus_seconds(REACH_STEP_S).min(end);
            why = slew_limits::beyond(&limits, target, &self.observer(at)?);
        }
        let Some(mut why) = why else { return Ok(()) };
        while at.seconds_since(within) > REACH_PRECISION_S {
            let middle = within.plus_seconds(0.5 * at.seconds_since(within));
            match slew_limits::beyond(&limits, target, &self.observer(middle)?) {
                Some(reason) => (at, why) = (middle, reason),
                None => within = middle,
            }
        }
        let when = at.strftime("%H:%M");
        self.ends_at(at, Halt::Failed(format!("it leaves the mount's reach at {when}: {why}")));
        Ok(())
    }

    /// The time at which the newest frames have whole headers.
    pub fn headers_whole(&self) -> Option<Utc> {
        self.world.last_exposure.map(|last| last.plus_seconds(self.site.overheads.headers_s.value))
    }

    /// Bytes of a frame as the row reads the sensor.
    fn frame_bytes(&self) -> f64 {
        let sensor = self.site.overheads.sensor(self.row.camera.as_str());
        let (bin, part) = self
            .readout
            .map_or((1, None), |readout| (readout.bin.max(1), readout.subframe_width.zip(readout.subframe_height)));
        let [width, height] = sensor.size_px.map(|px| px / bin);
        let (width, height) = part.map_or((width, height), |(wide, high)| (width.min(wide), height.min(high)));
        f64::from(width) * f64::from(height) * sensor.bytes_per_px
    }

    /// The position of a row's place now, if it is known.
    pub fn place(&mut self, place: &Place) -> Result<Icrs, Halt> {
        let observer = self.observer(self.now)?;
        match place {
            Place::Icrs(place) => place.checked().map_err(failed),
            Place::Horizontal(direction) => Ok(observer.to_icrs(direction)),
            Place::Moving(body) => body.seen(&observer).map(|seen| seen.icrs).map_err(failed),
        }
    }
}

fn failed(why: impl std::fmt::Display) -> Halt {
    Halt::Failed(why.to_string())
}
