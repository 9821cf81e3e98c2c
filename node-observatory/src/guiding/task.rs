//! The guide loop: one frame after the other, the newest first.

use std::sync::Arc;
use std::time::Duration;

use bus::MachineTime;
use config::{Guiding, WhenLost};
use contract::device::telescope::PierSide;
use contract::observatory::{
    AlertKind, Correction, GuideCalibration, GuideField, GuideReference, GuideStage, GuidingState,
};
use contract::{CommandId, Link, Name};
use imaging::guide::{Ask, Decision, State};
use schedule::Row;
use tokio::sync::watch;
use units::{Utc, seconds};

use super::learned;
use super::newest::newest;
use super::publish::{self, Residuals};
use super::pulse::{self, Given, Refused};
use super::session::{LISTED_WITHIN, NoSession, Session};
use super::{GuidingData, Wanted, calibrated, recovery};
use crate::action_error::ActionError;
use crate::command_timeout::command_timeout;
use crate::devices::telescope::Mount;
use crate::frames::looked::{Fetched, Looked};
use crate::frames::measure::shows_stars;
use crate::row_context::{RowContext, RowTools};

/// After so many frames in a row that could not be guided on, or that the mount took no pulse after, an alert is
/// raised.
const FAILURES_BEFORE_ALERT: u32 = 3;
/// Without a frame for so many exposures and this long, sky s, an alert is raised.
const SILENT_EXPOSURES: f64 = 3.0;
const SILENT_S: f64 = 180.0;
/// A frame that is so much older than the last one shows that a clock was set back, sky s.
const SET_BACK_S: f64 = 600.0;
/// How often that is checked if the mount reports nothing, sky time.
const LOOKED_AFTER: Duration = Duration::from_secs(30);

/// The loop of one row.
pub struct Loop {
    tools: Arc<RowTools>,
    guiding: Arc<GuidingData>,
    row: Row,
    index: u32,
    wanted: Wanted,
    camera: Name,
    give_up: watch::Sender<Option<ActionError>>,
    /// The newest frame that was guided on, or passed over, and when it began.
    seen: watch::Sender<Option<(Utc, CommandId)>>,
    session: Option<Session>,
    residuals: Residuals,
    /// Frames that began before this saw another field: before the loop, or before a slew ended.
    since: Utc,
    slews: bool,
    /// When the last frame to be guided on came.
    received: MachineTime,
    /// Middle of the last frame that was guided on.
    last_mid: Option<Utc>,
    /// Nothing is tried until then, after guiding was given up.
    rests_until: Option<Utc>,
    frames: u32,
    corrected: u32,
    failures: u32,
    refusals: u32,
}

impl Loop {
    /// A loop that has seen nothing yet.
    pub fn new(
        context: &RowContext,
        guiding: Arc<GuidingData>,
        wanted: Wanted,
        camera: Name,
        give_up: watch::Sender<Option<ActionError>>,
        seen: watch::Sender<Option<(Utc, CommandId)>>,
    ) -> Self {
        Self {
            tools: context.tools.clone(),
            guiding,
            row: context.row.clone(),
            index: context.index,
            wanted,
            camera,
            give_up,
            seen,
            session: None,
            residuals: Residuals::default(),
            since: context.clock().utc(),
            slews: false,
            received: context.clock().machine(),
            last_mid: None,
            rests_until: None,
            frames: 0,
            corrected: 0,
            failures: 0,
            refusals: 0,
        }
    }

