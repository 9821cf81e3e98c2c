//! The observatory node: runs one telescope.
//!
//! It judges whether the sky is safe ([`safety`]), sends a permit each second to every dome's guard ([`permit`]), holds
//! the right to command ([`lease`]), works through the schedule ([`runner`], [`action`]) while the sky allows, and
//! closes ([`closing`]) when it does not, when people order it ([`order`]), and at the night's end. It measures and
//! solves each frame ([`frames`]), finds the focus ([`focus`]), proves where the telescope looks ([`pointing`]), and
//! holds fields in their place ([`guiding`]). Each of these is a task of its own; they meet in the [`control_room`].
//! The safety loop waits for none of them.
//!
//! # Invariants
//!
//! Commanding:
//!
//! - Two programs that publish one safety input at the same time are both not believed (`safety/writers.rs`, decision
//!   0042).
//! - What loosens is on disk before it counts; what closes counts at once (`obey.rs`, `kept.rs`):
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
//! - A frame counts when its camera's node has it on disk (`action/spooled.rs`); no two frames have one id, also where
//!   a focus run comes between: `the_id_is_on_disk_before_it_is_used`. Only the death of a camera's node before its
//!   disk has a frame may lose that frame, and what the journal has learned and not yet written survives a takeover
//!   (decision 0035): `a_frame_that_is_counted_while_the_journal_is_taken_over_is_not_forgotten`.
//! - A frame that the dome hid never counts (decision 0016):
//!   `a_frame_that_the_dome_hid_does_not_count_whoever_announces_it_and_whenever`.
//! - No frame of a row with `pointing` counts before a solved frame has proven where the telescope points, and the
//!   frames taken to find that out never count (decision 0019):
//!   `no_frame_counts_where_none_shows_where_it_looks_unless_the_row_says_so`.
//! - A flat counts only by its measured level; a panel is dark after its row, and its cover opens again only under a
//!   safe sky (decision 0028): `a_panel_is_lit_behind_its_cover_and_left_dark_also_by_a_row_that_is_stopped`.
//! - Measuring never delays an exposure and never waits for the archive: newest frame first, on a thread of low
//!   priority. A frame that cannot be measured says why (decision 0017):
//!   `a_frame_that_cannot_be_had_gives_the_reason_and_a_person_is_told_of_three`.
//!
//! What is learned:
//!
//! - One odd solution never changes what is known of the optics (decision 0018):
//!   `a_camera_that_was_turned_is_learnt_anew_by_its_second_frame_and_one_odd_frame_changes_nothing`.
//! - A guide pulse is given only to a mount that tracks and does not slew, for a row that nothing prevents (decision
//!   0020).
//! - What is stored about the focus is the list of runs; numbers are computed from it when needed, and move nothing
//!   before runs prove them (decision 0021): `a_coefficient_that_is_not_proven_moves_nothing`.
//! - What is learned about pointing, optics, guiding and focus is published; a standby adopts it, and writes it to disk
//!   once it commands: `a_standby_points_solves_and_holds_the_field_as_the_commander_did`.

pub mod action;
mod alerting;
mod annunciator;
mod claim_note;
pub mod closing;
pub mod control_room;
pub mod flats;
pub mod focus;
pub mod frames;
pub mod guiding;
pub mod hooks;
pub mod journal;
pub mod kept;
pub mod lease;
mod leaving;
mod ledger;
mod moving;
mod names;
mod neighbours;
mod night;
mod obey;
mod opening;
mod order;
mod patience;
pub mod permit;
pub mod pointing;
pub mod rig;
pub mod runner;
mod safety;
pub mod schedule_file;
mod slit;
mod standing;
mod standing_line;
pub mod star_catalogue;
mod start;
mod takeover;
mod trouble;

use anyhow::{Context as _, bail};
use bus::Node;
use contract::Part;
use contract::observatory::AlertKind;
use tokio::task::JoinSet;

pub use trouble::Trouble;

