//! The decisions about safety: whether the sky is safe, and why not.
//!
//! Everything here is a value or a function of values. Time comes in as a value too ([`history::Now`]); nothing here reads a
//! clock, a file or the bus. The observatory node (`node-observatory/src/safety`) receives the inputs, calls [`judge::judge`] at
//! each arrival and each second, and publishes the result.
//!
//! One rule holds everywhere: what is missing, stale, unknown or no number is unsafe, and has a reason. Nothing is safe at the
//! start; each input must have been good, without a gap, for its whole dwell.
//!
//! ```text
//!   configuration --> Rules ----------------------------------------------------------------.
//!                                                                                             v
//!   states of devices --> History <-- records of the time before (recall)               judge(rules, history, now)
//!   clocks --> Doubts --> Sun -----^                                                          |
//!                                                                                             v
//!                                                            Ruling (with its age) <-- Judgement (with its reasons)
//! ```
//!
//! # Contents
//!
//! What the verdict rests on:
//!
//! - [`rules`]: the configured inputs and limits; [`measure`]: what of a parameter a limit is put on.
//! - [`history`]: what one input said, as far back as its dwell looks; [`heard`]: what all inputs said.
//! - [`recall`]: what a device node recorded before this node listened, placed on this node's clocks.
//! - [`frozen`]: a weather station whose values do not move; [`wind`]: directions to avoid.
//! - [`nodes`]: clocks and disks of the other machines; [`clocks`]: what time it may be; [`sun`]: where the Sun stands then.
//!
//! The verdict:
//!
//! - [`judge`]: the verdict with its reasons; [`ruling`]: the newest one, and whether it still counts.
//! - [`intervals`]: the verdicts of the last day.

pub mod clocks;
pub mod frozen;
pub mod heard;
pub mod history;
pub mod intervals;
pub mod judge;
pub mod measure;
pub mod nodes;
pub mod recall;
pub mod rules;
pub mod ruling;
pub mod sun;
pub mod wind;
