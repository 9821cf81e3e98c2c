//! Where the focus is: found by a run of frames, remembered, and followed from row to row and between frames.
//!
//! [`run`] drives the focuser and the camera as `imaging::focus::sweep` plans it; [`meter`] makes a value of each
//! frame; [`published_run`] publishes its progress. [`crate::focus_learned`] holds the results: `devices/focuser.rs`
//! asks it for the best position. A field for a run is chosen in [`field`]; [`expose_in_focus`] looks after the focus
//! of a row that is under way.

mod between;
pub mod field;
pub mod meter;
mod published_run;
pub mod run;
mod runs;

use std::sync::Arc;

use contract::Part;
use contract::observatory::{FocusLearned, FocusRun, FocusState};
use node::Node;
use tokio::sync::{mpsc, watch};

pub use between::{expose_in_focus, half_range, offset, plan, publish_run};

use crate::authority::Authority;
use crate::devices::Devices;
use crate::focus_learned::LearnedFocus;
use crate::publishing;
use crate::replicated::Replicated;
use crate::tasks::Tasks;

/// The state of the focus.
pub struct FocusData {
    /// As it is published.
    pub state: watch::Sender<FocusState>,
    /// What focus runs have taught.
    pub learned: Replicated<LearnedFocus>,
    /// Takes the runs that have ended, to publish them.
    pub ended_runs: mpsc::UnboundedSender<FocusRun>,
}

impl FocusData {
    /// Reads what was learned before; also returns where runs that have ended are received.
    pub async fn load(node: &Node) -> anyhow::Result<(Self, mpsc::UnboundedReceiver<FocusRun>)> {
        let learned = Replicated::load(node).await?;
        let (ended_runs, received) = mpsc::unbounded_channel();
        Ok((Self { state: watch::channel(FocusState::default()).0, learned, ended_runs }, received))
    }
}

/// Starts the tasks about the focus.
pub fn start(
    tasks: &mut Tasks,
    authority: &Arc<Authority>,
    devices: &Arc<Devices>,
    focus: &Arc<FocusData>,
    ended_runs: mpsc::UnboundedReceiver<FocusRun>,
) {
    let node = &authority.node;
    // It includes runs of earlier incarnations, whose events are no longer published.
    focus.learned.start(tasks, authority, watch::channel(FocusLearned::default()).0);
    tasks.spawn("best focus", runs::keep_showing(devices.clone(), focus.clone()));
    tasks.spawn("publish focus", publishing::keep_publishing(authority.clone(), Part::Focus, focus.state.subscribe()));
    tasks.spawn("publish focus runs", runs::keep_publishing_runs(node.clone(), ended_runs));
    tasks.spawn("receive focus runs", runs::keep_receiving_runs(node.clone(), focus.clone()));
}