    /// Guides until it is dropped.
    pub async fn run(mut self) {
        let tools = self.tools.clone();
        // `begin` has found it, and the configuration does not change.
        let Ok(Some(mount)) = tools.devices.chain(&self.row.camera).map(|chain| chain.mount) else { return };
        let (mut pixels, mut states) = (tools.frames.looks.follow_pixels(), mount.instrument.follow());
        let silent_s = SILENT_S + SILENT_EXPOSURES * self.exposure_s();
        // Under a fast sky frames take as long to be fetched and measured as ever.
        let silent = command_timeout(tools.authority.node.bus.clock(), seconds(silent_s));
        loop {
            let clock = tools.authority.node.bus.clock();
            tokio::select! {
                fetched = newest(&mut pixels, self.camera.as_str()) => {
                    let frame = (fetched.frame.started_utc, fetched.frame.id.clone());
                    self.take(mount, fetched).await;
                    self.note_seen(frame);
                }
                () = states.changed() => {
                    let received = states.get().filter(|received| received.sample.body.link == Link::Connected);
                    let slews = received.and_then(|received| received.sample.body.fields.slewing.known().copied());
                    self.note_slew(slews == Some(true), clock.utc());
                }
                () = clock.sleep_sky(LOOKED_AFTER) => {}
            }
            if clock.machine().since(self.received) > silent && self.rests_until.is_none() {
                self.complain(&format!("no frame of {} could be guided on for {silent_s:.0} s", self.camera));
            }
        }
    }

    fn note_seen(&self, frame: (Utc, CommandId)) {
        // One that was fetched late changes nothing.
        self.seen.send_if_modified(|seen| {
            let is_newer = seen.as_ref().is_none_or(|(began, _)| *began <= frame.0);
            if is_newer {
                *seen = Some(frame);
            }
            is_newer
        });
    }

    fn config(&self) -> &Guiding {
        &self.tools.authority.node.config.guiding
    }

    /// Exposure as the row, or the configuration of a camera of its own, asks for it, s.
    fn exposure_s(&self) -> f64 {
        if self.camera == self.row.camera { self.wanted.exposure_s } else { self.config().exposure_s }
    }

    /// After a slew the field is elsewhere; frames that saw it are left out.
    fn note_slew(&mut self, slews: bool, now: Utc) {
        if slews || self.slews {
            self.since = now;
        }
        if self.slews
            && !slews
            && let Some(session) = &mut self.session
        {
            session.guider.moved();
        }
        self.slews = slews;
    }

    /// Takes a frame, if it is one to be guided on.
    async fn take(&mut self, mount: &Mount, fetched: Arc<Fetched>) {
        let frame = &fetched.frame;
        let mid = frame.started_utc.plus_seconds(0.5 * frame.exposure_s);
        // Frames of a focus run between those of the row show other stars, or the same at another width.
        let is_of_row = frame.purpose.action == self.row.action.name() || self.camera != self.row.camera;
        let is_ours = frame.purpose.row == Some(self.index) && is_of_row && shows_stars(&frame.purpose.image_type);
        let is_due = self.last_mid.is_none_or(|last| {
            let after_s = mid.seconds_since(last);
            // One that was fetched late is passed over; a clock that was set back is the guider's to notice.
            (after_s > 0.0 && after_s >= self.config().interval_min_s) || after_s < -SET_BACK_S
        });
        let rests = self.rests_until.is_some_and(|until| mid < until);
        if !is_ours || !is_due || rests || self.slews || frame.started_utc < self.since {
            return;
        }
        (self.rests_until, self.received) = (None, self.tools.authority.node.bus.clock().machine());
        let side = mount.instrument.fresh().and_then(|state| state.fields.pier_side.known().copied());
        let field = self.field(&fetched, side.filter(|side| *side != PierSide::Unknown));
        if self.session.as_ref().is_some_and(|session| session.field != field) {
            tracing::info!(object = field.object, side = ?field.pier_side, "the field is another one for guiding: begins anew");
            self.session = None;
        }
        if self.session.is_none() {
            match self.meet(mount, &fetched, field).await {
                Ok(session) => (self.session, self.residuals) = (Some(session), Residuals::default()),
                Err(why) => {
                    self.failures += 1;
                    self.guiding.state.send_modify(|state| state.detail = why.clone());
                    if self.failures >= FAILURES_BEFORE_ALERT {
                        self.complain(&why);
                    }
                    return;
                }
            }
            self.failures = 0;
        }
        self.last_mid = Some(mid);
        self.guide(mount, &fetched).await;
    }

    fn field(&self, fetched: &Fetched, pier_side: Option<PierSide>) -> GuideField {
        let frame = &fetched.frame;
        GuideField {
            object: self.wanted.object.clone(),
            filter: frame.purpose.filter.clone(),
            exposure_s: self.exposure_s(),
            camera: frame.camera.clone(),
            pier_side,
            bin: frame.bin,
            size_px: [frame.width_px, frame.height_px],
            origin_px: frame.origin_px,
        }
    }

