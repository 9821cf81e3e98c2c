//! A telescope that proves where it looks.
//!
//! ```text
//!  first slew, corrected by the pointing model   --> frame, solved --> on target ------> the row's frames
//!                                                          ^      |                              |
//!                                                          |      | off: slew (acquire)          | astray, or the pier
//!                                                          +------+                              | side changed (gate)
//!                                                          ^                                     |
//!                                                          +-------------------------------------+
//! ```
//! Frames taken to find out where the telescope looks are kept and never count ([`mod@acquire`]). Once it is proven, frames
//! count until one of them shows itself to be off ([`gate`]); one that cannot be solved proves nothing either way. Each
//! solved frame after a slew teaches the pointing model ([`learned`]). The pure geometry is
//! `imaging::pointing`; decision 0019.

mod acquire;
mod failure;
mod fix;
pub(crate) mod flip;
mod gate;
pub mod learned;

use std::sync::Arc;

use contract::observatory::PointingState;
use imaging::pointing::Miss;
use node::Node;
use sky::Icrs;
use tokio::sync::watch;
use units::Angle;

pub use self::acquire::{Acquisition, acquire, calm};
pub use self::fix::{forget, learn, look, seen, sensor_looks_at};
pub use self::flip::Flip;
pub use self::gate::Gate;
use self::learned::PointingModels;
use crate::action_error::ActionError;
use crate::authority::Authority;
use crate::devices::telescope::Mount;
use crate::replicated::Replicated;
use crate::row_context::RowContext;
use crate::tasks::Tasks;

/// The state of the pointing.
pub struct PointingData {
    /// As it is published.
    pub state: watch::Sender<PointingState>,
    /// The learned pointing models.
    pub models: Replicated<PointingModels>,
}

impl PointingData {
    /// Reads what was learned before.
    pub async fn load(node: &Node) -> anyhow::Result<Self> {
        Ok(Self { state: watch::channel(PointingState::default()).0, models: Replicated::load(node).await? })
    }
}

/// Starts the tasks about the pointing.
pub fn start(tasks: &mut Tasks, authority: &Arc<Authority>, pointing: &PointingData) {
    pointing.models.start(tasks, authority, pointing.state.clone());
}

/// Slews to a target, corrected by the learned model; returns the direction that was commanded.
pub async fn send(
    context: &RowContext,
    pointing: &PointingData,
    mount: &Mount,
    target: &Icrs,
) -> Result<Icrs, ActionError> {
    let observer = context.visible(target)?;
    let expected = expected(context, pointing, target, observer.hour_angle(target));
    let commanded = expected.map_or(*target, |miss| icrs(miss.aim(pair(target))));
    if let Some(miss) = expected {
        let (east_arcmin, north_arcmin) = (miss.east.degrees() * 60.0, miss.north.degrees() * 60.0);
        tracing::info!(east_arcmin, north_arcmin, "the slew is corrected by the pointing model");
    }
    mount.point(&commanded, &observer).await?;
    Ok(commanded)
}

/// The expected miss of the camera at the target, if a trustworthy model exists.
fn expected(context: &RowContext, pointing: &PointingData, target: &Icrs, hour_angle: Angle) -> Option<Miss> {
    let config = &context.tools.authority.node.config.pointing;
    if !config.model {
        return None;
    }
    let most = Angle::from_degrees(config.model_max_arcmin / 60.0);
    pointing.models.get().expected(context.row.camera.as_str(), hour_angle, target.dec, most)
}

/// Right ascension and declination.
fn pair(icrs: &Icrs) -> (Angle, Angle) {
    (icrs.ra, icrs.dec)
}

fn icrs((ra, dec): (Angle, Angle)) -> Icrs {
    Icrs { ra, dec }
}
