//! Which process may open a dome and which may command a telescope: the decisions, without clocks, tasks, files or the
//! bus.
//!
//! Everything here takes time and messages as values and returns what must be done. States are plain data: they can be
//! cloned, compared and hashed, so that a model checker can visit all of them.
//!
//! - The dome: [`Guard`] decides when it must close, by the permits that [`PermitLedger`] counts and by what
//!   [`ShutterEvidence`] concludes of its shutter; [`GuardLoop`] which requests are sent and when. [`MountsUnder`] knows
//!   which mounts are parked, by what [`Parked`] concludes of each, [`MountWatch`] when a mount must stop or park.
//! - Commands: [`Authorization`] decides whether a command passes, by [`Need`] and [`Hinders`], its token ([`fence()`])
//!   and the [`Leases`] of the site: [`KnownTokens`] counts tokens, [`Holding`] knows who holds a lease, and
//!   [`SitePermits`] what all guards and commanders publish.
//! - The commander: [`LeaseHolder`] decides when a process asks for the lease, holds it, doubts it or stands by, and
//!   [`ClaimNote`] which tokens nobody commanded with; [`takeover`] what it adopts of the commander before.
//! - Processes: [`watch::Watch`] decides whether the device node guards or the process around it, [`Closer`] how that
//!   process closes, [`AtEnd`] when it may end; [`Succession`] which of two incarnations of a node is the newer one,
//!   [`Incarnations`] what each of them published last.
//!
//! # Times and counts, for a model checker
//!
//! A state holds points in time and never reads a clock. Each is compared with `now`, or with other times of the same
//! state, and nothing but the difference matters: two states whose times differ by one shift behave alike, and so do
//! states whose difference to `now` is beyond the longest time in this list.
//!
//! - [`Guard`]: `grace_until` (until the first permit); the opening (`travel`); the closing (`parked_within`, `travel` +
//!   5 s), its last request (10 s) and the one before (2 s).
//! - [`PermitLedger`]: when each number was sent, and a contested permit (`permit_valid`).
//! - [`ShutterEvidence`]: the newest reading (5 s); the opening, the requests and since when it is closed (`travel`, and
//!   their order); flips (60 s).
//! - [`GuardLoop`]: the newest reading (5 s), an impostor (10 s), the last feeding (a quarter of the watchdog's limit).
//! - [`Closer`]: the last question (1 s), readings and mounts (5 s), the last order to park (30 s), since when the dome
//!   is closed at an old address (1 h).
//! - [`watch::Watch`]: deadlines of domes and of the next start; since when the node runs (60 s).
//! - [`MountWatch`]: since when no permit counts (300 s), the last command (300 s).
//! - [`MountsUnder`]: the newest sample of each incarnation (10 s, 600 s).
//! - [`Parked`]: the newest place (10 s, 60 s), the last question (60 s), and when coordinates were told (60 s).
//! - [`Leases`]: the holder (5 s), guards and permits (10 s).
//! - [`LeaseHolder`]: since when the arbiter is silent (30 s) or publishes an older lease (5 s).
//! - [`Succession`]: first and last sample of each incarnation (0.5 s, 2 s, 16 s).
//!
//! Tokens, numbers and sequence numbers are compared by order. They are added to in three places only: the next one is
//! one more, a permit is as old as its distance to the guard's newest number (10), and a leap of more than 1000 is none
//! of one count. `dropped` of a [`PermitLedger`] is only published. Counts of tries and of silent ticks stop where more
//! of them change nothing.
//!
//! # Invariants
//!
//! - Every decision is a pure function or a state machine with the time as a value; states can be cloned, compared and
//!   hashed.
//! - The order of arrival, never a clock, decides which of two incarnations of a node is the newer one
//!   (`succession.rs`, decision 0042): `a_new_incarnation_follows_the_old_one_whatever_their_clocks_show`.
//! - Nothing is safe by default: a dome that is found open has one permit's time to be permitted, and an unknown
//!   posture counts as open: `a_dome_found_open_at_the_start_has_one_permit_time_to_be_permitted`.
//! - Closed is a conclusion: what may have opened a shutter is undone only by a close request and a reading that was
//!   requested after it (`shutter_evidence.rs`, decision 0046): `what_was_read_before_the_request_proves_nothing`.
//! - A guard without a valid permit closes, or has proven that the dome is closed, in every order of events
//!   (`guard_loop.rs`): `in_every_order_of_events_a_dome_without_a_valid_permit_is_closing_or_proven_closed`.
//! - A token has one holder, and no living one is robbed (`leases.rs`):
//!   `in_every_order_of_messages_a_token_has_one_holder_and_no_living_one_is_robbed`.
//! - An arbiter without its file goes on beyond the newest token that it is shown, in one step (`known_tokens.rs`,
//!   decision 0130): `whatever_file_is_lost_the_lease_is_granted_in_one_step`.
//! - A lease is held by one incarnation of a process, and an orderly end releases it (`holder.rs`):
//!   `of_two_processes_of_one_name_the_second_waits_until_the_first_was_silent_for_five_seconds`.
//! - A token counts as unused only if nobody commanded with it (`claim_note.rs`, decision 0015):
//!   `in_every_order_of_steps_and_ends_no_two_hold_one_token_and_no_commander_counts_as_none`.
//! - The guard process needs neither the configuration nor the bus to close, and no restart gives an open dome more
//!   time (decision 0044): `a_crash_loop_with_runs_of_any_length_gains_no_time`. An orderly end closes first (decision
//!   0045): `an_end_closes_whatever_lasts_and_starts_nothing`.
//! - A roof that waits for the park is moved by its guard only, which receives the states of all mounts; a command only
//!   starts that: `a_commanded_closing_of_a_shared_roof_waits_for_all_mounts_under_it`.

