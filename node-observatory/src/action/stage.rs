//! What an action works with: its row, the devices of its camera, and the building blocks that actions share.

use std::sync::{Arc, Mutex, PoisonError};

use bus::Clock;
use contract::observatory::AlertKind;
use contract::{CommandId, Name};
use sky::{NightDate, Observer};
use units::{Angle, Utc};

use crate::control_room::ControlRoom;
use crate::rig::Chain;
use crate::rig::focuser::Wanted;
use crate::schedule::Row;
use crate::trouble::Trouble;

/// The stage of one row.
pub struct Stage {
    /// What all tasks share.
    pub room: Arc<ControlRoom>,
    /// The row.
    pub row: Row,
    /// Its place in the schedule.
    pub index: u32,
    exposing: Mutex<Option<CommandId>>,
}

impl Stage {
    /// The stage for a row.
    pub fn new(room: Arc<ControlRoom>, row: Row, index: u32) -> Self {
        Self { room, row, index, exposing: Mutex::new(None) }
    }

    /// The devices that work with the row's camera.
    pub fn chain(&self) -> Result<Chain<'_>, Trouble> {
        self.room.rig.chain(&self.row.camera)
    }

    /// The clock.
    pub fn clock(&self) -> &Clock {
        self.room.node.bus.clock()
    }

    /// Tells what is done now.
    pub fn step(&self, step: impl Into<String>) {
        let step = step.into();
        tracing::info!(row = self.index, action = self.row.action.name(), step, "step");
        self.room.board.step(self.index, step);
    }

    /// As [`Self::step`], without a line in the diary: for what repeats with every frame.
    pub fn small_step(&self, step: String) {
        self.room.board.step(self.index, step);
    }

    /// Remembers that a frame is under way, so that it can be stopped when the action is dropped.
    pub fn set_exposing(&self, frame: Option<CommandId>) {
        *self.exposing.lock().unwrap_or_else(PoisonError::into_inner) = frame;
    }

    /// After the action was dropped: stops what it left running. Mount and roof are the closing's.
    pub async fn settle(&self) {
        let exposing = self.exposing.lock().unwrap_or_else(PoisonError::into_inner).take();
        if exposing.is_none() {
            return;
        }
        let Ok(chain) = self.chain() else { return };
        if let Err(trouble) = chain.camera.abort().await {
            tracing::warn!(%trouble, "the exposure was not aborted; it ends by itself");
        }
    }

    /// The date that the row's night is filed under.
    pub fn night(&self) -> NightDate {
        sky::night_date(Angle::from_degrees(self.room.node.config.place.longitude_deg), self.row.start)
    }

    /// The sky over this site at an instant.
    pub fn observer(&self, at: Utc) -> Result<Observer, Trouble> {
        Ok(self.room.observer(at)?)
    }

    /// Brings the wanted filter into the beam and the focuser to where it belongs.
    pub async fn filter_and_focus(&self, filter: Option<&str>, focus: Wanted) -> Result<(), Trouble> {
        let chain = self.chain()?;
        let filter_offset = match (filter, chain.wheel) {
            (None, _) => 0,
            (Some(filter), Some(wheel)) => wheel.turn_to(filter).await?,
            (Some(filter), None) => {
                let camera = &self.row.camera;
                return Err(Trouble::Impossible(format!("filter {filter:?}: {camera} has no filter wheel")));
            }
        };
        match chain.focuser {
            Some(focuser) => self.room.or_without(focuser.focus(Wanted { filter_offset, ..focus }).await),
            None if focus.position.is_some() || focus.shift.is_some() => {
                Err(Trouble::Impossible(format!("{} has no focuser", self.row.camera)))
            }
            None => Ok(()),
        }
    }

    /// Runs the cooler and waits until the sensor is cold; an alert stands while a sensor does not get there.
    pub async fn cool(&self) -> Result<(), Trouble> {
        let camera = self.chain()?.camera;
        let (alerts, name) = (&self.room.node.alerts, &self.row.camera);
        camera.start_cooling().await?;
        let cold = camera.wait_until_cold().await;
        match &cold {
            Ok(()) => alerts.clear(AlertKind::CoolingFailed, name),
            Err(trouble) => alerts.raise(AlertKind::CoolingFailed, name, &trouble.to_string()),
        }
        cold
    }

    /// Configured names of the devices that belong to the row's camera, by ASCOM type.
    pub fn paired(&self) -> std::collections::BTreeMap<String, String> {
        use contract::Kind;
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
