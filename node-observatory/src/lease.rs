//! The lease: asks the arbiter for the right to command, and stands by while somebody else has it.

use std::sync::Arc;
use std::time::Duration;

use bus::{BusError, Clock, Publisher, Quality};
use contract::device::{dome, telescope};
use contract::observatory::{AlertKind, Lease};
use contract::{CommandId, Part, Reason};
use tokio::sync::watch;
use units::Utc;

use crate::claim_note::{self, ClaimNote};
use crate::control_room::ControlRoom;
use crate::rig::guards::{self, LeaseKnown};
use crate::takeover;
use crate::trouble::Trouble;

/// Whether this node has the lease.
#[derive(Debug, Clone, PartialEq)]
pub enum Hold {
    /// The arbiter was asked and may yet answer that another node commands: nothing is published or done.
    Asking,
    /// The arbiter does not answer; nobody is known to command.
    Claiming,
    /// Somebody else commands and is alive; this node only watches.
    Standby,
    /// This node commands.
    Holding {
        /// The fencing token.
        token: u64,
        /// Since when.
        since_utc: Utc,
    },
}

impl Hold {
    /// The token, while there is one.
    pub fn token(&self) -> Option<u64> {
        match self {
            Self::Holding { token, .. } => Some(*token),
            Self::Asking | Self::Claiming | Self::Standby => None,
        }
    }
}

/// An arbiter that is there answers within this time.
const ASKING: Duration = Duration::from_secs(10);
/// An arbiter that has lost its memory publishes an older lease for good; right after a grant it does so for a moment.
const FORGOTTEN: Duration = Duration::from_secs(5);
/// A commander publishes its lease every second.
const RIVAL: Duration = Duration::from_secs(5);

/// If this node receives from an older node of this very name within this time, it leaves before it claims: the arbiter
/// would give the lease to one of them alone, but perhaps to the one that leaves. This delays no restart: the arbiter
/// waits 5 s for the incarnation before.
const TWIN: Duration = Duration::from_secs(3);

/// The publisher of the lease.
#[derive(Clone)]
pub struct Line(Arc<Publisher<Lease>>);

impl Line {
    /// Publishes nothing yet.
    pub async fn open(room: &ControlRoom) -> Result<Self, BusError> {
        let line = room.node.bus.publisher(&room.key(Part::Lease), Quality::State { cache: 1 }).await?;
        Ok(Self(Arc::new(line)))
    }

    async fn say(&self, room: &ControlRoom, holder: String, token: u64, since_utc: Utc) {
        let body = Lease { holder, token, since_utc, arbiter: arbiter(room) };
        if let Err(error) = self.0.put(body).await {
            tracing::warn!(%error, "the lease was not said");
        }
    }

    /// Gives the lease back, if this node has it: the next one is granted it at once.
    pub async fn release(&self, room: &ControlRoom) {
        let hold = room.hold.borrow().clone();
        if let Hold::Holding { token, .. } = hold {
            self.say(room, String::new(), token, room.node.bus.clock().utc()).await;
            tracing::info!(token, "the lease is released");
        }
    }
}

