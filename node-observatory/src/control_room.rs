//! The values that all tasks of the node share: the devices, the verdict, the lease, and the switches that people turn.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use audit::{Audit, Entry};
use bus::{Node, Publisher};
use config::FaultPolicy;
use contract::audit::Outcome;
use contract::observatory::{
    Alerts, Correction, FocusRun, FocusState, GuidingState, OpticsState, PointingState, StandingOrders,
};
use contract::{CommandId, Key, Name, Part};
use safety::annunciator::Annunciator;
use safety::objection::{Objection, sky_stands_against, stands_against};
use safety::rules::Rules;
use safety::ruling::Ruling;
use safety::standing::Standing;
use sky::{EarthOrientation, Icrs, Observer, Place, SkyError};
use tokio::sync::{Notify, OnceCell, mpsc, watch};
use units::Utc;

use crate::frames::dark::Darks;
use crate::frames::looked::Looks;
use crate::frames::mounts::Mounts;
use crate::frames::tell::Telling;
use crate::guiding::learnt::Learnt;
use crate::hooks::Hooks;
use crate::journal::Journal;
use crate::kept::Kept;
use crate::lease::Hold;
use crate::ledger::Ledger;
use crate::night::Board;
use crate::pointing::learnt::Book;
use crate::rig::Rig;
use crate::schedule_file::versions::Versions;
use crate::star_catalogue::StarCatalogue;
use crate::takeover::Before;
use crate::trouble::Trouble;
use schedule::Row;
use schedule::names::Known;

/// The control room.
pub struct ControlRoom {
    /// Configuration, bus, alerts.
    pub node: Node,
    /// The devices.
    pub rig: Rig,
    /// The newest verdict.
    pub ruling: watch::Receiver<Ruling>,
    /// The lease.
    pub hold: watch::Receiver<Hold>,
    /// Notified when a device knows a newer token than ours.
    pub doubt: Arc<Notify>,
    /// The robotic switch.
    pub robotic: watch::Sender<bool>,
    /// Why everything should be closed although the sky is safe; `None` once it is verified closed.
    pub wish_closed: watch::Sender<Option<String>>,
    /// Where a row is about to point a mount, or points it.
    pub aim: watch::Sender<Option<(Name, Icrs)>>,
    /// Every schedule that was in force.
    pub versions: Versions,
    /// Counts orders to read the schedule again.
    pub reload: watch::Sender<u64>,
    /// The record on disk of all that was begun and finished.
    pub journal: Journal,
    /// The rules of the verdict.
    pub rules: Arc<Rules>,
    /// People's operator orders.
    pub standing: Kept<Standing>,
    /// The operator orders as last published.
    pub standing_said: watch::Sender<Option<StandingOrders>>,
    /// People's answers to alerts.
    pub annunciator: Kept<Annunciator>,
    /// What the commander before this node publishes.
    pub before: Before,
    /// The alerts as people receive them; `None` while another node publishes for this telescope.
    pub alerts: watch::Sender<Option<Alerts>>,
    /// Frames announced and stored.
    pub ledger: Ledger,
    /// The facts of frames as published.
    pub facts: Telling,
    /// What the newest frames showed, for the tasks that act on it.
    pub looks: Looks,
    /// The darks that are taken off frames before they are measured.
    pub darks: Darks,
    /// The star catalogue, once it is open.
    pub catalogue: StarCatalogue,
    /// Where the mounts pointed lately.
    pub mounts: Mounts,
    /// What solved frames taught.
    pub optics: Kept<OpticsState>,
    /// The looked-up names of targets.
    pub names: watch::Sender<Known>,
    /// The published state of the pointing.
    pub pointing: watch::Sender<PointingState>,
    /// The learned pointing models.
    pub pointing_book: Kept<Book>,
    /// The published state of the guide loop.
    pub guiding: watch::Sender<GuidingState>,
    /// What guiding has learned and stores.
    pub guide_learnt: Kept<Learnt>,
    /// The publisher of the guiding's corrections.
    pub corrections: OnceCell<Publisher<Correction>>,
    /// The published state of the focus.
    pub focus: watch::Sender<FocusState>,
    /// What focus runs have taught.
    pub focus_learnt: Kept<crate::focus::Learnt>,
    /// Takes the runs that have ended, to publish them.
    pub focus_runs: mpsc::UnboundedSender<FocusRun>,
    /// The site's own script.
    pub hooks: Hooks,
    /// The published state of the night.
    pub board: Board,
    /// This node was asked to end and nobody takes over.
    pub leaves_alone: AtomicBool,
    /// People's orders and their outcomes.
    pub audit: Audit,
}

