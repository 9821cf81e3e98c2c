//! What a node learns when it becomes the commander: what the one before it did, and what people ordered meanwhile.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use bus::{Bus, BusError, Heard, Latest};
use contract::observatory::{AlertKind, Alerts, NightState, StandingOrders};
use contract::{Address, Key, Part, Payload};
use safety::annunciator::Annunciator;
use safety::inherit::{Known, Source, Word};
use safety::on_disk::OnDisk;
use safety::said::Said;
use safety::standing::Standing;
use units::Utc;

use crate::control_room::ControlRoom;
use crate::journal::Journal;
use crate::{annunciator, standing};

/// An order from last night is no order for this one, sky s.
const ORDER_HOLDS_S: f64 = 18.0 * 3600.0;
/// A commander publishes its state each second; one that is older than this does not count as its last.
const LAST_WORD: Duration = Duration::from_secs(60);
/// It publishes its orders each second, and holds the lease until it was silent for 5 s. If its orders were received
/// within this time, it can hardly have accepted others after them; if not, it may have.
const LAST_ORDERS: Duration = Duration::from_secs(10);
/// A disk that hangs keeps nobody from commanding.
const DISK: Duration = Duration::from_secs(2);
/// A verdict that is not renewed for so long no longer counts as safe.
const RULING: Duration = Duration::from_secs(5);

/// What the commander before publishes.
pub struct Before {
    /// Its state of the night.
    pub night: Latest<NightState>,
    /// What people ordered of it.
    pub standing: Latest<StandingOrders>,
    /// The alerts with what people did about them.
    pub alerts: Latest<Alerts>,
}

impl Before {
    /// Subscribes, so that its last state is known.
    pub async fn listen(bus: &Bus, address: &Address) -> Result<Self, BusError> {
        let key = |part| Key::Observatory(address.clone(), part);
        Ok(Self {
            night: bus.latest(&key(Part::Night)).await?,
            standing: bus.latest(&key(Part::Standing)).await?,
            alerts: bus.latest(&key(Part::Alerts)).await?,
        })
    }
}

/// The robotic switch as it was last ordered, else as configured.
pub fn robotic(journal: &Journal, configured: bool, now: Utc) -> bool {
    match journal.last_robotic() {
        Some((at, on)) if now.seconds_since(at).abs() < ORDER_HOLDS_S => on,
        _ => configured,
    }
}

/// Learns it all, before this node commands with the token that it was granted. `held` is the token that this
/// incarnation held before; with `unused` tokens nobody commanded. A disk that fails is reported, and prevents nobody
/// from commanding: a node that commands can close.
pub async fn learn(room: &Arc<ControlRoom>, granted: Option<u64>, held: Option<u64>, unused: &BTreeSet<u64>) {
    let (disk, is_older_version) = read(room).await;
    let now = room.node.bus.clock().utc();
    let own = room.standing.get();
    let heard = foreign(room, &room.before.standing);
    let orders = heard.as_ref().map(|heard| Standing::from(&heard.said.body));
    let is_last =
        heard.as_ref().is_some_and(|heard| room.node.bus.clock().machine().since(heard.arrived) <= LAST_ORDERS);
    let word = orders.as_ref().map(|orders| Word { orders, is_last });
    let known = Known { granted, own: &own, held, unused, disk: &disk, is_older_version, heard: word };
    let (mut standing, source) = known.inherit(now);
    if source == Source::Nobody {
        tracing::warn!(?granted, "what the commander before was ordered is not known; the dome stays closed");
    }
    learn_alerts(room, source, heard.as_ref()).await;
    put(room, &standing);
    let written = tokio::time::timeout(DISK, room.standing.write()).await.map_err(|_| "no answer".to_owned());
    if let Err(error) = written.and_then(|written| written.map_err(|error| error.to_string())) {
        let cause = format!("the standing orders are not on disk: {error}");
        room.node.alerts.raise(AlertKind::StandingOrders, "", &cause);
        // Such a disk may not have taken the last order of the incarnation before either.
        if source == Source::Disk && standing.stay_closed.is_none() {
            let reason = format!("{cause}; what was ordered last may be lost. Order open-again once the disk is well");
            standing.stay_closed = Some(Said::by_node(reason, now));
            put(room, &standing);
        }
    }
    if !standing.says_as(&own) {
        judged_anew(room).await;
    }
    learn_robotic(room, now);
}

