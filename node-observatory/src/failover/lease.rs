//! The lease: asks the arbiter for the right to command, and stands by while somebody else has it.

use std::sync::Arc;
use std::time::Duration;

use bus::{BusError, Clock, Publisher};
use contract::device::{dome, telescope};
use contract::observatory::{AlertKind, Lease};
use contract::{CommandId, Part, Reason};
use interlock::{
    ClaimAnswer, ClaimNote, LeaseAlert, LeaseEvent, LeaseHolder, LeaseKnown, LeaseState, LeaseStep, LeaseTask,
    PublishedLease,
};
use tokio::sync::{Notify, watch};
use units::Utc;

use super::claim_note;
use super::takeover::{self, Takeover};
use crate::action_error::ActionError;
use crate::authority::Authority;
use crate::devices::Devices;
use crate::devices::dome::Dome;
use crate::hold::Hold;

/// A commander publishes its lease every second.
const RIVAL: Duration = Duration::from_secs(5);

/// If an older node of this very name publishes within this time, this node leaves before it claims: the arbiter
/// would give the lease to one of them alone, but perhaps to the one that leaves. This delays no restart: the arbiter
/// waits 5 s for the incarnation before.
const TWIN: Duration = Duration::from_secs(3);

/// The publisher of the lease.
#[derive(Clone)]
pub struct LeasePublisher(Arc<Publisher<Lease>>);

impl LeasePublisher {
    /// Publishes nothing yet.
    pub async fn open(authority: &Authority) -> Result<Self, BusError> {
        let line = authority.node.bus.publisher(&authority.key(Part::Lease)).await?;
        Ok(Self(Arc::new(line)))
    }

    async fn publish(&self, arbiter: String, holder: String, token: u64, since_utc: Utc) {
        let body = Lease { holder, token, since_utc, arbiter };
        if let Err(error) = self.0.put(body).await {
            tracing::warn!(%error, "the lease was not published");
        }
    }

    /// Gives the lease back, if this node has it: the next one is granted it at once.
    pub async fn release(&self, authority: &Authority, devices: &Devices) {
        let hold = authority.hold.borrow().clone();
        if let Hold::Holding { token, .. } = hold {
            self.publish(arbiter(devices), String::new(), token, authority.node.bus.clock().utc()).await;
            tracing::info!(token, "the lease is released");
        }
    }
}

/// What the lease is claimed with.
pub struct Claimant {
    /// Whether this node may act.
    pub authority: Arc<Authority>,
    /// The devices, of which one is the arbiter.
    pub devices: Arc<Devices>,
    /// Notified when a device knows a newer token than ours.
    pub doubt: Arc<Notify>,
    /// What is learned before this node commands.
    pub takeover: Takeover,
}

/// Claims for ever, once a second; a lease that is held is kept until the arbiter shows a higher token.
/// `interlock::LeaseHolder` decides.
pub async fn keep_holding(claimant: Claimant, hold: watch::Sender<Hold>, lease: LeasePublisher) -> anyhow::Result<()> {
    let (authority, devices) = (&claimant.authority, &claimant.devices);
    let newest = authority.node.bus.latest::<Lease>(&authority.key(Part::Lease)).await?;
    let has_arbiter = !(devices.domes.is_empty() && devices.mounts.is_empty());
    tokio::time::sleep(TWIN).await;
    let clock = authority.node.bus.clock().clone();
    let file = claim_note::path(&authority.node.config, &authority.node.id);
    let note = ClaimNote::new(claim_note::read(&file).await);
    let own = (authority.node.signature(), authority.node.bus.boot_id().clone());
    let mut holder = LeaseHolder::new(own, has_arbiter, note, CommandId::fresh(), clock.machine());
    let mut event = LeaseEvent::Due;
    let mut why = String::new();
    loop {
        let was_granted = matches!(event, LeaseEvent::Answered(ClaimAnswer::Granted(_)));
        let published = newest.fresh(RIVAL).map(|received| received.sample);
        let published = published.as_ref();
        let published = published.map(|lease| PublishedLease { holder: &lease.body.holder, boot_id: &lease.boot_id });
        let LeaseStep { alert, task } = holder.next(event, published, CommandId::fresh(), clock.machine());
        if was_granted && !matches!(task, LeaseTask::TakeOver { .. }) {
            tracing::info!("the incarnation before was ended as it was granted the lease; asking again");
        }
        if let Some(alert) = alert {
            show(&claimant, alert, &why);
        }
        update(&hold, holder.state(), clock.utc(), &why);
        event = match task {
            LeaseTask::Note(noted) => LeaseEvent::Noted(claim_note::write(&file, noted).await),
            LeaseTask::Claim(id) => {
                let shows = holder.held().max(claimant.takeover.orders.orders.get().token);
                let answer = claim(devices, &id, shows).await;
                why = answer.as_ref().err().map(ActionError::to_string).unwrap_or_default();
                LeaseEvent::Answered(answer_of(&answer))
            }
            LeaseTask::TakeOver { granted, held, unused } => {
                takeover::learn(&claimant.takeover, granted, held, &unused).await;
                LeaseEvent::TookOver
            }
            LeaseTask::RemoveNote => LeaseEvent::NoteRemoved(claim_note::remove(&file).await),
            LeaseTask::Publish(token) => publish(&claimant, &hold, token, &lease, &clock).await,
            LeaseTask::Wait => {
                tokio::time::sleep(Duration::from_secs(1)).await;
                LeaseEvent::Due
            }
        };
    }
}