mod authorization;
mod claim_note;
mod closer;
mod closing_requests;
mod deadlines;
#[cfg(test)]
mod explore;
mod fence;
pub mod guard;
mod guard_loop;
mod guard_words;
mod hinders;
mod holder;
mod incarnations;
mod known_tokens;
mod lease_holder;
mod lease_known;
mod leases;
mod mount_watch;
mod mounts_under;
mod need;
mod other_telescopes;
mod parked;
mod permit_ledger;
mod process_end;
mod report;
mod request;
mod shutter_evidence;
mod site_permits;
mod succession;
pub mod takeover;
mod turned;
pub mod watch;
mod watchdog;

pub use authorization::{Admitted, Authorization, CommandNeeds, RoofCall};
pub use claim_note::{ClaimNote, Noted};
pub use closer::{Closer, CloserEffect, CloserEvent, KnownMounts};
pub use deadlines::{Before, Deadlines};
pub use fence::{commanded, fence};
pub use guard::Guard;
pub use guard_loop::{GuardEffect, GuardEvent, GuardLoop, ShutterReading};
pub use guard_words::{GuardWords, PERMIT_VALID, Roofs};
pub use hinders::{DueClosing, Hinders};
pub use holder::{Claimant, Holding, SILENT};
pub use incarnations::Incarnations;
pub use known_tokens::{KnownTokens, NextToken};
pub use lease_holder::{
    ClaimAnswer, LeaseAlert, LeaseEvent, LeaseHolder, LeaseState, LeaseStep, LeaseTask, PublishedLease,
};
pub use lease_known::LeaseKnown;
pub use leases::{Followed, Leases};
pub use mount_watch::{Calls, MountWatch};
pub use mounts_under::MountsUnder;
pub use need::Need;
pub use other_telescopes::OtherTelescopes;
pub use parked::{ParkReading, Parked};
pub use permit_ledger::{Dropped, PermitLedger, Taken};
pub use process_end::{AtEnd, ProcessEnd};
pub use report::{DomeReport, Report, nanos};
pub use request::{Answer, Request};
pub use shutter_evidence::{Contradiction, ShutterEvidence};
pub use site_permits::SitePermits;
pub use succession::Succession;
pub use turned::Turned;
pub use watchdog::Watchdog;
