//! Guiding: holds a row's field where its reference frame saw it, with guide pulses, as long as the row exposes.
//!
//! ```text
//!   frame fetched --> reference and calibration known? --no--> learned from this frame, or a person is informed
//!                          | yes
//!                     measured (boxes, else star list) --> decided (imaging::guide) --> pulses, record, state
//!                                                              '--lost--> star list; slew back; plate solution; alarm
//! ```
//! A task per row works on the newest frame of the camera that is guided on ([`task`]); frames that began before a slew
//! are left out. Nothing waits for the archive. The learned state survives a restart ([`learnt`]): where a field's
//! stars were, by object, filter, exposure, camera and side of the pier, and what pulses do ([`calibrated`]). A pulse
//! is given only to a mount that is known to track, not to slew, under a sky that the row may use ([`pulse`]).
//!
//! The row that guides holds a [`Guided`]; dropping it ends the loop. A pulse that runs then ends by itself.

pub mod calibrated;
mod guide_camera;
pub mod learnt;
pub mod line;
pub mod pulse;
mod recovery;
mod session;
mod task;
mod tell;

use std::sync::Arc;

use contract::Name;
use contract::observatory::{AlertKind, GuidingState};
use tokio::sync::watch;
use tokio::task::JoinHandle;

pub use self::recovery::guide_rates;
use crate::action::Stage;
use crate::control_room::ControlRoom;
use crate::trouble::Trouble;

/// What is to be guided on.
#[derive(Debug, Clone, PartialEq)]
pub struct Wanted {
    /// OBJECT.
    pub object: String,
    /// Exposure of the row's frames, s.
    pub exposure_s: f64,
    /// Target, ICRS degrees.
    pub target_deg: Option<[f64; 2]>,
    /// A reference that another row left is forgotten.
    pub reset_reference: bool,
}

/// A loop that guides until this is dropped.
pub struct Guided {
    room: Arc<ControlRoom>,
    task: JoinHandle<()>,
    camera: Name,
    given_up: watch::Receiver<Option<Trouble>>,
}

/// Begins to guide a row.
///
/// # Errors
/// [`Trouble::Impossible`] when there is no mount, or it takes no guide pulses.
pub async fn begin(stage: &Stage, wanted: Wanted) -> Result<Guided, Trouble> {
    let (room, config) = (stage.room.clone(), &stage.room.node.config.guiding);
    let mount = stage.chain()?.mount;
    let mount = mount.ok_or_else(|| Trouble::Impossible(format!("guiding: {} has no mount", stage.row.camera)))?;
    if !mount.instrument.capabilities().await?.pulse_guide {
        let name = &mount.instrument.device.name;
        return Err(Trouble::Impossible(format!(
            "guiding: {name} takes no guide pulses (CanPulseGuide is false); leave out guiding in this row"
        )));
    }
    let own = config.camera.clone().filter(|camera| *camera != stage.row.camera);
    let camera = own.clone().unwrap_or_else(|| stage.row.camera.clone());
    room.rig.chain(&camera)?;
    let (give_up, given_up) = watch::channel(None);
    let task = task::Loop::new(stage, wanted.clone(), camera.clone(), give_up);
    room.guiding.send_modify(|state| {
        *state = GuidingState {
            active: true,
            detail: "waiting for a first frame".to_owned(),
            camera: Some(camera.to_string()),
            object: Some(wanted.object.clone()),
            calibrations: std::mem::take(&mut state.calibrations),
            ..GuidingState::default()
        };
    });
    let (beside, row, index) = (room.clone(), stage.row.clone(), stage.index);
    let task = tokio::spawn(async move {
        match own {
            Some(camera) => {
                let exposing = guide_camera::keep_exposing(beside, row, index, wanted, camera);
                tokio::join!(task.run(), exposing);
            }
            None => task.run().await,
        }
    });
    Ok(Guided { room, task, camera, given_up })
}

impl Guided {
    /// Waits until guiding is given up and the row is to stop for it; for ever where frames go on unguided.
    pub async fn given_up(&self) -> Trouble {
        let mut given_up = self.given_up.clone();
        let trouble = match given_up.wait_for(Option::is_some).await {
            Ok(given_up) => given_up.as_ref().map(told_again),
            Err(_) => None,
        };
        match trouble {
            Some(trouble) => trouble,
            None => std::future::pending().await,
        }
    }

    /// How it went, in words.
    pub fn told(&self) -> String {
        let state = self.room.guiding.borrow();
        match (state.frames.unwrap_or(0), state.rms_px) {
            (0, _) => "not guided: no frame could be guided on".to_owned(),
            (frames, None) => format!("guided on {frames} frames; the field was never held"),
            (frames, Some(rms_px)) => format!("guided on {frames} frames, at the end to {rms_px:.2} px rms"),
        }
    }
}

impl Drop for Guided {
    fn drop(&mut self) {
        self.task.abort();
        let alerts = &self.room.node.alerts;
        // A row that stopped for it is to be seen: the alert ends with the next field that is held.
        if self.given_up.borrow().is_none() {
            alerts.clear(AlertKind::GuidingLost, &self.camera);
        }
        alerts.clear(AlertKind::FieldTurns, &self.camera);
        self.room.guiding.send_modify(|state| {
            state.active = false;
            state.detail = String::new();
        });
    }
}

/// A copy of an error, to report it a second time.
fn told_again(trouble: &Trouble) -> Trouble {
    match trouble {
        Trouble::Failed { device, verb, reason } => {
            Trouble::Failed { device: device.clone(), verb: verb.clone(), reason: reason.clone() }
        }
        other => Trouble::Impossible(other.to_string()),
    }
}
