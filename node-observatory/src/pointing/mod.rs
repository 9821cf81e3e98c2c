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
//! Frames taken to find out where the telescope looks are kept and never count ([`acquire`]). Once it is proven, frames
//! count until one of them shows itself to be off ([`gate`]); one that cannot be solved proves nothing either way. Each
//! solved frame after a slew teaches the pointing model ([`learnt`]). The pure geometry is
//! `imaging::pointing`; decision 0019.

mod acquire;
mod failure;
mod fix;
pub(crate) mod flip;
mod gate;
pub mod learnt;
pub mod line;

use imaging::pointing::Miss;
use sky::Icrs;
use units::Angle;

pub use self::acquire::{Way, acquire, calm};
pub use self::fix::{forget, learn, look, seen, sensor_looks_at};
pub use self::flip::Flip;
pub use self::gate::Gate;
use crate::action::Stage;
use crate::rig::telescope::Mount;
use crate::trouble::Trouble;

/// Slews to a target, corrected by the learned model; returns the direction that was commanded.
pub async fn send(stage: &Stage, mount: &Mount, target: &Icrs) -> Result<Icrs, Trouble> {
    let observer = stage.visible(target)?;
    let expected = expected(stage, target, observer.hour_angle(target));
    let commanded = expected.map_or(*target, |miss| icrs(miss.aim(pair(target))));
    if let Some(miss) = expected {
        let (east_arcmin, north_arcmin) = (miss.east.degrees() * 60.0, miss.north.degrees() * 60.0);
        tracing::info!(east_arcmin, north_arcmin, "the slew is corrected by the pointing model");
    }
    mount.point(&commanded, &observer).await?;
    Ok(commanded)
}

/// The expected miss of the camera at the target, if a trustworthy model exists.
fn expected(stage: &Stage, target: &Icrs, hour_angle: Angle) -> Option<Miss> {
    let config = &stage.room.node.config.pointing;
    if !config.model {
        return None;
    }
    let most = Angle::from_degrees(config.model_max_arcmin / 60.0);
    stage.room.pointing_book.get().expected(stage.row.camera.as_str(), hour_angle, target.dec, most)
}

/// Right ascension and declination.
fn pair(icrs: &Icrs) -> (Angle, Angle) {
    (icrs.ra, icrs.dec)
}

fn icrs((ra, dec): (Angle, Angle)) -> Icrs {
    Icrs { ra, dec }
}