/// Claims for ever, once a second; a lease that is held is kept until the arbiter shows a higher token.
pub async fn keep_holding(room: Arc<ControlRoom>, hold: watch::Sender<Hold>, lease: Line) -> anyhow::Result<()> {
    let said = room.node.bus.latest::<Lease>(&room.key(Part::Lease)).await?;
    let has_arbiter = !(room.rig.domes.is_empty() && room.rig.mounts.is_empty());
    let mut held = None;
    tokio::time::sleep(TWIN).await;
    let clock = room.node.bus.clock().clone();
    let mut asked_since = clock.machine();
    let mut note = ClaimNote::read(claim_note::path(&room.node.config, &room.node.id)).await;
    let mut left = note.left();
    let mut id = left.clone().unwrap_or_else(CommandId::fresh);
    loop {
        // A living rival refuses; what is refused needs no note.
        let own = [room.node.signature(), String::new()];
        let rival = said.fresh(RIVAL).is_some_and(|lease| !own.contains(&lease.said.body.holder));
        if !rival {
            note.asks(&id).await;
        }
        match claim(&room, &id).await {
            Ok(token) if left.take().is_some() => {
                tracing::info!(token, "the life before was ended as it was granted the lease; asking again");
                note.was_granted(token);
                id = CommandId::fresh();
                continue;
            }
            Ok(token) => {
                tracing::info!(token, arbiter = %arbiter(&room), "this node commands");
                takeover::learn(&room, has_arbiter.then_some(token), held, note.unused()).await;
                held = Some(token);
                if !note.is_taken_back().await {
                    id = CommandId::fresh();
                    continue;
                }
                room.node.alerts.clear(AlertKind::NoLease, "");
                hold.send_replace(Hold::Holding { token, since_utc: clock.utc() });
                until_lost(&room, token, &lease, &clock).await;
                tracing::warn!(token, "the lease is in doubt; asking again");
                hold.send_replace(Hold::Asking);
                (asked_since, id) = (clock.machine(), CommandId::fresh());
                continue;
            }
            Err(Trouble::Refused { reason: Reason::LeaseHeld, detail, .. }) => {
                if *hold.borrow() != Hold::Standby {
                    tracing::info!(detail, "standing by: somebody else commands");
                    hold.send_replace(Hold::Standby);
                }
                room.node.alerts.clear(AlertKind::NoLease, "");
                (asked_since, id, left) = (clock.machine(), CommandId::fresh(), None);
            }
            Err(trouble) => {
                let silent_for = clock.machine().since(asked_since);
                // Another node may command although the arbiter cannot answer just now.
                let rival = said.fresh(RIVAL).is_some_and(|lease| lease.said.boot_id != *room.node.bus.boot_id());
                hold.send_if_modified(|hold| {
                    let waits = *hold != Hold::Claiming && (rival || silent_for < ASKING);
                    !waits && std::mem::replace(hold, Hold::Claiming) != Hold::Claiming
                });
                // A refusal is an answer; after silence the same claim is asked again.
                if matches!(trouble, Trouble::Refused { .. }) {
                    (id, left) = (CommandId::fresh(), None);
                }
                if silent_for > Duration::from_secs(30) {
                    no_lease(&room, &trouble);
                }
            }
        }
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
}

fn no_lease(room: &ControlRoom, trouble: &Trouble) {
    let cause = format!("{} grants no lease: {trouble}", arbiter(room));
    room.node.alerts.raise(AlertKind::NoLease, "", &cause);
}

/// The device whose node grants the lease, as `Lease::arbiter` names it.
fn arbiter(room: &ControlRoom) -> String {
    let rig = &room.rig;
    let dome = rig.domes.first().map(|dome| &dome.instrument.device);
    let device = dome.or_else(|| rig.mounts.first().map(|mount| &mount.instrument.device));
    device.map_or_else(|| "nobody".to_owned(), |device| format!("{}/{}", device.kind, device.name))
}

async fn claim(room: &ControlRoom, id: &CommandId) -> Result<u64, Trouble> {
    let granted = match (room.rig.domes.first(), room.rig.mounts.first()) {
        (Some(dome), _) => dome.instrument.claim_as(id.clone(), dome::Command::Claim).await?,
        (None, Some(mount)) => mount.instrument.claim_as(id.clone(), telescope::Command::Claim).await?,
        // Nothing moves and nothing opens: there is nobody to contend with.
        (None, None) => Some(1),
    };
    granted.ok_or_else(|| Trouble::Impossible(format!("{} answered a claim without a token", arbiter(room))))
}

/// Publishes the lease every second until the arbiter's guard publishes a newer one, or forgets it, or a device refuses
/// our token as old.
async fn until_lost(room: &ControlRoom, token: u64, lease: &Line, clock: &Clock) {
    let since_utc = clock.utc();
    let telescope = room.node.config.place.telescope.as_str();
    let dome = room.rig.domes.first();
    let mut unknown_since = None;
    let mut disputed = false;
    loop {
        lease.say(room, room.node.signature(), token, since_utc).await;
        tokio::select! {
            () = clock.tick(Duration::from_secs(1)) => {}
            () = room.doubt.notified() => return,
        }
        let Some(dome) = dome else { continue };
        let now = clock.machine();
        let found = guards::standing(&dome.guards.living(now), telescope, token);
        let unknown = unknown_since.filter(|_| found == LeaseKnown::Unknown);
        unknown_since = (found == LeaseKnown::Unknown).then(|| unknown.unwrap_or(now));
        let is_forgotten = unknown_since.is_some_and(|since| now.since(since) >= FORGOTTEN);
        if found == LeaseKnown::Lost || is_forgotten {
            return;
        }
        let instance = format!("guard/{}", dome.instrument.device.name);
        match found {
            LeaseKnown::Disputed if !disputed => {
                let cause = format!(
                    "two programs publish in the name of the guard of {}: one knows the lease {token} of this node, one a newer",
                    dome.instrument.device.name
                );
                room.node.alerts.raise(AlertKind::Impostor, &instance, &cause);
                disputed = true;
            }
            LeaseKnown::Ours | LeaseKnown::Unknown if disputed => {
                room.node.alerts.clear(AlertKind::Impostor, &instance);
                disputed = false;
            }
            LeaseKnown::Ours | LeaseKnown::Unknown | LeaseKnown::Disputed | LeaseKnown::Lost => {}
        }
    }
}
