//! The context of a row at work: its devices, and the building blocks that actions share.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use bus::Clock;
use contract::device::telescope::Command;
use contract::observatory::{AlertKind, RowState};
use contract::{CommandId, Kind, Name};
use schedule::action::parameters::FocusWanted;
use schedule::plan::overheads::{TOOK, TimedPart};
use schedule::{Row, RowId};
use sky::{Icrs, NightDate, Observer};
use units::{Angle, Utc};

use crate::action_error::ActionError;
use crate::authority::Authority;
use crate::devices::{Chain, Devices};
use crate::expected::{Lasts, StepTimes};
use crate::frames::FrameData;
use crate::journal::Journal;
use crate::ledger::Ledger;
use crate::night::PublishedNight;
use crate::slit::Slits;
use crate::took::took_s;

/// A sensor that needs less was cold, s.
const COOLED_S: f64 = 10.0;

/// What every row works with.
pub struct RowTools {
    /// Whether this node may act.
    pub authority: Arc<Authority>,
    /// The devices.
    pub devices: Arc<Devices>,
    /// The slits of the domes.
    pub slits: Arc<Slits>,
    /// The record on disk of all that was begun and finished.
    pub journal: Arc<Journal>,
    /// The published state of the night.
    pub night: Arc<PublishedNight>,
    /// Frames announced and stored.
    pub ledger: Arc<Ledger>,
    /// What frames have shown.
    pub frames: Arc<FrameData>,
    /// How long steps take.
    pub step_times: Arc<StepTimes>,
}

/// How a panel was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FoundPanel {
    /// Its cover was open.
    pub was_open: bool,
}

/// The context of one row.
pub struct RowContext {
    /// What every row works with.
    pub tools: Arc<RowTools>,
    /// The row.
    pub row: Row,
    /// Its place in the schedule.
    pub index: u32,
    exposing: Mutex<Option<CommandId>>,
    last: Mutex<Option<CommandId>>,
    focus_before: Mutex<Option<i64>>,
    following: AtomicBool,
    panel: Mutex<Option<FoundPanel>>,
    leaves_mount: AtomicBool,
}

impl RowContext {
    /// The context of a row that begins.
    pub fn new(tools: Arc<RowTools>, row: Row, index: u32) -> Self {
        let (exposing, last, focus_before) = (Mutex::new(None), Mutex::new(None), Mutex::new(None));
        let (following, panel) = (AtomicBool::new(false), Mutex::new(None));
        let leaves_mount = AtomicBool::new(false);
        Self { tools, row, index, exposing, last, focus_before, following, panel, leaves_mount }
    }

    /// The action needs its mount no longer: it is to rest when the row has ended, however that goes.
    pub fn leave_mount(&self) {
        self.leaves_mount.store(true, Ordering::Relaxed);
    }

    /// The mount of a row that is finished does not go on following a target that nobody observes. What it does cannot
    /// change the end of the row any more; an alert is active while it tracks on.
    pub async fn rest_mount(&self) {
        if !self.leaves_mount.swap(false, Ordering::Relaxed) {
            return;
        }
        let Some(mount) = self.chain().ok().and_then(|chain| chain.mount) else { return };
        let (alerts, name) = (&self.tools.authority.node.alerts, &mount.instrument.device.name);
        match mount.rest().await {
            Ok(()) => alerts.clear(AlertKind::MountTracksOn, name),
            // Whether it tracks is not known, and other alerts say that it is away.
            Err(why) if mount.instrument.fresh().is_none() => tracing::warn!(row = self.told(), why),
            Err(why) => {
                tracing::warn!(row = self.told(), why, "the row is finished all the same");
                alerts.raise(AlertKind::MountTracksOn, name, &why);
            }
        }
    }

