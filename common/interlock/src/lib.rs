//! Who may open a dome and who may command a telescope: the decisions, without clocks, tasks, files or the bus.
//!
//! Everything here takes time and messages as values and returns what must be done. States are plain data: they can be
//! cloned, compared and hashed, so that a model checker can visit all of them.
//!
//! - The dome: [`Guard`] decides when it must close, by the permits that [`PermitLedger`] counts and by what
//!   [`ShutterEvidence`] concludes of its shutter. [`MountsUnder`] knows which mounts are parked, [`MountWatch`] when a mount
//!   must stop or park.
//! - Commands: [`Need`] and [`Hinders`] say what a command needs and what it may hinder, [`fence()`] compares its token,
//!   [`KnownTokens`] counts tokens, [`Holding`] knows who holds a lease, and [`SitePermits`] what all guards and commanders
//!   of a site publish.
//! - Processes: [`watch::Watch`] decides whether the device node guards or the process around it, [`Succession`] which of
//!   two incarnations of a node is the newer one, [`Lives`] what each of them published last.

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
