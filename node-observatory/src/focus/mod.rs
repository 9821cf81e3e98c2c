//! Where the focus is: found by a run of frames, remembered, and followed from row to row and between frames.
//!
//! [`run`] drives the focuser and the camera as `imaging::focus::sweep` plans it; [`meter`] makes a value of each
//! frame; [`shown`] holds its progress. [`learnt`] holds the results: `rig/focuser.rs` asks it for the best position. A
//! field for a run is chosen in [`field`]; [`between_frames`] looks after the focus of a row that is under way.

mod between;
pub mod field;
pub mod learnt;
pub mod meter;
pub mod run;
mod shown;
mod told;

pub use between::{between_frames, half_range, offset, plan, tell};
pub use learnt::{Learnt, path};
pub use told::{keep_hearing_learnt, keep_hearing_runs, keep_showing, keep_telling_learnt, keep_telling_runs};
