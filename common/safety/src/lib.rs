//! The decisions about safety: whether the sky is safe, what people have ordered of that, and what stands against an
//! action.
//!
//! Everything here is a value or a function of values. Time comes in as a value too ([`history::Now`]); nothing here
//! reads a clock, a file or the bus. The observatory node (`node-observatory/src/safety`) receives the inputs, calls
//! [`judge::judge`] at each arrival and each second, and publishes the result.
//!
//! One rule holds everywhere: what is missing, stale, unknown or no number is unsafe, and has a reason. Nothing is safe
//! at the start; each input must have been good, without a gap, for its whole dwell.
//!
//! ```text
//!   configuration --> Rules --- operator orders (ActiveOrders) -> the rules as they hold now --.
//!                                                                                             v
//!   states of devices --> History <-- records of the time before (recall)               judge(rules, history, now)
//!   clocks --> Doubts --> Sun -----^                                                          |
//!                                                                                             v
//!                                 Objection to an action <-- Verdict (with its age) <-- Judgement (with its reasons)
//! ```
//!
//! # Contents
//!
//! What the verdict rests on:
//!
//! - [`rules`]: the configured inputs and limits; [`measure`]: what of a parameter a limit is put on.
//! - [`reading`]: what a published state says of an input; [`history`]: the states of one input, as far back as its
//!   dwell looks; [`received`]: the states of all inputs.
//! - [`recall`]: what a device node recorded and this node did not receive, placed on this node's clocks; [`recalled`]:
//!   the same among what was received; [`stored_history`]: what this node itself received before it was restarted.
//! - [`missed`]: states that nobody knows; [`keeps_shut`]: a shut dome stays shut over them.
//! - [`contradiction`]: values of a weather station that exclude each other; [`frozen`]: a station whose values do not
//!   move; [`wind`]: directions to avoid.
//! - [`nodes`]: clocks and disks of the other machines; [`clocks`]: what time it may be; [`sun`]: where the Sun stands
//!   then.
//!
//! The verdict:
//!
//! - [`judge`]: the verdict with its reasons; [`current_verdict`]: the newest one, and whether it still counts.
//! - [`intervals`]: the verdicts of the last day.
//! - [`objection`]: the objections to an action.
//!
//! What people order:
//!
//! - [`ordered_by`]: the person who ordered something, and the reason; [`active_orders`]: the orders that hold until
//!   they end or are taken back.
//! - [`on_disk`]: the content of the file of these orders; [`takeover`]: what holds for a node that becomes the
//!   commander.
//! - [`operators`]: which operator has the telescope, or the schedule.
//! - [`annunciator`]: what people did about alerts.
//!
//! # Invariants
//!
//! - Nothing is safe by default: every dwell begins unsafe: `the_dwell_must_be_filled_before_the_first_safe`.
//! - The Sun follows every clock that may be right: `a_step_of_the_wall_clock_is_seen_and_both_times_may_be_right`
//!   (`clocks.rs`).
//! - Evidence from the past counts only where it joins the live states; live states alone show what is true now
//!   (decision 0012): `recalled_evidence_without_live_states_is_not_what_is_now`.
//! - What was recorded counts over restarts of all nodes, holes in what was received, and any two of them; without a
//!   record nothing does (decision 0177): `of_any_two_interruptions_within_a_dwell_neither_starts_it_anew`,
//!   `nobody_is_safe_after_interruptions_where_one_who_received_everything_is_not`.
//! - What was missed keeps a shut dome shut while it is asked for, and for a dwell where the answer cannot be taken; an open
//!   one stays open (decision 0177): `a_dwell_that_ends_while_a_device_node_is_asked_opens_nothing`
//!   (`keeps_shut.rs`).
//! - What this node wrote before a restart counts like what it received, and no longer (decision 0150):
//!   `a_restart_within_the_allowed_age_is_judged_as_if_nothing_had_come_meanwhile`.
//! - What may have happened before this node subscribed is unknown, and unknown is unsafe, also within the window of a
//!   largest value: `a_maximum_is_known_once_its_window_has_filled_since_the_listening_began`.
//! - No answer is no reading: the one before stays the newest until it is too old (decision 0129):
//!   `a_reported_silence_is_judged_as_if_nothing_had_come`.
//! - No value outside of its physical range is believed, and none of a station that contradicts itself is good (decision
//!   0128): `no_parameter_is_believed_outside_of_its_range_on_whichever_side_its_limit_is`.
//! - A dome without any input that reports rain stays closed (decision 0056): `without_any_input_it_is_never_safe`.
//! - A commander that does not know the last operator orders of the commander before it stays closed (`takeover.rs`,
//!   decision 0015): `the_orders_to_the_earlier_commander_hold_and_the_dome_stays_closed_where_nobody_knows_them`.

pub mod active_orders;
pub mod annunciator;
pub mod clocks;
pub mod contradiction;
pub mod current_verdict;
#[cfg(test)]
mod fixture;
pub mod frozen;
pub mod history;
pub mod intervals;
pub mod judge;
pub mod keeps_shut;
pub mod measure;
pub mod missed;
pub mod nodes;
pub mod objection;
pub mod on_disk;
pub mod operators;
pub mod ordered_by;
pub mod reading;
pub mod recall;
pub mod recalled;
pub mod received;
pub mod rules;
pub mod stored_history;
pub mod sun;
pub mod takeover;
pub mod wind;
