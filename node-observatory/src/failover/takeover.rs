//! What a node learns when it becomes the commander: what the one before it did, and what people ordered meanwhile.

use std::collections::BTreeSet;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use bus::{Bus, BusError, Latest, Received};
use contract::observatory::{AlertKind, Alerts, NightState, OperatorOrders};
use contract::{Address, Key, Part, Payload};
use interlock::takeover::{are_last_orders, last_order, switch_after};
use node::NodeAlerts;
use safety::active_orders::ActiveOrders;
use safety::on_disk::OnDisk;
use safety::ordered_by::OrderedBy;
use safety::takeover::{Known, Source, Word};
use units::{Utc, seconds};

use crate::active_orders::OrderState;
use crate::authority::Authority;
use crate::journal::Journal;
use crate::persisted::{Persisted, answer_within, replaced};
use crate::{active_orders, annunciator, robotic as switch};

/// A disk that hangs keeps nobody from commanding.
const DISK: Duration = Duration::from_secs(2);
/// One that takes the orders within this was slow; later, it may have lost what was ordered before.
const SLOW_DISK: Duration = Duration::from_secs(60);
/// A verdict that is not renewed for so long no longer counts as safe.
const VERDICT_WITHIN: Duration = Duration::from_secs(5);

/// What the commander before publishes.
pub struct FormerCommander {
    /// Its state of the night.
    pub night: Latest<NightState>,
    /// What people ordered of it.
    pub orders: Latest<OperatorOrders>,
    /// The alerts with what people did about them.
    pub alerts: Latest<Alerts>,
}

impl FormerCommander {
    /// Subscribes, so that its last state is known.
    pub async fn listen(bus: &Bus, address: &Address) -> Result<Self, BusError> {
        let key = |part| Key::Observatory(address.clone(), part);
        Ok(Self {
            night: bus.latest(&key(Part::Night)).await?,
            orders: bus.latest(&key(Part::OperatorOrders)).await?,
            alerts: bus.latest(&key(Part::Alerts)).await?,
        })
    }
}

/// What a node that becomes the commander learns with.
pub struct Takeover {
    /// Whether this node may act.
    pub authority: Arc<Authority>,
    /// The journal.
    pub journal: Arc<Journal>,
    /// What people ordered.
    pub orders: Arc<OrderState>,
    /// What the commander before publishes.
    pub before: FormerCommander,
}

/// The robotic switch as it was last ordered, else as configured.
pub fn robotic(journal: &Journal, configured: bool, now: Utc) -> bool {
    interlock::takeover::ordered_switch(journal.last_robotic(), configured, now)
}

/// Learns it all, before this node commands with the token that it was granted. `held` is the token that this
/// incarnation held before; with `unused` tokens nobody commanded. A disk that fails is reported, and prevents nobody
/// from commanding: a node that commands can close.
pub async fn learn(takeover: &Takeover, granted: Option<u64>, held: Option<u64>, unused: &BTreeSet<u64>) {
    let disk = read(takeover).await;
    let now = takeover.authority.node.bus.clock().utc();
    let own = takeover.orders.orders.get();
    let received = foreign(takeover, &takeover.before.orders);
    let orders = received.as_ref().map(|received| ActiveOrders::from(&received.sample.body));
    let machine_now = takeover.authority.node.bus.clock().machine();
    let is_last = received.as_ref().is_some_and(|received| are_last_orders(received.arrived, machine_now));
    let word = orders.as_ref().map(|orders| Word { orders, is_last });
    let known = Known { granted, own: &own, held, unused, disk: &disk, received: word };
    let (mut active_orders, source) = known.take_over(now);
    if source == Source::Nobody {
        tracing::warn!(?granted, "what the commander before was ordered is not known; the dome stays closed");
    }
    learn_alerts(takeover, source, received.as_ref()).await;
    put(takeover, &active_orders);
    doubt_by_disk(takeover, source, &mut active_orders, now).await;
    if !active_orders.has_same_orders(&own) {
        judged_anew(takeover).await;
    }
    learn_robotic(takeover, now);
}

/// Writes the adopted orders. Where the disk that they are from does not take them, they stay closed: for good if it
/// fails, until it takes them if it is slow.
async fn doubt_by_disk(takeover: &Takeover, source: Source, active_orders: &mut ActiveOrders, now: Utc) {
    let orders = &takeover.orders.orders;
    let (is_slow, error) = match tokio::time::timeout(DISK, orders.write()).await {
        Ok(Ok(())) => return,
        Ok(Err(error)) => (false, error.to_string()),
        Err(_) => {
            let (soon, late) = (DISK.as_secs(), SLOW_DISK.as_secs());
            (true, format!("no answer within {soon} s (if it takes them within {late} s, this ends by itself)"))
        }
    };
    let cause = format!("the operator orders are not on disk: {error}");
    takeover.authority.node.alerts.raise(AlertKind::OperatorOrders, "", &cause);
    if source.is_doubted_by_disk(active_orders, &cause, now) {
        put(takeover, active_orders);
        let doubt = active_orders.stay_closed.clone();
        if is_slow {
            tokio::spawn(end_doubt(orders.clone(), doubt, SLOW_DISK));
        }
    }
}