fn put(room: &ControlRoom, standing: &Standing) {
    room.standing.change(|known| {
        let is_new = known != standing;
        known.clone_from(standing);
        is_new
    });
}

/// The content of the folder, and whether a version that wrote no tokens commanded from it; makes the journal this
/// node's.
async fn read(room: &Arc<ControlRoom>) -> (OnDisk, bool) {
    let at = room.clone();
    let reading = tokio::task::spawn_blocking(move || {
        let is_older_version = at.journal.is_there();
        let disk = standing::read(&standing::path(&at.node.config));
        (disk, is_older_version, at.journal.take_over())
    });
    let (disk, is_older_version, taken) = match tokio::time::timeout(DISK, reading).await {
        Ok(Ok(read)) => read,
        Ok(Err(_)) | Err(_) => {
            let why = format!("{} is not answered for by its disk", standing::path(&room.node.config).display());
            (OnDisk::Unreadable(why), false, Err(std::io::ErrorKind::TimedOut.into()))
        }
    };
    match taken {
        Ok(()) => room.node.alerts.clear(AlertKind::Journal, ""),
        Err(error) => {
            let cause = format!("the journal cannot be taken over: {error}");
            room.node.alerts.raise(AlertKind::Journal, "", &cause);
        }
    }
    (disk, is_older_version)
}

/// The last payload of another incarnation than this one.
fn foreign<T: Payload + Clone>(room: &ControlRoom, latest: &Latest<T>) -> Option<Heard<T>> {
    latest.get().filter(|heard| heard.said.boot_id != *room.node.bus.boot_id())
}

/// People's answers to alerts, from the source of the orders: a record of an earlier commander would acknowledge what
/// it never saw. An alert that no record has is new.
async fn learn_alerts(room: &Arc<ControlRoom>, source: Source, orders: Option<&Heard<StandingOrders>>) {
    match source {
        Source::Own => {}
        Source::Disk => {
            let path = annunciator::path(&room.node.config);
            let reading = tokio::task::spawn_blocking(move || annunciator::read(&path));
            if let Ok(Ok(read)) = tokio::time::timeout(DISK, reading).await {
                room.annunciator.adopt(|known| {
                    *known = read;
                    true
                });
            }
        }
        Source::Bus | Source::Nobody => {
            let orders = orders.filter(|_| source == Source::Bus).map(|heard| &heard.said);
            let alerts = foreign(room, &room.before.alerts).map(|heard| heard.said);
            let heard = match (orders, alerts) {
                // Both of one incarnation, or the acknowledgements are not the commander's.
                (Some(orders), Some(alerts)) if orders.boot_id == alerts.boot_id => {
                    Annunciator::heard(&alerts.body, &orders.body.shelved)
                }
                (Some(orders), _) => Annunciator::heard(&Alerts::default(), &orders.body.shelved),
                (None, _) => Annunciator::default(),
            };
            room.annunciator.change(|known| {
                *known = heard;
                true
            });
        }
    }
}

/// Waits until the safety loop has judged by the orders as they are now; a loop that does not is not safe by then.
async fn judged_anew(room: &ControlRoom) {
    let mut ruling = room.ruling.clone();
    let twice = async {
        // The first may have been under way.
        for _ in 0..2 {
            let since = room.node.bus.clock().machine();
            if ruling.wait_for(|ruling| ruling.judged > since).await.is_err() {
                return;
            }
        }
    };
    let _ = tokio::time::timeout(RULING, twice).await;
}

fn learn_robotic(room: &ControlRoom, now: Utc) {
    let age = |heard: &Heard<NightState>| room.node.bus.clock().machine().since(heard.arrived);
    let heard = foreign(room, &room.before.night).filter(|heard| age(heard) <= LAST_WORD);
    // The journal of a commander on another host is not accessible, but its last state is.
    let on = match heard {
        Some(heard) => heard.said.body.robotic,
        None => robotic(&room.journal, *room.robotic.borrow(), now),
    };
    if room.robotic.send_replace(on) != on {
        tracing::info!(on, "the robotic switch stands as it was ordered");
    }
}
