//! What all tasks of the node share: the devices, the verdict, the lease, and the switches that people turn.

use std::sync::Arc;
use std::time::Duration;

use audit::{Audit, Entry};
use bus::Node;
use config::FaultPolicy;
use contract::audit::Outcome;
use contract::observatory::{Alerts, Sector};
use contract::{CommandId, Key, Name, Part};
use sky::{EarthOrientation, Icrs, Observer, Place, SkyError};
use tokio::sync::{Notify, watch};
use units::{Angle, Utc};

use crate::action::AnyAction;
use crate::annunciator::Annunciator;
use crate::journal::Journal;
use crate::lease::Hold;
use crate::ledger::Ledger;
use crate::night::Board;
use crate::rig::Rig;
use crate::safety::Ruling;
use crate::safety::rules::Rules;
use crate::schedule::Row;
use crate::standing::Standing;
use crate::trouble::Trouble;

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
    /// Said when a device knows a newer token than ours.
    pub doubt: Arc<Notify>,
    /// The robotic switch.
    pub robotic: watch::Sender<bool>,
    /// Why everything should be closed although the sky is safe; `None` once it is verified closed.
    pub wish_closed: watch::Sender<Option<String>>,
    /// Where a row is about to point a mount, or points it.
    pub aim: watch::Sender<Option<(Name, Icrs)>>,
    /// Counts orders to read the schedule again.
    pub reload: watch::Sender<u64>,
    /// What was begun and finished, on disk.
    pub journal: Journal,
    /// What the verdict rests on.
    pub rules: Arc<Rules>,
    /// What people have ordered of the verdict.
    pub standing: watch::Sender<Standing>,
    /// Those of them that are on disk, as this life knows.
    pub standing_on_disk: watch::Sender<Standing>,
    /// What people have done about alerts.
    pub annunciator: watch::Sender<Annunciator>,
    /// The alerts as people are to hear of them; `None` while another node speaks for this telescope.
    pub alerts: watch::Sender<Option<Alerts>>,
    /// Frames announced and stored.
    pub ledger: Ledger,
    /// What is shown of the night.
    pub board: Board,
    /// What people ordered, and what became of it.
    pub audit: Audit,
}

/// Why an action may not go on.
#[derive(Debug, Clone, PartialEq)]
pub enum Objection {
    /// The sky is not safe.
    Unsafe(String),
    /// Nothing needs to close, but the sky is not to be exposed.
    Suspended(String),
    /// The robotic switch is off.
    NotRobotic,
    /// This node does not command.
    NoLease,
}

impl std::fmt::Display for Objection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Unsafe(why) => write!(f, "not safe: {why}"),
            Self::Suspended(why) => write!(f, "suspended: {why}"),
            Self::NotRobotic => f.write_str("the robotic switch is off"),
            Self::NoLease => f.write_str("this node does not command"),
        }
    }
}

impl ControlRoom {
    /// Tells the audit why everything is closed; the commands that follow from it are recorded by the device nodes.
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

    /// Does the safety loop judge? Whatever it says: a loop that hangs says nothing new.
    pub fn is_judging(&self) -> bool {
        self.ruling.borrow().is_fresh(self.node.bus.clock().machine())
    }

    /// A standby says nothing, nor does a node that may find itself to be one: one writer per key.
    pub fn may_speak(&self) -> bool {
        match *self.hold.borrow() {
            Hold::Claiming | Hold::Holding { .. } => true,
            Hold::Asking | Hold::Standby => false,
        }
    }

    /// What stands against a row's action, or against any where there is none.
    pub fn objection(&self, row: Option<&Row>) -> Option<Objection> {
        if !*self.robotic.borrow() {
            return Some(Objection::NotRobotic);
        }
        if self.hold.borrow().token().is_none() {
            return Some(Objection::NoLease);
        }
        let action = &row.filter(|row| row.action.needs().safe)?.action;
        if !self.is_safe() {
            return Some(Objection::Unsafe(self.ruling.borrow().why()));
        }
        let ruling = self.ruling.borrow();
        ruling.suspension().or_else(|| self.avoided(&ruling.state.avoid, &**action)).map(Objection::Suspended)
    }

    /// Why an action's direction is to be avoided now, if it is.
    fn avoided(&self, sectors: &[Sector], action: &dyn AnyAction) -> Option<String> {
        if sectors.is_empty() {
            return None;
        }
        let sky = self.observer(self.node.bus.clock().utc()).ok()?;
        let azimuth_deg = action.azimuth_deg(&sky)?;
        let sector = sectors.iter().find(|sector| sector.contains(azimuth_deg))?;
        let (why, half_width_deg) = (&sector.why, sector.half_width_deg);
        Some(format!("{why}; azimuth {azimuth_deg:.0} deg is within {half_width_deg:.0} deg of it"))
    }

    /// The sky over this site at an instant.
    pub fn observer(&self, at: Utc) -> Result<Observer, SkyError> {
        let config = &self.node.config.place;
        let (latitude, longitude) = (config.latitude_deg, config.longitude_deg);
        let place = Place::new(Angle::from_degrees(latitude), Angle::from_degrees(longitude), config.elevation_m)?;
        let orientation = EarthOrientation {
            dut1_s: config.dut1_s,
            polar_x_arcsec: config.polar_x_arcsec,
            polar_y_arcsec: config.polar_y_arcsec,
        };
        Observer::new(&place, &orientation, at)
    }

    /// Waits until something stands against a row's action.
    pub async fn objected(&self, row: &Row) -> Objection {
        let (mut ruling, mut hold, mut robotic) = (self.ruling.clone(), self.hold.clone(), self.robotic.subscribe());
        loop {
            if let Some(objection) = self.objection(Some(row)) {
                return objection;
            }
            // the second is for a ruling that grows old because nobody renews it
            tokio::select! {
                _ = ruling.changed() => {}
                _ = hold.changed() => {}
                _ = robotic.changed() => {}
                () = tokio::time::sleep(Duration::from_secs(1)) => {}
            }
        }
    }

    /// Goes on without a device that failed, where the policy for its kind says so.
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

    /// Wishes everything closed, and waits until it is verified closed.
    pub async fn close(&self, why: &str) {
        self.wish_closed.send_replace(Some(why.to_owned()));
        let mut wish = self.wish_closed.subscribe();
        // the sender lives in self, so waiting cannot fail
        let _ = wish.wait_for(Option::is_none).await;
    }
}
