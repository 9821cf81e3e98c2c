//! The observatory node: runs one telescope.
//!
//! It judges whether the sky is safe ([`safety`]), sends a permit each second to every dome's guard ([`permit`]), holds
//! the right to command ([`failover`]), works through the schedule ([`runner`], [`action`]) while the sky allows, and
//! closes ([`closing`]) when it does not, when people order it ([`orders`]), and at the night's end. It measures and
//! solves each frame ([`frames`]), finds the focus ([`focus`]), proves where the telescope looks ([`pointing`]), and
//! holds fields in their place ([`guiding`]). Each of these is a task of its own, and receives what it uses. The safety
//! loop waits for none of them.
//!
//! # Layers
//!
//! Modules import downward; `scripts/layers` refuses a circle (decision 0089). From the lowest:
//!
//! | modules | hold |
//! |---|---|
//! | `action_error`, `command_timeout`, `took`, `hold`, [`persisted`], [`replicated`], [`journal`], `tasks` | values and files |
//! | [`devices`] | the devices |
//! | `authority` | whether this node may act: verdict, lease, robotic switch, close request |
//! | `night`, `ledger`, `active_orders`, [`frames`], `slit`, [`hooks`], `opening`, [`schedule_file`] | what rows and tasks share, each with its own state |
//! | `row_context`, `exposing` | a row at work, and its frames |
//! | [`pointing`], [`focus`], [`guiding`], `moving`, [`flats`] | techniques of observing, each with its own state |
//! | [`action`], [`runner`] | the actions of rows, and which row runs |
//! | [`closing`], `failover`, `orders`, `alerting`, [`permit`] | tasks alongside the rows |
//! | `start` | prepares all of it for [`run`] |
//! | [`beginning`] | what the telescope does by itself then, for people |
//!
//! # Invariants
//!
//! Commanding:
//!
//! - Two programs that publish one safety input at the same time are both not believed (`safety/writers.rs`, decision
//!   0042).
//! - What loosens is on disk before it counts; what closes counts at once (`orders/execution.rs`, `persisted.rs`):
//!   `an_order_that_the_disk_does_not_take_is_refused_and_closing_acts_all_the_same`.
//! - A turn of the dome never delays closing: it is ordered only of an open dome under a safe sky, and closing
//!   interrupts it: `a_dome_that_hangs_while_it_follows_closes_as_fast_as_any_and_is_not_turned_any_more`.
//! - The site's script asks, and the node acts. The default closing waits for the script at most `close_wait_s`;
//!   guards, verdict and permits never wait (decision 0031):
//!   `a_script_that_loops_for_ever_in_close_holds_it_up_for_close_wait_s_and_no_longer`.
//! - A device fault ends one attempt of a row, never the night (decision 0011):
//!   `each_rest_is_twice_as_long_up_to_ten_times_the_first`.
//!
//! Rows:
//!
//! - A row never waits for the network: names are looked up beforehand (`names/`).
//!
//! Frames:
//!
//! - A frame counts when its camera's node has it on disk (`exposing/spooled.rs`); no two frames have one id, also
//!   where a focus run comes between: `the_id_is_on_disk_before_it_is_used`. Only the death of a camera's node before
//!   its disk has a frame may lose that frame, and what the journal has learned and not yet written survives a takeover
//!   (decision 0035): `a_frame_that_is_counted_while_the_journal_is_taken_over_is_not_forgotten`.
//! - A frame that the dome hid never counts (decision 0016):
//!   `a_frame_that_the_dome_hid_does_not_count_whoever_announces_it_and_whenever`.
//! - No frame of a row with `pointing` counts before a solved frame has proven where the telescope points, and the
//!   frames taken to find that out never count (decision 0019):
//!   `no_frame_counts_where_none_shows_where_it_looks_unless_the_row_allows_it`.
//! - A flat counts only by its measured level; a panel is dark after its row, and its cover opens again only under a
//!   safe sky (decision 0028): `a_panel_is_lit_behind_its_cover_and_left_dark_also_by_a_row_that_is_stopped`.
//! - Measuring never delays an exposure and never waits for the archive: newest frame first, on a thread of low
//!   priority. A frame that cannot be measured says why (decision 0017):
//!   `a_frame_that_cannot_be_had_gives_the_reason_and_three_of_them_raise_an_alert`.
//!
//! What is learned:
//!
//! - One odd solution never changes what is known of the optics (decision 0018):
//!   `a_camera_that_was_turned_is_learned_anew_by_its_second_frame_and_one_odd_frame_changes_nothing`.
//! - A guide pulse is given only to a mount that tracks and does not slew, for a row that nothing prevents (decision
//!   0020).
//! - What is stored about the focus is the list of runs; numbers are computed from it when needed, and move nothing
//!   before runs prove them (decision 0021): `a_coefficient_that_is_not_proven_moves_nothing`.
//! - What is learned about pointing, optics, guiding and focus is published; a standby adopts it, and writes it to disk
//!   once it commands: `a_standby_points_solves_and_holds_the_field_as_the_commander_did`.

