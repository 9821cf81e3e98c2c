//! Targets that move among the stars: planets and the Moon, asteroids and comets, satellites of the Earth.
//!
//! ```text
//!  slew to where it will be (meet) --> it is there --> rates (`rated_motion`), renewed as the path bends --> the row's frames
//!            ^                                                                                           |
//!            +------------- nonsidereal_recenter_interval has passed, between two frames ---------------+
//! ```
//! `sky::moving` computes the place of a body, and [`rated_motion`] the rates that keep a mount on it. The rates end in every
//! way out of a row: at its end and after a fault by this node, and by the mount's device node before the next slew,
//! whatever became of this one. Decision 0029.

mod observe;
mod path;
mod rated_motion;

pub use self::observe::{FollowRequest, can_follow, observe};
