//! Guiding: holds a row's field where its reference frame saw it, with guide pulses, as long as the row exposes.
//!
//! ```text
//!   frame fetched --> reference and calibration known? --no--> learned from this frame, or a person is informed
//!                          | yes
//!                     measured (boxes, else star list) --> decided (imaging::guide) --> pulses, record, state
//!                                                              '--lost--> star list; slew back; plate solution; alarm
//! ```
//! A task per row works on the newest frame of the camera that is guided on ([`task`]); frames that began before a slew
//! are left out. Nothing waits for the archive. The learned state survives a restart ([`learned`]): where a field's
//! stars were, by object, filter, exposure, camera and side of the pier, and what pulses do ([`calibrated`]). A pulse
//! is given only to a mount that is known to track, not to slew, under a sky that the row may use ([`pulse`]).
//!
//! The row that guides holds a [`Guided`]; dropping it ends the loop. A pulse that runs then ends by itself.

pub mod calibrated;
mod guide_camera;
pub mod learned;
mod newest;
mod publish;
pub mod pulse;
mod recovery;
mod references;
mod session;
mod task;

use std::sync::Arc;
use std::time::Duration;

use bus::Publisher;
use contract::observatory::{AlertKind, Correction, GuidingState};
use contract::{CommandId, Name};
use node::Node;
use tokio::sync::{OnceCell, watch};
use tokio::task::JoinHandle;
use units::Utc;

use self::learned::LearnedGuiding;
pub use self::recovery::guide_rates;
use crate::action_error::ActionError;
use crate::authority::Authority;
use crate::replicated::Replicated;
use crate::row_context::RowContext;
use crate::tasks::Tasks;

/// A row's last frame is waited for no longer than this, machine time.
const LAST_FRAME: Duration = Duration::from_secs(15);

/// The state of guiding.
pub struct GuidingData {
    /// As it is published.
    pub state: watch::Sender<GuidingState>,
    /// What guiding has learned and stores.
    pub learned: Replicated<LearnedGuiding>,
    /// The publisher of the corrections.
    pub corrections: OnceCell<Publisher<Correction>>,
}

impl GuidingData {
    /// Reads what was learned before.
    pub async fn load(node: &Node) -> anyhow::Result<Self> {
        let learned = Replicated::load(node).await?;
        Ok(Self { state: watch::channel(GuidingState::default()).0, learned, corrections: OnceCell::new() })
    }
}

/// Starts the tasks about guiding.
pub fn start(tasks: &mut Tasks, authority: &Arc<Authority>, guiding: &Arc<GuidingData>) {
    guiding.learned.start(tasks, authority, guiding.state.clone());
    tasks.spawn("publish guide references", references::keep_publishing(authority.clone(), guiding.clone()));
    tasks.spawn("receive guide references", references::keep_receiving(authority.clone(), guiding.clone()));
}

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
    authority: Arc<Authority>,
    guiding: Arc<GuidingData>,
    task: JoinHandle<()>,
    camera: Name,
    given_up: watch::Receiver<Option<ActionError>>,
    seen: watch::Receiver<Option<(Utc, CommandId)>>,
    /// The row's last frame before guiding began.
    before: Option<CommandId>,
}

/// Begins to guide a row.
///
/// # Errors
/// [`ActionError::Impossible`] when there is no mount, or it takes no guide pulses.
pub async fn begin(context: &RowContext, guiding: &Arc<GuidingData>, wanted: Wanted) -> Result<Guided, ActionError> {
    let (tools, config) = (context.tools.clone(), &context.tools.authority.node.config.guiding);
    let mount = context.chain()?.mount;
    let mount =
        mount.ok_or_else(|| ActionError::Impossible(format!("guiding: {} has no mount", context.row.camera)))?;
    if !mount.instrument.capabilities().await?.pulse_guide {
        let name = &mount.instrument.device.name;
        return Err(ActionError::Impossible(format!(
            "guiding: {name} takes no guide pulses (CanPulseGuide is false); leave out guiding in this row"
        )));
    }
    let own = config.camera.clone().filter(|camera| *camera != context.row.camera);
    let camera = own.clone().unwrap_or_else(|| context.row.camera.clone());
    tools.devices.chain(&camera)?;
    let ((give_up, given_up), (see, seen)) = (watch::channel(None), watch::channel(None));
    let task = task::Loop::new(context, guiding.clone(), wanted.clone(), camera.clone(), give_up, see);
    guiding.state.send_modify(|state| {
        *state = GuidingState {
            active: true,
            detail: "waiting for a first frame".to_owned(),
            camera: Some(camera.to_string()),
            object: Some(wanted.object.clone()),
            calibrations: std::mem::take(&mut state.calibrations),
            ..GuidingState::default()
        };
    });
    let (own_tools, row, index) = (tools.clone(), context.row.clone(), context.index);
    let task = tokio::spawn(async move {
        match own {
            Some(camera) => {
                let exposing = guide_camera::keep_exposing(own_tools, row, index, wanted, camera);
                tokio::join!(task.run(), exposing);
            }
            None => task.run().await,
        }
    });
    let (authority, guiding, before) = (tools.authority.clone(), guiding.clone(), context.last_frame());
    Ok(Guided { authority, guiding, task, camera, given_up, seen, before })
}

impl Guided {
    /// Waits until guiding is given up and the row is to stop for it; for ever where frames go on unguided.
    pub async fn given_up(&self) -> ActionError {
        let mut given_up = self.given_up.clone();
        let error = match given_up.wait_for(Option::is_some).await {
            Ok(given_up) => given_up.as_ref().map(copied),
            Err(_) => None,
        };
        match error {
            Some(error) => error,
            None => std::future::pending().await,
        }
    }

    /// After a row's last frame: waits until it was guided on. A frame that is guided on itself is there only after its
    /// exposure, and would otherwise be the one of its row of which nobody knows how well the field was held.
    pub async fn settle(&self, context: &RowContext) {
        let last = context.last_frame().filter(|last| self.before.as_ref() != Some(last));
        let Some(last) = last.filter(|_| self.camera == context.row.camera) else { return };
        let mut seen = self.seen.clone();
        // One that cannot be fetched is never seen, and nothing depends on it.
        let is_last = |seen: &Option<(Utc, CommandId)>| seen.as_ref().is_some_and(|(_, frame)| *frame == last);
        let _ = tokio::time::timeout(LAST_FRAME, seen.wait_for(is_last)).await;
    }

    /// How it went, in words.
    pub fn summary(&self) -> String {
        let state = self.guiding.state.borrow();
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
        let alerts = &self.authority.node.alerts;
        // A row that stopped for it is to be seen: the alert ends with the next field that is held.
        if self.given_up.borrow().is_none() {
            alerts.clear(AlertKind::GuidingLost, &self.camera);
        }
        alerts.clear(AlertKind::FieldTurns, &self.camera);
        self.guiding.state.send_modify(|state| {
            state.active = false;
            state.detail = String::new();
        });
    }
}

/// A copy of an error, to report it a second time.
fn copied(error: &ActionError) -> ActionError {
    match error {
        ActionError::Failed { device, verb, reason } => {
            ActionError::Failed { device: device.clone(), verb: verb.clone(), reason: reason.clone() }
        }
        other => ActionError::Impossible(other.to_string()),
    }
}
