//! Whether this node may act: the verdict, the lease, the robotic switch, and the request to close.

use std::time::Duration;

use audit::{Audit, Entry};
use config::FaultPolicy;
use contract::audit::AuditOutcome;
use contract::device::dome::Shutter;
use contract::{CommandId, Key, Part};
use node::Node;
use safety::current_verdict::CurrentVerdict;
use safety::objection::{Objection, keeps_shut, sky_stands_against, stands_against};
use schedule::Row;
use sky::{EarthOrientation, Observer, Place, SkyError};
use tokio::sync::watch;
use units::Utc;

use crate::action_error::ActionError;
use crate::hold::Hold;

/// Looks at the shutters of all domes.
pub type Shutters = Box<dyn Fn() -> Vec<Option<Shutter>> + Send + Sync>;

/// The node with all that permits it to act, or forbids it.
pub struct Authority {
    /// Configuration, bus, alerts.
    pub node: Node,
    /// The newest verdict.
    pub verdict: watch::Receiver<CurrentVerdict>,
    /// The lease.
    pub hold: watch::Receiver<Hold>,
    /// The robotic switch.
    pub robotic: watch::Sender<bool>,
    /// Why everything should be closed although the sky is safe; `None` once it is verified closed.
    pub close_request: watch::Sender<Option<String>>,
    /// People's orders and their outcomes.
    pub audit: Audit,
    /// How the shutters of all domes are, as far as known now.
    pub shutters: Shutters,
}

impl Authority {
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
            outcome: AuditOutcome::Accepted,
        });
    }

    /// The key of a state of this observatory.
    pub fn key(&self, part: Part) -> Key {
        Key::Observatory(self.node.config.address(), part)
    }

    /// Is the sky safe, as judged within the last seconds?
    pub fn is_safe(&self) -> bool {
        self.verdict.borrow().is_safe(self.node.bus.clock().machine())
    }

    /// Does the safety loop judge, whatever its verdict? A loop that hangs publishes nothing new.
    pub fn is_judging(&self) -> bool {
        self.verdict.borrow().is_fresh(self.node.bus.clock().machine())
    }

    /// Does this node publish for the telescope?
    pub fn is_publishing(&self) -> bool {
        self.hold.borrow().may_publish()
    }

    /// Why no shut dome is opened for a dwell although the sky is safe; see [`keeps_shut`].
    pub fn kept_shut(&self, begins: bool) -> Option<Objection> {
        keeps_shut(&self.verdict.borrow(), begins, (self.shutters)())
    }

    /// The objection to a row that is to begin: in its place others do, and it does not wait for its opening.
    pub fn objection_to_begin(&self, row: &Row) -> Option<Objection> {
        self.objection(Some(row)).or_else(|| self.kept_shut(true).filter(|_| row.action.needs().opens()))
    }

    /// The objection to the action of a row at work, or to any action if there is no row.
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
            let sky = sky_stands_against(&self.verdict.borrow(), clock.machine(), azimuth_deg);
            sky.or_else(|| self.kept_shut(false).filter(|_| row.is_some_and(|row| row.action.needs().opens())))
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

    /// The time that it surely is at an instant of the clock: earlier, where another clock says that this one is ahead. A
    /// window has passed only once it surely has.
    pub fn surely(&self, now: Utc) -> Utc {
        now.plus_seconds(-self.verdict.borrow().ahead_s)
    }

    /// Waits until there is an objection to a row's action.
    pub async fn objected(&self, row: &Row) -> Objection {
        let (mut verdict, mut hold, mut robotic) = (self.verdict.clone(), self.hold.clone(), self.robotic.subscribe());
        loop {
            if let Some(objection) = self.objection(Some(row)) {
                return objection;
            }
            // The timer is for a verdict that grows old because nothing renews it.
            tokio::select! {
                _ = verdict.changed() => {}
                _ = hold.changed() => {}
                _ = robotic.changed() => {}
                () = tokio::time::sleep(Duration::from_secs(1)) => {}
            }
        }
    }

    /// Goes on without a device that failed, where the policy for its kind allows it.
    pub fn or_without(&self, done: Result<(), ActionError>) -> Result<(), ActionError> {
        let policy = |kind| self.node.config.faults.policy(kind);
        match done {
            Err(error) if error.kind().map(policy) == Some(FaultPolicy::Without) => {
                tracing::warn!(%error, "going on without it");
                Ok(())
            }
            done => done,
        }
    }

    /// Requests that everything be closed, and waits until it is verified closed.
    pub async fn close(&self, why: &str) {
        self.close_request.send_replace(Some(why.to_owned()));
        let mut request = self.close_request.subscribe();
        // The sender lives in self, so waiting cannot fail.
        let _ = request.wait_for(Option::is_none).await;
    }
}
