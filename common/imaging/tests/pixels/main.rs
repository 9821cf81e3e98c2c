//! The crate against drawn, golden and real frames, star lists and nights. One binary: the crate is optimised also in a
//! development build, so each further one would be compiled at length.
#![allow(clippy::unwrap_used, clippy::panic)] // helpers of tests are tests too

// the examples have their part of these too
#[path = "../defocus/mod.rs"]
mod defocus;
#[path = "../drawn/mod.rs"]
mod drawn;
#[path = "../fits/mod.rs"]
mod fits;
#[path = "../mount/mod.rs"]
mod mount;
#[path = "../sky/mod.rs"]
mod sky;

mod accuracy;
mod any_frame;
mod any_star_list;
mod bad_pixels;
mod completeness;
mod cosmics;
mod focus;
mod focus_golden;
mod golden;
mod golden_whole;
mod guide_any_input;
mod guide_calibrate;
mod guide_logs;
mod guide_loop;
mod guide_measure;
mod guide_nights;
mod hfd;
mod mosaic;
mod predecessor;
mod projections;
mod shift;
mod solve_blind;
mod solve_fields;
mod solve_golden;
mod solve_hidden;
mod solve_random;
mod solve_real;
mod trails;
mod trails_not;