    /// Begins to hold a field: where it was before, or where this frame shows it.
    async fn meet(&mut self, mount: &Mount, fetched: &Arc<Fetched>, field: GuideField) -> Result<Session, String> {
        let frame = &fetched.frame;
        let looked = tokio::time::timeout(LISTED_WITHIN, self.tools.frames.looks.of(&frame.id)).await;
        let looked = looked.map_err(|_| format!("frame {} was not measured in time", frame.id))?;
        self.learn_from_solution(mount, &looked, &field);
        let known = self.guiding.learned.get();
        let reversed = self.config().dec_reversed_after_flip;
        let learned = known.calibration(&field.camera, field.pier_side, reversed);
        let calibration = learned.or_else(|| self.configured(&field)).ok_or_else(|| {
            format!(
                "nobody knows what pulses do to the stars of {}: run calibrate_guiding, or see that frames are solved \
                 and the mount reports its guide rates",
                field.camera
            )
        })?;
        let dec_deg = self.declination_deg(mount, &looked).ok_or("the declination is not known")?;
        let is_left = |stored: &&GuideReference| !self.wanted.reset_reference || stored.row == self.row.id.0;
        let held = match known.reference(&field).filter(is_left) {
            Some(stored) => {
                let stars = stored.stars.iter().map(learned::star).collect();
                let from = (stored.frame.clone(), stored.centre_deg);
                Session::new(self.config(), field, from, stars, calibration, dec_deg)
            }
            None => self.begin_reference(fetched, &looked, field, calibration, dec_deg),
        };
        let session = held.map_err(|why| why.to_string())?;
        let (object, stars) = (&session.field.object, session.stars().len());
        tracing::info!(object, stars, reference = %session.reference_frame, source = ?session.calibration.source, "guiding");
        Ok(session)
    }

    /// What pulses do, by the configuration, to the stars of a field's camera.
    fn configured(&self, field: &GuideField) -> Option<GuideCalibration> {
        let mut cameras = self.tools.authority.node.config.camera.iter();
        let start = cameras.find(|camera| camera.common.name.as_str() == field.camera)?.guide_calibration?;
        calibrated::configured(&start, field.pier_side, self.config().dec_reversed_after_flip)
    }

    /// Makes a frame the reference of its field, on disk soon.
    fn begin_reference(
        &self,
        fetched: &Fetched,
        looked: &Looked,
        field: GuideField,
        calibration: GuideCalibration,
        dec_deg: f64,
    ) -> Result<Session, NoSession> {
        let stars = looked.measured.as_ref().map(|measured| measured.stars.clone()).unwrap_or_default();
        let solution = looked.solved.as_ref().and_then(|solved| solved.as_ref().ok());
        let centre_deg = solution.map(|solution| [solution.ra.degrees(), solution.dec.degrees()]);
        let from = (fetched.frame.id.clone(), centre_deg);
        let session = Session::new(self.config(), field, from, stars, calibration, dec_deg)?.with_profiles(fetched);
        let reference = GuideReference {
            field: session.field.clone(),
            frame: fetched.frame.id.clone(),
            made_utc: fetched.frame.started_utc,
            row: self.row.id.0.clone(),
            centre_deg,
            stars: session.stars().iter().map(learned::stored).collect(),
        };
        self.guiding.learned.change(|learned| {
            learned.keep_reference(reference);
            true
        });
        Ok(session)
    }

    /// Learns from a solved frame what pulses do, if the mount reports how fast they are.
    fn learn_from_solution(&self, mount: &Mount, looked: &Looked, field: &GuideField) {
        let Some(Ok(solution)) = &looked.solved else { return };
        let Some(rates) = mount.instrument.can().as_ref().and_then(recovery::guide_rates) else { return };
        let (cd, now) = (solution.wcs.cd_deg_px, self.tools.authority.node.bus.clock().utc());
        match calibrated::of_solution(cd, rates, field.bin, field.pier_side, now) {
            Ok(made) => self.guiding.learned.change(|learned| {
                let made = calibrated::as_the_motor_turns(made, self.config().dec_reversed_after_flip);
                learned.keep_calibration(&field.camera, made);
                true
            }),
            Err(error) => tracing::warn!(%error, "a plate solution does not show what guide pulses do"),
        }
    }

