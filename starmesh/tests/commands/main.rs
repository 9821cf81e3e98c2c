//! The commands of `starmesh`, each as its users run it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test ends by panicking")]

mod archives;
mod asks_solve_field;
mod asks_telescopes;
mod checks_configurations;
mod checks_schedules;
mod checks_wrong_schedules;
mod command;
mod fetches_gaia;
mod finds_frames;
mod lets_users_in;
mod makes_a_site_anew;
mod makes_copies_for_archives;
mod measures_images;
mod orders_are_one_by_every_way;
mod plans_schedules;
mod real_sky;
mod real_sky_solved;
mod refuses_wrong_commands;
mod sees_what_is_left;
mod solves_images;
mod starts_a_device_node;
mod writes_solutions;
#[path = "../../../common/config/tests/wrong/mod.rs"]
mod wrong;
