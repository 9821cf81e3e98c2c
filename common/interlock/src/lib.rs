//! Which process may open a dome and which may command a telescope: the decisions, without clocks, tasks, files or the
//! bus.
//!
//! Everything here takes time and messages as values and returns what must be done. States are plain data: they can be
//! cloned, compared and hashed, so that a model checker can visit all of them.
//!
//! - The dome: [`Guard`] decides when it must close, by the permits that [`PermitLedger`] counts and by what
//!   [`ShutterEvidence`] concludes of its shutter. [`MountsUnder`] knows which mounts are parked, [`MountWatch`] when a
//!   mount must stop or park.
//! - Commands: [`Need`] and [`Hinders`] define what a command needs and what it may hinder, [`fence()`] compares its
//!   token, [`KnownTokens`] counts tokens, [`Holding`] knows who holds a lease, and [`SitePermits`] what all guards and
//!   commanders of a site publish.
//! - Processes: [`watch::Watch`] decides whether the device node guards or the process around it, [`Succession`] which
//!   of two incarnations of a node is the newer one, [`Lives`] what each of them published last.
//!
//! # Invariants
//!
//! - Every decision is a pure function or a state machine with the time as a value; states can be cloned, compared and
//!   hashed.
//! - The order of arrival, never a clock, decides which of two incarnations of a node is the newer one
//!   (`succession.rs`, decision 0042): `a_new_life_follows_the_old_one_whatever_their_clocks_say`.
//! - Nothing is safe by default: a dome that is found open has one permit's time to be permitted, and an unknown
//!   posture counts as open: `a_dome_found_open_at_the_start_has_one_permit_time_to_be_permitted`.
//! - Closed is a conclusion: what may have opened a shutter is undone only by a close request and a reading that was
//!   requested after it (`shutter_evidence.rs`, decision 0046): `what_was_read_before_the_request_proves_nothing`.
//! - A lease is held by one incarnation of a process, and an orderly end releases it (`holder.rs`):
//!   `of_two_processes_of_one_name_the_second_waits_until_the_first_was_silent_for_five_seconds`.
//! - The guard process needs neither the configuration nor the bus to close, and no restart gives an open dome more
//!   time (decision 0044): `a_crash_loop_with_lives_of_any_length_gains_no_time`. An orderly end closes first (decision
//!   0045): `an_end_closes_whatever_lasts_and_starts_nothing`.
//! - A roof that waits for the park is moved by its guard only, which receives the states of all mounts; a command only
//!   starts that: `a_commanded_closing_of_a_shared_roof_waits_for_all_mounts_under_it`.

mod deadlines;
mod fence;
pub mod guard;
mod guard_words;
mod hinders;
mod holder;
mod known_tokens;
mod lives;
mod mount_watch;
mod mounts_under;
mod need;
mod permit_ledger;
mod report;
mod shutter_evidence;
mod site_permits;
mod succession;
mod turned;
pub mod watch;

pub use deadlines::{Before, Deadlines};
pub use fence::{commanded, fence};
pub use guard::Guard;
pub use guard_words::{GuardWords, PERMIT_VALID, Roofs};
pub use hinders::{DueClosing, Hinders};
pub use holder::{Claimant, Holding, SILENT};
pub use known_tokens::KnownTokens;
pub use lives::Lives;
pub use mount_watch::{Calls, MountWatch};
pub use mounts_under::MountsUnder;
pub use need::Need;
pub use permit_ledger::{Dropped, PermitLedger, Taken};
pub use report::{DomeReport, Report};
pub use shutter_evidence::{Contradiction, ShutterEvidence};
pub use site_permits::SitePermits;
pub use succession::Succession;
pub use turned::Turned;
