//! The only way to close: stops the mount, shuts dome and covers, looks whether it is true, and never gives up.
//!
//! ```text
//!            unsafe, or a close request            verified by fresh states
//!   resting ------------------> closing, step by step ------------------> closed, and watched while unsafe
//!                                    ^  every 10 s again                              |
//!                                    +------------------------------------------------+
//!                                              a state says otherwise, or is silent
//! ```
//! [`decide`] derives the steps from fresh device states alone. The task remembers only when it last sent each step. A
//! device that hangs or fails delays no other.

pub mod decide;
mod often;
mod task;

pub use task::keep_closed;
