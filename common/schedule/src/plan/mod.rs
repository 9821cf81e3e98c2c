//! The forecast of a night: a schedule worked through on a clock that jumps from event to event, before anything moves.
//!
//! ```text
//!   rows --> Sequence (the runner's own) --which row now?--> a simulated run of its action (SimulatedRun)
//!                 ^                                                  |
//!                 '--- ended, interrupted, passed <--- now = the next event: an end, a start, the Sun
//! ```
//! The code that decides is the code that decides in the observatory node: which row is next ([`crate::sequence`]), why
//! a row may not run ([`safety::objection::stands_against`]), each action's own choice of the next frame, when a mount
//! flips, where it may be sent. Only the times that devices take are replaced, by [`Overheads`], which are measured
//! from telemetry ([`evidence`]) where there is some.
//!
//! Pure except for the horizon files that the configuration names: rows and configuration in, [`PlannedNight`] out. The
//! weather is assumed to be good, except for the given unsafe spans; the Sun is computed. Decision 0032.

pub mod evidence;
mod forecast;
pub mod overheads;
mod planned;
mod published;
pub mod simulated_run;
pub mod sky;
mod steps;
mod world;

pub use self::evidence::{Evidence, TakenFrame};
pub use self::forecast::{forecast, forecast_while};
pub use self::overheads::{Figure, Overheads, TimedPart};
pub use self::planned::{Heights, PlannedNight, PlannedRow};
pub use self::simulated_run::{Halt, SimulatedRun};

use std::collections::BTreeMap;
use std::sync::Arc;

use ::sky::SkyError;
use config::Observatory;
use contract::Name;
use contract::observatory::PlanBegun;
use units::Utc;

use self::sky::Sky;
use crate::horizon_limits::HorizonLimits;

/// The site for which a schedule is planned.
#[derive(Debug, Clone)]
pub struct Site {
    /// Its configuration.
    pub config: Arc<Observatory>,
    /// The overheads of its devices.
    pub overheads: Overheads,
    /// Spans during which the weather closes it, sorted or not.
    pub unsafe_spans: Vec<(Utc, Utc)>,
    /// What has happened of the schedule already; where absent, nothing has.
    pub begun: Option<PlanBegun>,
    /// The horizon limits of each mount; a horizon that cannot be read hides nothing, as in the observatory node.
    horizon_limits: BTreeMap<Name, HorizonLimits>,
    sky: Sky,
}

impl Site {
    /// A site under a good sky.
    ///
    /// # Errors
    /// The place is none on Earth.
    pub fn new(config: Arc<Observatory>, overheads: Overheads) -> Result<Self, SkyError> {
        let sky = Sky::of(&config.place)?;
        let limits = |mount| HorizonLimits::of(&config, mount).unwrap_or_else(|(without, _)| without);
        let horizon_limits = config.telescope.iter().map(|mount| (mount.common.name.clone(), limits(mount))).collect();
        Ok(Self { config, overheads, unsafe_spans: Vec::new(), begun: None, horizon_limits, sky })
    }
}