/// Takes back that the dome stays closed for a `doubt` about the disk, once that has taken the orders
/// in time.
async fn end_doubt(orders: Arc<Persisted<ActiveOrders>>, doubt: Option<OrderedBy>, within: Duration) {
    if !matches!(tokio::time::timeout(within, orders.write()).await, Ok(Ok(()))) {
        return;
    }
    orders.change(|known| {
        let is_doubted = known.stay_closed == doubt;
        if is_doubted {
            known.stay_closed = None;
            tracing::info!("the disk was slow and has the operator orders now: they no longer stay closed for it");
        }
        is_doubted
    });
}

fn put(takeover: &Takeover, orders: &ActiveOrders) {
    takeover.orders.orders.change(|known| replaced(known, orders));
}

/// The orders in the folder; makes the journal this node's. Each is waited for by itself: the journal is written anew,
/// and a disk may answer slowly to that alone.
async fn read(takeover: &Takeover) -> OnDisk {
    let node = &takeover.authority.node;
    let orders = read_orders(active_orders::path(&node.config), DISK);
    let (authority, journal) = (takeover.authority.clone(), takeover.journal.clone());
    let known = journal.last_robotic();
    let late = move || {
        if authority.hold.borrow().may_publish() && was_turned_off(known, journal.last_robotic()) {
            let why = "robotic operation had been switched off, which a slow disk tells now";
            switch::turn_off(&authority, &journal, why);
        }
    };
    let (disk, ()) = tokio::join!(orders, take_journal(takeover.journal.clone(), node.alerts.clone(), DISK, late));
    disk
}

async fn read_orders(path: PathBuf, within: Duration) -> OnDisk {
    let file = path.clone();
    let reading = tokio::task::spawn_blocking(move || active_orders::read(&file));
    match tokio::time::timeout(within, reading).await {
        Ok(Ok(disk)) => disk,
        Ok(Err(_)) | Err(_) => {
            let (within_s, path) = (within.as_secs(), path.display());
            OnDisk::Unreadable(format!("the disk did not answer within {within_s} s when {path} was read"))
        }
    }
}

/// Whether a journal that was read late tells of an "off" which this node did not know, maybe another node's. One that it
/// knew was judged already.
fn was_turned_off(known: Option<(Utc, bool)>, read: Option<(Utc, bool)>) -> bool {
    read != known && read.is_some_and(|(_, on)| !on)
}

/// Makes the journal this node's, and waits so long for it. One that the disk takes `late` is this node's then, and its
/// alert ends.
async fn take_journal(
    journal: Arc<Journal>,
    alerts: NodeAlerts,
    within: Duration,
    late: impl FnOnce() + Send + 'static,
) {
    let taking = tokio::task::spawn_blocking(move || journal.take_over());
    let mut told = tokio::spawn(async move {
        let complain = |why: &str| {
            alerts.raise(AlertKind::Journal, "", &format!("the journal cannot be taken over: {why}"));
        };
        match answer_within(within, taking, complain).await.map_err(io::Error::other).and_then(|taken| taken) {
            Ok(()) => alerts.clear(AlertKind::Journal, ""),
            Err(error) => {
                complain(&error.to_string());
                return false;
            }
        }
        true
    });
    // A disk that is slow keeps nobody from commanding.
    if tokio::time::timeout(within, &mut told).await.is_err() {
        tokio::spawn(async move {
            if told.await.is_ok_and(|taken| taken) {
                late();
            }
        });
    }
}

/// The last payload of another incarnation than this one.
fn foreign<T: Payload + Clone>(takeover: &Takeover, latest: &Latest<T>) -> Option<Received<T>> {
    latest.get().filter(|received| received.sample.boot_id != *takeover.authority.node.bus.boot_id())
}

/// People's answers to alerts, from the source of the orders: a record of an earlier commander would acknowledge what
/// it never saw. An alert that no record has is new.
async fn learn_alerts(takeover: &Takeover, source: Source, orders: Option<&Received<OperatorOrders>>) {
    match source {
        Source::Own => {}
        Source::Disk => {
            let path = annunciator::path(&takeover.authority.node.config);
            let reading = tokio::task::spawn_blocking(move || annunciator::read(&path));
            if let Ok(Ok(read)) = tokio::time::timeout(DISK, reading).await {
                takeover.orders.annunciator.adopt(|known| {
                    *known = read;
                    true
                });
            }
        }
        Source::Bus | Source::Nobody => {
            let alerts = foreign(takeover, &takeover.before.alerts).map(|received| received.sample);
            let received = source.answers_to_alerts(orders.map(|received| &received.sample), alerts.as_ref());
            takeover.orders.annunciator.change(|known| {
                *known = received;
                true
            });
        }
    }
}