    fn declination_deg(&self, mount: &Mount, looked: &Looked) -> Option<f64> {
        let solved = looked.solved.as_ref().and_then(|solved| solved.as_ref().ok()).map(|s| s.dec.degrees());
        let of_mount = || mount.instrument.fresh().and_then(|state| state.fields.dec_deg.known().copied());
        solved.or_else(|| self.wanted.target_deg.map(|[_, dec]| dec)).or_else(of_mount).filter(|dec| dec.is_finite())
    }

    /// Measures, decides, sends pulses to the mount, and publishes the correction.
    async fn guide(&mut self, mount: &Mount, fetched: &Arc<Fetched>) {
        let tools = self.tools.clone();
        let Some(session) = &mut self.session else { return };
        let seen = session.look(&tools.frames.looks, fetched).await;
        let shift = seen.measured.as_ref().map(|measured| &measured.shift);
        let decision = session.guider.step(Session::exposure(fetched), shift);
        if let (State::Guide, Ok(shift)) = (decision.state, shift) {
            self.residuals.note(shift.dx_px.hypot(shift.dy_px));
        }
        let given = pulse::give(&tools.authority, &self.row, mount, decision.pulses).await;
        session.guider.report([given.east, given.north]);
        let record = publish::correction(&fetched.frame, session, &seen, &decision, &given, self.residuals.rms_px());
        self.frames += 1;
        let is_given = [given.east, given.north].iter().flatten().any(|(_, ms)| *ms != 0);
        self.corrected += u32::from(is_given);
        self.refusals = given.refusals(self.refusals);
        let further_action = self.follow_up(mount, fetched, &decision).await;
        self.judge(&decision, &given);
        let record = Correction { further_action, ..record };
        self.show(&record);
        publish::publish(&tools.authority.node, &self.guiding.corrections, record).await;
    }

    /// Does what the guider asks for in addition to pulses; returns a description of it.
    async fn follow_up(&mut self, mount: &Mount, fetched: &Fetched, decision: &Decision) -> Option<String> {
        match decision.ask? {
            Ask::Register => Some("looking for the field in the whole next frame".to_owned()),
            Ask::Recentre { dx_px, dy_px } => {
                let offset = self.offset_deg(mount, [dx_px, dy_px]);
                Some(self.slew(mount, offset).await)
            }
            Ask::PlateSolve => {
                let looked = tokio::time::timeout(LISTED_WITHIN, self.tools.frames.looks.of(&fetched.frame.id)).await;
                let offset = match (looked.as_ref().map(|looked| &looked.solved), &self.session) {
                    (Ok(Some(Ok(solution))), Some(session)) => recovery::offset_to_reference_deg(session, solution),
                    (Ok(Some(Err(why))), _) => Err(format!("the frame is not solved: {why}")),
                    _ => Err("nobody solves the frame".to_owned()),
                };
                Some(self.slew(mount, offset).await)
            }
            Ask::Alarm => {
                let why = format!("{} is lost: {}", self.wanted.object, alarm(decision));
                self.complain(&why);
                if decision.state == State::Stopped {
                    self.stop(mount, &why);
                }
                Some(why)
            }
        }
    }

    fn offset_deg(&self, mount: &Mount, way_px: [f64; 2]) -> Result<[f64; 2], String> {
        let session = self.session.as_ref().ok_or("no field is held")?;
        let rates = mount.instrument.can().as_ref().and_then(recovery::guide_rates);
        recovery::offset_deg(session, rates.ok_or("the mount does not report its guide rates")?, way_px)
    }

