//! Which node commands the telescope, what it takes over from the one before, and how it leaves.
//!
//! The node that commands holds the lease ([`lease`]). A standby follows what people order of it ([`operator_orders`]),
//! and learns the rest when it is granted the lease ([`takeover`]), behind a note on disk ([`claim_note`]).

mod claim_note;
pub mod lease;
mod leaving;
pub mod operator_orders;
pub mod shared_roof;
pub mod takeover;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use tokio::sync::watch;

use self::lease::{Claimant, LeasePublisher};
use self::shared_roof::SharedRoofWatch;
use crate::hold::Hold;
use crate::tasks::Tasks;

/// Starts the tasks about the lease. `leaves_alone` is set when this node ends and nobody takes over.
pub fn start(
    tasks: &mut Tasks,
    claimant: Claimant,
    (hold, lease): (watch::Sender<Hold>, LeasePublisher),
    other_telescopes: SharedRoofWatch,
    leaves_alone: Arc<AtomicBool>,
) {
    let (authority, orders) = (claimant.authority.clone(), claimant.takeover.orders.clone());
    let commander_orders = claimant.takeover.before.orders.clone();
    tasks.spawn("lease", lease::keep_holding(claimant, hold, lease));
    tasks.spawn("publish operator orders", operator_orders::keep_publishing(authority.clone(), orders.clone()));
    let receiving = operator_orders::keep_receiving(authority.clone(), orders, commander_orders);
    tasks.spawn("receive operator orders", receiving);
    tasks.spawn("other telescopes", other_telescopes.keep_receiving(authority.node.clone()));
    tasks.spawn("end", leaving::close_first(authority, leaves_alone));
}