pub mod action;
mod action_error;
mod active_orders;
mod alerting;
mod annunciator;
mod authority;
pub mod beginning;
pub mod closing;
mod command_timeout;
pub mod devices;
mod expected;
mod exposing;
mod failover;
pub mod flats;
pub mod focus;
mod focus_learned;
pub mod frames;
pub mod guiding;
mod hold;
pub mod hooks;
pub mod journal;
mod ledger;
mod moving;
mod names;
mod night;
mod opening;
mod orders;
pub mod permit;
pub mod persisted;
pub mod pointing;
mod publishing;
pub mod replicated;
mod robotic;
mod row_context;
pub mod runner;
mod safety;
pub mod schedule_file;
mod slit;
pub mod star_catalogue;
mod start;
mod tasks;
mod took;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use node::Node;

pub use action_error::ActionError;

use crate::failover::lease::{Claimant, LeasePublisher};
use crate::failover::shared_roof::SharedRoofWatch;
use crate::failover::takeover::Takeover;
use crate::frames::Measuring;
use crate::orders::Telescope;
use crate::orders::rows::OrderedRows;
use crate::row_context::RowTools;
use crate::start::Start;
use crate::tasks::Tasks;

/// Runs the telescope until the node is ordered to stop.
///
/// A task that ends early ends the node, which is then started afresh; meanwhile the guards of the domes receive no
/// permit, and close.
pub async fn run(node: Node) -> anyhow::Result<()> {
    let Start { tools, techniques, orders, schedule_file, site, names, focus_runs, verdict, hold, doubt, before } =
        start::start(&node).await?;
    let RowTools { authority, devices, slits, journal, night, ledger, frames, step_times } = &*tools;
    let lease = LeasePublisher::open(authority).await?;
    let (other_telescopes, leaves_alone) = (SharedRoofWatch::default(), Arc::new(AtomicBool::new(false)));
    let mut tasks = Tasks::default();

    let (rules, active_orders) = (orders.rules.clone(), orders.orders.subscribe());
    tasks.spawn("safety", safety::task::keep_judging(node.clone(), rules, active_orders, verdict));
    tasks.spawn("closing", closing::keep_closed(site, other_telescopes.clone()));
    let takeover = Takeover { authority: authority.clone(), journal: journal.clone(), orders: orders.clone(), before };
    let claimant = Claimant { authority: authority.clone(), devices: devices.clone(), doubt, takeover };
    failover::start(&mut tasks, claimant, (hold, lease.clone()), other_telescopes, leaves_alone.clone());
    tasks.spawn("permit", permit::keep_renewing(authority.clone(), devices.clone(), leaves_alone));
    active_orders::start(&mut tasks, &node, authority.hold.clone(), &orders);
    alerting::start(&mut tasks, authority, &orders);
    let schedule = schedule_file::start(&mut tasks, &schedule_file, night);
    let learning = schedule_file.earlier_nights.clone().keep_learning(node.clone(), step_times.clone());
    tasks.spawn("step times", learning);
    let (row_orders, about_rows) = tokio::sync::mpsc::unbounded_channel();
    let telescope = Telescope {
        authority: authority.clone(),
        devices: devices.clone(),
        journal: journal.clone(),
        orders,
        schedule_file,
        rows: OrderedRows {
            journal: journal.clone(),
            loaded: schedule.clone(),
            night: night.clone(),
            runner: row_orders,
        },
    };
    tasks.spawn("orders", orders::keep_answering(telescope, night.clone()));
    tasks.spawn("names", names::keep_looking_up(node.clone(), names, schedule.clone()));
    tasks.spawn("runner", runner::keep_observing(tools.clone(), techniques.clone(), schedule, about_rows));
    tasks.spawn("dome slits", slit::keep_following(slits.clone()));
    let measuring = Measuring {
        authority: authority.clone(),
        devices: devices.clone(),
        night: night.clone(),
        frames: frames.clone(),
    };
    frames::start(&mut tasks, measuring);
    ledger::start(&mut tasks, &node, ledger, journal, night);
    night::start(&mut tasks, authority, devices, night);
    pointing::start(&mut tasks, authority, &techniques.pointing);
    guiding::start(&mut tasks, authority, &techniques.guiding);
    focus::start(&mut tasks, authority, devices, &techniques.focus, focus_runs);

    let ended = tasks.run(&node).await;
    // Nothing of this incarnation commands any more, so that a standby need not wait for its silence.
    lease.release(authority, devices).await;
    authority.audit.end().await;
    ended
}