/// Runs the telescope until the node is ordered to stop.
///
/// A task that ends early ends the node, which is then started afresh; meanwhile the guards of the domes receive no
/// permit, and close.
pub async fn run(node: Node) -> anyhow::Result<()> {
    let start::Start { room, ruling, hold, loaded, focus_runs, neighbours } = start::start(&node).await?;
    let (schedule, named, control_room) = (loaded.subscribe(), loaded.subscribe(), room.clone());
    let lease = lease::Line::open(&room).await?;
    let mut tasks: JoinSet<(&str, anyhow::Result<()>)> = JoinSet::new();
    let mut run = |name, task: start::Task| tasks.spawn(async move { (name, task.await) });

    let (rules, standing) = (room.rules.clone(), room.standing.subscribe());
    run("safety", Box::pin(safety::task::keep_judging(node.clone(), rules, standing, ruling)));
    run("closing", Box::pin(closing::keep_closed(room.clone(), neighbours.clone())));
    run("lease", Box::pin(lease::keep_holding(room.clone(), hold, lease.clone())));
    run("permit", Box::pin(permit::keep_renewing(room.clone())));
    run("standing orders", Box::pin(standing::keep_reminding(room.clone())));
    let (kind, what) = (AlertKind::StandingOrders, "what people ordered");
    run("standing orders on disk", Box::pin(kept::keep_on_disk(room.clone(), |room| &room.standing, kind, what)));
    let (kind, what) = (AlertKind::AlertsNotKept, "what people did about alerts");
    run("alerts on disk", Box::pin(kept::keep_on_disk(room.clone(), |room| &room.annunciator, kind, what)));
    let (kind, what) = (AlertKind::GuidingNotKept, "what guiding has learnt");
    run("guiding on disk", Box::pin(kept::keep_on_disk(room.clone(), |room| &room.guide_learnt, kind, what)));
    run("tell standing orders", Box::pin(standing_line::keep_telling(room.clone())));
    run("hear standing orders", Box::pin(standing_line::keep_hearing(room.clone())));
    run("orders", Box::pin(order::keep_answering(room.clone())));
    run("schedule", Box::pin(schedule_file::keep_reading(room.clone(), loaded)));
    run("survey the schedule", Box::pin(schedule_file::findings::keep_surveying(room.clone(), schedule.clone())));
    run("check schedules", Box::pin(schedule_file::findings::keep_answering(room.clone())));
    run("runner", Box::pin(runner::keep_observing(room.clone(), schedule)));
    run("names", Box::pin(names::keep_looking_up(room.clone(), named)));
    run("dome slits", Box::pin(slit::keep_following(room.clone())));
    run("star catalogue", Box::pin(star_catalogue::keep_open(room.clone())));
    run("mounts", Box::pin(frames::mounts::keep_noting(room.clone())));
    run("measuring", Box::pin(frames::keep_measuring(room.clone())));
    let (kind, what) = (AlertKind::FocusNotKept, "what was learnt of the focus");
    run("focus on disk", Box::pin(kept::keep_on_disk(room.clone(), |room| &room.focus_learnt, kind, what)));
    run("best focus", Box::pin(focus::keep_showing(room.clone())));
    run("tell focus runs", Box::pin(focus::keep_telling_runs(room.clone(), focus_runs)));
    run("hear focus runs", Box::pin(focus::keep_hearing_runs(room.clone())));
    run("tell learnt focus", Box::pin(focus::keep_telling_learnt(room.clone())));
    run("hear learnt focus", Box::pin(focus::keep_hearing_learnt(room.clone())));
    let (kind, what) = (AlertKind::OpticsNotKept, "what was learnt of the optics");
    run("optics on disk", Box::pin(kept::keep_on_disk(room.clone(), |room| &room.optics, kind, what)));
    run("tell optics", Box::pin(frames::optics_line::keep_telling(room.clone())));
    run("hear optics", Box::pin(frames::optics_line::keep_hearing(room.clone())));
    run("frames", Box::pin(ledger::keep_counting_frames(room.clone())));
    run("files", Box::pin(ledger::keep_counting_files(room.clone())));
    run("neighbours", Box::pin(neighbours.keep_hearing(node.clone())));
    run("tell safety", Box::pin(night::keep_telling_safety(room.clone())));
    run("tell night", Box::pin(night::keep_telling_night(room.clone())));
    run("tell schedule", Box::pin(night::keep_telling_schedule(room.clone())));
    let (kind, what) = (AlertKind::PointingNotKept, "what was learnt of the pointing");
    run("pointing on disk", Box::pin(kept::keep_on_disk(room.clone(), |room| &room.pointing_book, kind, what)));
    run("tell pointing", Box::pin(night::keep_telling(room.clone(), Part::Pointing, room.pointing.clone())));
    run("hear pointing", Box::pin(pointing::line::keep_hearing(room.clone())));
    run("tell guiding", Box::pin(night::keep_telling(room.clone(), Part::Guiding, room.guiding.clone())));
    run("tell what guiding learnt", Box::pin(guiding::line::keep_telling(room.clone())));
    run("hear what guiding learnt", Box::pin(guiding::line::keep_hearing(room.clone())));
    run("tell focus", Box::pin(night::keep_telling(room.clone(), Part::Focus, room.focus.clone())));
    let pinging = room.clone();
    let is_well = move || pinging.is_judging() && pinging.may_speak();
    let alerts = room.alerts.subscribe();
    run("ping", Box::pin(notify::keep_pinging(node.clone(), is_well)));
    run("alerts out", Box::pin(notify::keep_sending(node.clone(), alerts)));
    run("silent nodes", Box::pin(alerting::keep_noticing_silence(room.clone())));
    run("end", Box::pin(leaving::close_first(room.clone())));
    run("alerts", Box::pin(alerting::keep_merging(room)));

    let ended = node.stop.or(tasks.join_next()).await;
    tasks.shutdown().await;
    // Nothing of this incarnation commands any more, so that a standby need not wait for its silence.
    lease.release(&control_room).await;
    control_room.audit.end().await;
    let Some(ended) = ended else { return Ok(()) };
    match ended {
        Some(Ok((name, result))) => {
            result.with_context(|| format!("the task {name:?} failed"))?;
            bail!("the task {name:?} ended")
        }
        Some(Err(error)) => Err(error).context("a task was lost"),
        None => bail!("there are no tasks"),
    }
}