/// Waits until the safety loop has judged by the orders as they are now; a loop that does not is not safe by then.
async fn judged_anew(takeover: &Takeover) {
    let mut verdict = takeover.authority.verdict.clone();
    let twice = async {
        // The first may have been under way.
        for _ in 0..2 {
            let since = takeover.authority.node.bus.clock().machine();
            if verdict.wait_for(|verdict| verdict.judged > since).await.is_err() {
                return;
            }
        }
    };
    let _ = tokio::time::timeout(VERDICT_WITHIN, twice).await;
}

fn learn_robotic(takeover: &Takeover, now: Utc) {
    let published =
        foreign(takeover, &takeover.before.night).map(|received| (received.sample.body.robotic, received.arrived));
    let clock = takeover.authority.node.bus.clock();
    let off = last_order(takeover.journal.last_robotic(), now).filter(|(_, on)| !on);
    let off_ago = off.map(|(at, _)| clock.machine_duration(seconds(now.seconds_since(at))));
    let own = || robotic(&takeover.journal, *takeover.authority.robotic.borrow(), now);
    let on = switch_after(published, off_ago, clock.machine(), own);
    if takeover.authority.robotic.send_replace(on) != on {
        tracing::info!(on, "the robotic switch stands as it was ordered");
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use bus::Clock;
    use test_support::LIMIT;
    use tokio::time::timeout;

    use super::*;

    /// Whether the dome still stays closed once a write under way and then the one of the orders have ended, or the time
    /// of the disk has; `meanwhile` happens before.
    async fn stays_closed(within: Duration, folder: &Path, meanwhile: impl Fn(&mut ActiveOrders)) -> bool {
        let writer = "main".parse().unwrap();
        let orders = Arc::new(Persisted::new(folder.join("orders.json"), &writer, ActiveOrders::default()));
        let doubt = Some(OrderedBy::by_node("no answer".to_owned(), Utc::from_seconds(1000.0)));
        orders.change(|known| {
            known.stay_closed.clone_from(&doubt);
            true
        });
        let slow = orders.hold_pen().await;
        let ending = tokio::spawn(end_doubt(orders.clone(), doubt, within));
        if within.is_zero() {
            while !ending.is_finished() {
                tokio::task::yield_now().await;
            }
        }
        orders.change(|known| {
            meanwhile(known);
            true
        });
        assert!(orders.get().stay_closed.is_some(), "nothing is taken back before the disk has answered");
        drop(slow);
        ending.await.unwrap();
        orders.get().stay_closed.is_some()
    }

    #[test]
    fn a_journal_that_is_read_late_turns_off_only_by_an_off_that_was_not_known_before() {
        let (off, on) = ((Utc::from_seconds(1000.0), false), (Utc::from_seconds(2000.0), true));
        let later = (Utc::from_seconds(3000.0), false);
        for (known, read, turns) in [
            (None, None, false),
            (None, Some(off), true),
            (Some(off), Some(off), false),
            (Some(off), Some(on), false),
            (Some(on), Some(later), true),
            (Some(off), Some(later), true),
        ] {
            assert_eq!(was_turned_off(known, read), turns, "{known:?}, then {read:?}");
        }
    }

    #[test]
    fn a_disk_that_is_slow_to_write_the_journal_keeps_no_order_from_being_read_and_its_alert_ends_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let journal = Arc::new(Journal::open(&folder.path().join("journal.jsonl")).unwrap());
        let alerts = NodeAlerts::new(Clock::machine_clock());
        let mut shown = alerts.watch();
        let stands = |alerts: &Alerts| alerts.alerts.iter().any(|alert| alert.cause.contains("cannot be taken over"));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        let (taken, late) = tokio::sync::oneshot::channel();
        let slow = journal.hang();
        runtime.block_on(async {
            let late = || taken.send(()).unwrap();
            let taking = take_journal(journal.clone(), alerts.clone(), Duration::ZERO, late);
            let (disk, ()) = tokio::join!(read_orders(folder.path().join("orders.json"), SLOW_DISK), taking);
            assert_eq!(disk, OnDisk::Absent, "the journal is waited for no longer");
            timeout(LIMIT, shown.wait_for(stands)).await.unwrap().unwrap();
        });
        drop(slow);
        runtime.block_on(async {
            timeout(LIMIT, shown.wait_for(|alerts| !stands(alerts))).await.unwrap().unwrap();
            timeout(LIMIT, late).await.expect("what the journal says is looked at when it is there").unwrap();
        });
    }

    #[tokio::test]
    async fn a_slow_disk_costs_its_time_and_one_that_hangs_or_fails_stays_doubted() {
        let folder = tempfile::tempdir().unwrap();
        assert!(!stays_closed(SLOW_DISK, folder.path(), |_| {}).await);
        assert!(stays_closed(Duration::ZERO, folder.path(), |_| {}).await);
        let person = |orders: &mut ActiveOrders| {
            orders.stay_closed = Some(OrderedBy::by_node("a person".to_owned(), Utc::from_seconds(1001.0)));
        };
        assert!(stays_closed(SLOW_DISK, folder.path(), person).await, "what was ordered meanwhile holds");
        std::fs::create_dir(folder.path().join("orders.json.main.part")).unwrap();
        assert!(stays_closed(SLOW_DISK, folder.path(), |_| {}).await, "it fails");
    }
}
