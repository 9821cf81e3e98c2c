//! Device and observatory nodes in one process, on a bus of their own: against the simulated observatory (`sim`), or
//! against devices that do what a scenario asks of them (`site`, `starfield`). One binary, since each costs a link with
//! all of zenoh.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test ends by panicking")]

mod sim;
mod site;
mod starfield;

mod a_night;
mod another_schedule;
mod answers_about_schedules;
mod cools_the_camera;
mod executes_the_sites_script;
mod finds_lost_fields;
mod guides_the_field;
mod keeps_the_focus;
mod keeps_to_its_target;
mod measures_frames;
mod orders_about_rows;
mod proof;
mod rests_once;
mod solves_frames;
mod syncs_the_mount;
mod takeover;
mod takes_flats;
mod takes_over_what_was_learned;
mod the_slit;
mod truth_gate;
mod turns_over_late_and_for_what_moves;
mod waits_for_the_horizon;

/// No test waits longer than this for anything: far above what it takes on a busy machine.
const MOST: std::time::Duration = std::time::Duration::from_secs(240);