/// Shows the others of this node whether it has the lease.
fn update(hold: &watch::Sender<Hold>, state: LeaseState, now: Utc, why: &str) {
    let is_new = hold.send_if_modified(|hold| {
        let next = match state {
            LeaseState::Asking => Hold::Asking,
            LeaseState::Claiming => Hold::Claiming,
            LeaseState::Standby => Hold::Standby,
            LeaseState::Holding { token } if hold.token() == Some(token) => return false,
            LeaseState::Holding { token } => Hold::Holding { token, since_utc: now },
        };
        std::mem::replace(hold, next.clone()) != next
    });
    match state {
        _ if !is_new => {}
        LeaseState::Asking => tracing::warn!("the lease is in doubt; asking again"),
        // As at each start.
        LeaseState::Claiming if why.is_empty() => tracing::info!("nobody is known to command; this node asks to"),
        LeaseState::Claiming => tracing::warn!(why, "nobody is known to command"),
        LeaseState::Standby => tracing::info!(why, "standing by: somebody else commands"),
        LeaseState::Holding { token } => tracing::info!(token, "this node commands"),
    }
}

fn show(claimant: &Claimant, alert: LeaseAlert, why: &str) {
    let Claimant { authority, devices, .. } = claimant;
    let alerts = &authority.node.alerts;
    let dome = dome(devices).map(|dome| dome.instrument.device.name.as_str()).unwrap_or_default();
    match alert {
        LeaseAlert::NoLease(true) => {
            alerts.raise(AlertKind::NoLease, "", &format!("{} grants no lease: {why}", arbiter(devices)));
        }
        LeaseAlert::NoLease(false) => alerts.clear(AlertKind::NoLease, ""),
        LeaseAlert::Disputed(true) => {
            let token = authority.hold.borrow().token().unwrap_or_default();
            let cause = format!(
                "two programs publish in the name of the guard of {dome}: one knows the lease {token} of this node, one a newer"
            );
            alerts.raise(AlertKind::Impostor, format!("guard/{dome}"), &cause);
        }
        LeaseAlert::Disputed(false) => alerts.clear(AlertKind::Impostor, format!("guard/{dome}")),
    }
}

/// The dome whose node grants the lease, where there is one.
fn dome(devices: &Devices) -> Option<&Dome> {
    devices.domes.first()
}

/// The device whose node grants the lease, as `Lease::arbiter` names it.
fn arbiter(devices: &Devices) -> String {
    let dome = dome(devices).map(|dome| &dome.instrument.device);
    let device = dome.or_else(|| devices.mounts.first().map(|mount| &mount.instrument.device));
    device.map_or_else(|| "nobody".to_owned(), |device| format!("{}/{}", device.kind, device.name))
}

/// `shows`: the newest token that this node remembers.
async fn claim(devices: &Devices, id: &CommandId, shows: Option<u64>) -> Result<u64, ActionError> {
    let granted = match (dome(devices), devices.mounts.first()) {
        (Some(dome), _) => dome.instrument.claim_as(id.clone(), dome::Command::Claim, shows).await?,
        (None, Some(mount)) => mount.instrument.claim_as(id.clone(), telescope::Command::Claim, shows).await?,
        // Nothing moves and nothing opens: there is nobody to contend with.
        (None, None) => Some(1),
    };
    granted.ok_or_else(|| ActionError::Impossible(format!("{} answered a claim without a token", arbiter(devices))))
}

fn answer_of(answer: &Result<u64, ActionError>) -> ClaimAnswer {
    match answer {
        Ok(token) => ClaimAnswer::Granted(*token),
        Err(ActionError::Refused { reason: Reason::LeaseHeld, .. }) => ClaimAnswer::Held,
        Err(ActionError::Refused { .. }) => ClaimAnswer::Refused,
        Err(_) => ClaimAnswer::Silent,
    }
}

/// Publishes the lease, waits for a second, and looks what the arbiter's guard publishes of it; or a device refuses our
/// token as old.
async fn publish(
    claimant: &Claimant,
    hold: &watch::Sender<Hold>,
    token: u64,
    lease: &LeasePublisher,
    clock: &Clock,
) -> LeaseEvent {
    let Claimant { authority, devices, doubt, .. } = claimant;
    let since_utc = match *hold.borrow() {
        Hold::Holding { since_utc, .. } => Some(since_utc),
        Hold::Asking | Hold::Claiming | Hold::Standby => None,
    };
    if let Some(since_utc) = since_utc {
        lease.publish(arbiter(devices), authority.node.signature(), token, since_utc).await;
    }
    tokio::select! {
        () = clock.tick(Duration::from_secs(1)) => {}
        () = doubt.notified() => return LeaseEvent::Doubted,
    }
    let telescope = authority.node.config.place.telescope.as_str();
    let known = |dome: &Dome| LeaseKnown::of(&dome.guards.living(clock.machine()), telescope, token);
    LeaseEvent::Published(dome(devices).map(known))
}