    /// Slews by an offset. An obstacle is reported in the result, and the next frame asks again.
    async fn slew(&mut self, mount: &Mount, offset: Result<[f64; 2], String>) -> String {
        let slewed = match offset {
            Ok(offset) => recovery::slew_by(&self.tools.authority, &self.row, mount, offset).await.map(|()| offset),
            Err(why) => Err(why.into()),
        };
        match slewed {
            Ok([ra, dec]) => {
                self.since = self.tools.authority.node.bus.clock().utc();
                if let Some(session) = &mut self.session {
                    session.guider.moved();
                }
                let report = format!(
                    "slewed back by {:.1}, {:.1} arcsec in right ascension, declination",
                    3600.0 * ra,
                    3600.0 * dec
                );
                tracing::warn!(object = self.wanted.object, report, "the field was lost");
                report
            }
            Err(Refused { why, by_mount }) => {
                let report = format!("not slewed back: {why}");
                tracing::warn!(object = self.wanted.object, report, "the field is lost");
                if by_mount {
                    self.complain(&report);
                }
                report
            }
        }
    }

    /// Guiding has come to its end: the row goes on without, and it is tried again later; or the row stops.
    fn stop(&mut self, mount: &Mount, why: &str) {
        self.session = None;
        self.rests_until = Some(self.tools.authority.node.bus.clock().utc().plus_seconds(self.config().alert_after_s));
        if self.config().when_lost == WhenLost::Stop {
            let (device, reason) = (mount.instrument.device.to_string(), why.to_owned());
            self.give_up.send_replace(Some(ActionError::Failed { device, verb: "be guided".to_owned(), reason }));
        }
    }

    /// Raises or clears the alerts that depend on this frame.
    fn judge(&self, decision: &Decision, given: &Given) {
        let (alerts, camera) = (&self.tools.authority.node.alerts, &self.camera);
        if self.refusals >= FAILURES_BEFORE_ALERT {
            let why = given.refused.as_ref().map(|refused| refused.why.as_str()).unwrap_or_default();
            self.complain(&format!("the mount took no pulse after {} frames in a row; the last: {why}", self.refusals));
        } else if self.session.as_ref().is_some_and(|session| session.repeats >= FAILURES_BEFORE_ALERT) {
            self.complain(&format!("{camera} repeats its last frame, pixel by pixel: nothing is seen of the sky"));
        } else if let Some(unstable) = decision.log.unstable {
            self.complain(publish::unstable(unstable));
        } else if matches!(decision.state, State::Stabilise | State::Guide) && self.refusals == 0 {
            alerts.clear(AlertKind::GuidingLost, camera);
        }
        match decision.log.rotation_deg_h {
            Some((rate, error)) if decision.log.rotates => {
                let cause = format!("the field of {camera} turns by {rate:.2} +- {error:.2} deg/h");
                alerts.raise(AlertKind::FieldTurns, camera, &cause);
            }
            _ => alerts.clear(AlertKind::FieldTurns, camera),
        }
    }

    fn complain(&self, why: &str) {
        self.tools.authority.node.alerts.raise(AlertKind::GuidingLost, &self.camera, why);
    }

    fn show(&self, record: &Correction) {
        let object = &self.wanted.object;
        let rms = self.residuals.rms_px();
        let detail = match (record.stage, &record.further_action, rms) {
            (_, Some(further_action), _) => further_action.clone(),
            (GuideStage::Guide, None, Some(rms)) => {
                let (stars, frames) = (record.stars, self.residuals.count());
                format!("guiding {object} on {stars} stars, rms {rms:.2} px over {frames} frames")
            }
            (stage, None, _) => match &record.reason {
                Some(reason) => format!("{}: {reason}", publish::word(stage)),
                None => format!("{} {object}", publish::word(stage)),
            },
        };
        self.guiding.state.send_modify(|state| {
            *state = GuidingState {
                active: true,
                detail,
                stage: Some(record.stage),
                camera: Some(self.camera.to_string()),
                object: Some(object.clone()),
                reference: Some(record.reference.clone()),
                calibration: self.session.as_ref().map(|session| session.calibration.clone()),
                rms_px: rms,
                frames: Some(self.frames),
                corrected: Some(self.corrected),
                last: Some(record.clone()),
                calibrations: std::mem::take(&mut state.calibrations),
            };
        });
    }
}

fn alarm(decision: &Decision) -> &'static str {
    match decision.state {
        State::Stopped => "the stars of the newest frames are not those of the reference",
        State::Acquire | State::Stabilise | State::Guide | State::Lost => "no stars are seen",
    }
}