impl ControlRoom {
    /// Records in the audit log why everything is closed; the device nodes record the commands that follow from it.
    pub fn note_closing(&self, why: &str) {
        self.audit.note(Entry {
            from: self.node.signature(),
            id: CommandId::default(),
            device: String::new(),
            verb: "closing".to_owned(),
            parameters: String::new(),
            token: self.hold.borrow().token(),
            reason: why.to_owned(),
            outcome: Outcome::Accepted,
        });
    }

    /// The key of a state of this observatory.
    pub fn key(&self, part: Part) -> Key {
        Key::Observatory(self.node.config.address(), part)
    }

    /// Is the sky safe, as judged within the last seconds?
    pub fn is_safe(&self) -> bool {
        self.ruling.borrow().is_safe(self.node.bus.clock().machine())
    }

    /// Does the safety loop judge, whatever its verdict? A loop that hangs publishes nothing new.
    pub fn is_judging(&self) -> bool {
        self.ruling.borrow().is_fresh(self.node.bus.clock().machine())
    }

    /// A standby publishes nothing, nor does a node that may turn out to be one: one writer per key.
    pub fn may_speak(&self) -> bool {
        match *self.hold.borrow() {
            Hold::Claiming | Hold::Holding { .. } => true,
            Hold::Asking | Hold::Standby => false,
        }
    }

    /// The objection to a row's action, or to any action if there is no row.
    pub fn objection(&self, row: Option<&Row>) -> Option<Objection> {
        // A row that began now would open again what is closed before the end.
        if self.node.ending.is_stopped() {
            return Some(Objection::Ending);
        }
        let commands = self.hold.borrow().token().is_some();
        let needs_safe = row.is_some_and(|row| row.action.needs().safe);
        stands_against(*self.robotic.borrow(), commands, needs_safe, || {
            let clock = self.node.bus.clock();
            let azimuth_deg = || row?.action.azimuth_deg(&self.observer(clock.utc()).ok()?);
            sky_stands_against(&self.ruling.borrow(), clock.machine(), azimuth_deg)
        })
    }

    /// The sky over this site at an instant.
    pub fn observer(&self, at: Utc) -> Result<Observer, SkyError> {
        let (place, orientation) = self.site()?;
        Observer::new(&place, &orientation, at)
    }

    /// Where this site is, on an Earth that turns as it does.
    pub fn site(&self) -> Result<(Place, EarthOrientation), SkyError> {
        self.node.config.place.on_earth()
    }

    /// Waits until there is an objection to a row's action.
    pub async fn objected(&self, row: &Row) -> Objection {
        let (mut ruling, mut hold, mut robotic) = (self.ruling.clone(), self.hold.clone(), self.robotic.subscribe());
        loop {
            if let Some(objection) = self.objection(Some(row)) {
                return objection;
            }
            // The timer is for a verdict that grows old because nothing renews it.
            tokio::select! {
                _ = ruling.changed() => {}
                _ = hold.changed() => {}
                _ = robotic.changed() => {}
                () = tokio::time::sleep(Duration::from_secs(1)) => {}
            }
        }
    }

    /// Goes on without a device that failed, where the policy for its kind allows it.
    pub fn or_without(&self, done: Result<(), Trouble>) -> Result<(), Trouble> {
        let policy = |kind| self.node.config.faults.policy(kind);
        match done {
            Err(trouble) if trouble.kind().map(policy) == Some(FaultPolicy::Without) => {
                tracing::warn!(%trouble, "going on without it");
                Ok(())
            }
            done => done,
        }
    }

    /// Requests that everything be closed, and waits until it is verified closed.
    pub async fn close(&self, why: &str) {
        self.wish_closed.send_replace(Some(why.to_owned()));
        let mut wish = self.wish_closed.subscribe();
        // The sender lives in self, so waiting cannot fail.
        let _ = wish.wait_for(Option::is_none).await;
    }
}
