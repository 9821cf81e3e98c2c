//! Targets that move among the stars: planets and the Moon, asteroids and comets, satellites of the Earth.
//!
//! ```text
//!  slew to where it will be (meet) --> it is there --> rates (course), renewed as the path bends --> the row's frames
//!            ^                                                                                           |
//!            +------------- nonsidereal_recenter_interval has passed, between two frames ---------------+
//! ```
//! Where a body stands is `sky::moving`; which rates keep a mount on it is [`course`]. The rates end in every way out
//! of a row: at its end and after a fault by this node, and by the mount's device node before the next slew, whatever
//! became of this one. Decision 0029.

mod course;
mod observe;
mod path;

pub use self::observe::{Wish, can_follow, observe};