    /// The devices that work with the row's camera.
    pub fn chain(&self) -> Result<Chain<'_>, ActionError> {
        self.tools.devices.chain(&self.row.camera)
    }

    /// Its number in the diary, where the first row is 1.
    fn told(&self) -> u32 {
        RowState::told(self.index)
    }

    /// The clock.
    pub fn clock(&self) -> &Clock {
        self.tools.authority.node.bus.clock()
    }

    /// Reports what the row does now, and how long that lasts.
    pub fn step(&self, step: impl Into<String>, lasts: impl Into<Lasts>) {
        let step = step.into();
        tracing::info!(row = self.told(), action = self.row.action.name(), step, "step");
        self.small_step(step, lasts);
    }

    /// As [`Self::step`], without a line in the diary: for what repeats with every frame.
    pub fn small_step(&self, step: String, lasts: impl Into<Lasts>) {
        let expected_by = self.tools.step_times.expected_by(lasts.into(), self.row.action.name(), self.clock());
        self.tools.night.step(self.index, step, expected_by);
    }

    /// Writes into the diary how long a part of the row took, for the plans of later nights.
    pub fn took(&self, span: TimedPart, began: Utc) {
        let took_s = took_s(self.clock(), began);
        tracing::info!(row = self.told(), span = span.word(), took_s, "{TOOK}");
    }

    /// Remembers that a frame is under way, so that it can be stopped when the action is dropped.
    pub fn set_exposing(&self, frame: Option<CommandId>) {
        if frame.is_some() {
            self.last.lock().unwrap_or_else(PoisonError::into_inner).clone_from(&frame);
        }
        *self.exposing.lock().unwrap_or_else(PoisonError::into_inner) = frame;
    }

    /// Is a frame under way?
    pub fn is_exposing(&self) -> bool {
        self.exposing.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    /// The frame that was begun last.
    pub fn last_frame(&self) -> Option<CommandId> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Remembers where the focuser was before a run, so that it goes back there when the action is dropped.
    pub fn set_focus_before(&self, position: Option<i64>) {
        *self.focus_before.lock().unwrap_or_else(PoisonError::into_inner) = position;
    }

    /// Remembers that the mount goes along with a moving target, so that it is called back when the action is dropped.
    pub fn set_following(&self, is_following: bool) {
        self.following.store(is_following, Ordering::Relaxed);
    }

    /// Remembers how a panel was found, so that it is left so when the action is dropped.
    pub fn set_panel(&self, found: Option<FoundPanel>) {
        *self.panel.lock().unwrap_or_else(PoisonError::into_inner) = found;
    }

    /// How a panel was found that is in use; once.
    pub fn take_panel(&self) -> Option<FoundPanel> {
        self.panel.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Brings the focuser back to where it was before a run that did not end.
    pub async fn restore_focus(&self) {
        let position = self.focus_before.lock().unwrap_or_else(PoisonError::into_inner).take();
        let focuser = self.chain().ok().and_then(|chain| chain.focuser);
        if let Some((position, focuser)) = position.zip(focuser)
            && let Err(error) = focuser.send(position).await
        {
            tracing::warn!(%error, position, "the focuser did not go back to where it stood before the run");
        }
    }

    /// The mount follows the stars again. One that is parked or closing meanwhile is left to that: its device node ends
    /// the rates too.
    pub async fn stop_following(&self) {
        if !self.following.swap(false, Ordering::Relaxed) {
            return;
        }
        let Some(mount) = self.chain().ok().and_then(|chain| chain.mount) else { return };
        let rates = Command::Rates { ra_s_per_sidereal_s: 0.0, dec_arcsec_per_s: 0.0 };
        if let Err(error) = mount.instrument.ask(rates).await {
            tracing::warn!(%error, "the mount may still go along with the moving target, until it parks or slews");
        }
    }

    /// Stops a frame that is under way.
    pub async fn stop_exposing(&self) {
        let exposing = self.exposing.lock().unwrap_or_else(PoisonError::into_inner).take();
        if exposing.is_none() {
            return;
        }
        let Ok(chain) = self.chain() else { return };
        if let Err(error) = chain.camera.abort().await {
            tracing::warn!(%error, "the exposure was not aborted; it ends by itself");
        }
    }

    /// Writes to the journal, on a thread that may wait for the disk.
    pub async fn write<T: Send + 'static>(
        &self,
        write: impl FnOnce(&Journal, &RowId, Utc) -> io::Result<T> + Send + 'static,
    ) -> io::Result<T> {
        let (journal, clock, row) = (self.tools.journal.clone(), self.clock().clone(), self.row.id.clone());
        let written = tokio::task::spawn_blocking(move || write(&journal, &row, clock.utc()));
        written.await.map_err(io::Error::other)?
    }

    /// The date that the row's night is filed under.
    pub fn night(&self) -> NightDate {
        sky::night_date(Angle::from_degrees(self.tools.authority.node.config.place.longitude_deg), self.row.start)
    }

    /// The sky over this site at an instant.
    pub fn observer(&self, at: Utc) -> Result<Observer, ActionError> {
        Ok(self.tools.authority.observer(at)?)
    }

    /// The sky now, if the target is in what the site leaves of it to the row's mount.
    ///
    /// # Errors
    /// [`ActionError::Hidden`] where it will be there later in the row's window, else [`ActionError::Impossible`].
    pub fn visible(&self, target: &Icrs) -> Result<Observer, ActionError> {
        let now = self.clock().utc();
        let observer = self.observer(now)?;
        let mount = self.chain()?.mount;
        let horizon_limits = mount.map(|mount| mount.horizon_limits.clone()).unwrap_or_default();
        let Some(why) = horizon_limits.hides(target, &observer) else { return Ok(observer) };
        let clear = horizon_limits.clear_from(target, now, self.row.end, |at| self.observer(at).ok());
        Err(match clear {
            Some(clear) => ActionError::Hidden { why, clear },
            None => ActionError::Impossible(why),
        })
    }

    /// Brings the wanted filter into the beam and the focuser to where it belongs.
    pub async fn filter_and_focus(&self, filter: Option<&str>, focus: FocusWanted) -> Result<(), ActionError> {
        let chain = self.chain()?;
        let (began, before) = (self.clock().utc(), chain.wheel.and_then(|wheel| wheel.filter()));
        let done = self.filter_and_focus_of(&chain, filter, focus).await;
        if done.is_ok() && filter.is_some_and(|filter| before.is_some_and(|before| before != filter)) {
            self.took(TimedPart::Filter, began);
        }
        done
    }

    async fn filter_and_focus_of(
        &self,
        chain: &Chain<'_>,
        filter: Option<&str>,
        focus: FocusWanted,
    ) -> Result<(), ActionError> {
        let filter_offset = match (filter, chain.wheel) {
            (None, _) => 0,
            (Some(filter), Some(wheel)) => {
                let offset = wheel.turn_to(filter).await?;
                chain.focuser.map_or(offset, |focuser| focuser.offset(filter, offset))
            }
            (Some(filter), None) => {
                let camera = &self.row.camera;
                return Err(ActionError::Impossible(format!("filter {filter:?}: {camera} has no filter wheel")));
            }
        };
        match chain.focuser {
            Some(focuser) => {
                let wanted = FocusWanted { filter_offset, ..focus };
                let is_left_to_us = !self.tools.authority.node.config.faults.is_chosen(Kind::Focuser);
                match focuser.focus(wanted).await {
                    Err(error) if error.kind().is_some() && is_left_to_us && focuser.may_stay(wanted) => {
                        tracing::warn!(%error, "the focus stays as it is: the row asks for nothing else");
                        Ok(())
                    }
                    done => self.tools.authority.or_without(done),
                }
            }
            None if focus.position.is_some() || focus.shift.is_some() => {
                Err(ActionError::Impossible(format!("{} has no focuser", self.row.camera)))
            }
            None => Ok(()),
        }
    }

    /// Runs the cooler and waits until the sensor is cold. An alert is active while a sensor does not get there.
    pub async fn cool(&self) -> Result<(), ActionError> {
        let camera = self.chain()?.camera;
        let (alerts, name) = (&self.tools.authority.node.alerts, &self.row.camera);
        camera.start_cooling().await?;
        let began = self.clock().utc();
        let cold = camera.wait_until_cold().await;
        if cold.is_ok() && self.clock().utc().seconds_since(began) > COOLED_S {
            self.took(TimedPart::Cool, began);
        }
        match &cold {
            Ok(()) => alerts.clear(AlertKind::CoolingFailed, name),
            Err(error) => alerts.raise(AlertKind::CoolingFailed, name, &error.to_string()),
        }
        cold
    }

    /// Configured names of the devices that belong to the row's camera, by ASCOM type.
    pub fn paired(&self) -> std::collections::BTreeMap<String, String> {
        let Ok(chain) = self.chain() else { return Default::default() };
        let camera = &chain.camera.config;
        let pairs: [(Kind, Option<&Name>); 10] = [
            (Kind::Camera, Some(&camera.common.name)),
            (Kind::Telescope, camera.telescope.as_ref()),
            (Kind::FilterWheel, camera.filterwheel.as_ref()),
            (Kind::Focuser, camera.focuser.as_ref()),
            (Kind::Dome, camera.dome.as_ref()),
            (Kind::Rotator, camera.rotator.as_ref()),
            (Kind::CoverCalibrator, camera.covercalibrator.as_ref()),
            (Kind::SafetyMonitor, camera.safetymonitor.as_ref()),
            (Kind::ObservingConditions, camera.observingconditions.as_ref()),
            (Kind::Switch, camera.switch.as_ref()),
        ];
        let named = pairs.into_iter().filter_map(|(kind, name)| Some((kind.ascom().to_owned(), name?.to_string())));
        named.collect()
    }
}
