//! The only way to close: stops the mount, shuts dome and covers, looks whether it is true, and never gives up.
//!
//! ```text
//!            unsafe, or a wish                     verified by fresh states
//!   resting ------------------> closing, step by step ------------------> closed, and watched while unsafe
//!                                    ^  every 10 s again                              |
//!                                    +------------------------------------------------+
//!                                              a state says otherwise, or is silent
//! ```
//! What is to be done is worked out from fresh device states alone, in [`decide`]; nothing is remembered but when
//! each step was last sent. A device that hangs or fails holds up no other.

pub mod decide;
mod often;
mod task;

pub use task::keep_closed;
