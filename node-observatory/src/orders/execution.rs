//! What a person's order does.
//!
//! An order that closes, or makes the verdict stricter, acts at once, whatever the disk does. Any other that is to
//! survive this node is on disk before it acts, and refused where the disk fails.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use contract::device::camera::Command as Cooler;
use contract::{Accepted, CommandId, Order, OrderKind, Reason, Refusal, Reply};
use safety::active_orders::ActiveOrders;
use safety::annunciator::Annunciator;
use safety::ordered_by::OrderedBy;
use sky::NightDate;
use tokio::sync::watch;

use crate::action_error::ActionError;
use crate::active_orders::OrderState;
use crate::authority::Authority;
use crate::devices::Devices;
use crate::failover::operator_orders;
use crate::hold::Hold;
use crate::journal::Journal;
use crate::orders::rows::OrderedRows;
use crate::persisted::{Persisted, Unchanged};
use crate::robotic;
use crate::schedule_file::versions::Author;
use crate::schedule_file::{self, ScheduleFile};

/// An order that acted at once is answered when the disk has taken or refused it and it is on the bus, or after this.
const SETTLED: Duration = Duration::from_secs(2);

/// A set point that is corrected at once waits so long for the camera to end the one before it; an exposure may last.
const COOLER_TURN: Duration = Duration::from_secs(5);

/// What orders act on.
pub struct Telescope {
    /// Whether this node may act.
    pub authority: Arc<Authority>,
    /// The devices.
    pub devices: Arc<Devices>,
    /// The journal, which holds the robotic switch.
    pub journal: Arc<Journal>,
    /// What people ordered.
    pub orders: Arc<OrderState>,
    /// The schedule file.
    pub schedule_file: Arc<ScheduleFile>,
    /// The rows of the schedule in force.
    pub rows: OrderedRows,
}

/// Counts the orders that closed or made something stricter: what was ordered before and is still being written must
/// not undo them.
#[derive(Debug, Default)]
pub struct Tightened(AtomicU64);

impl Tightened {
    fn note(&self) {
        self.0.fetch_add(1, Ordering::SeqCst);
    }

    /// A check that nothing was tightened since now.
    fn watch(&self) -> impl Fn() -> Result<(), String> {
        let before = self.0.load(Ordering::SeqCst);
        move || {
            let same = self.0.load(Ordering::SeqCst) == before;
            if same {
                Ok(())
            } else {
                Err("meanwhile another order closed the telescope or made a limit stricter".to_owned())
            }
        }
    }
}

/// Does this order act before the disk has it?
pub fn acts_at_once(kind: &OrderKind) -> bool {
    kind.only_tightens()
}

/// Follows an order that acts at once.
pub fn at_once(telescope: &Telescope, tightened: &Tightened, order: &Order) -> Reply {
    log_order(order);
    match &order.kind {
        OrderKind::Robotic(_) => {
            tightened.note();
            robotic::turn_off(&telescope.authority, &telescope.journal, "the robotic switch was turned off");
        }
        OrderKind::Close => {
            tightened.note();
            let why = format!("{} ordered it", order.from);
            robotic::turn_off(&telescope.authority, &telescope.journal, &why);
            // Also when it was off already.
            telescope.authority.close_request.send_replace(Some(why));
        }
        OrderKind::StayClosed(_) => {
            tightened.note();
            let ordered_by = ordered_by(telescope, order);
            telescope.orders.orders.change(|orders| orders.stay_closed.replace(ordered_by.clone()) != Some(ordered_by));
        }
        OrderKind::Override { input, .. } => {
            let mut applied = Ok(());
            telescope.orders.orders.change(|orders| {
                applied = orders.do_without(&telescope.orders.rules, input, 0.0, ordered_by(telescope, order));
                applied.is_ok()
            });
            if let Err(why) = applied {
                return refuse(&order.id, Reason::Malformed, &why);
            }
            tightened.note();
        }
        OrderKind::ReloadSchedule
        | OrderKind::Acknowledge(_)
        | OrderKind::Shelve { .. }
        | OrderKind::Unshelve(_)
        | OrderKind::PutSchedule { .. }
        | OrderKind::Cool { .. }
        | OrderKind::Warm(_)
        | OrderKind::CompleteHeaders { .. }
        | OrderKind::Skip(_)
        | OrderKind::Repeat(_) => {}
    }
    accept(&order.id)
}

/// Waits a moment until an order that acted at once is on disk and on the bus. Returns the file and the error where it is
/// not on disk.
pub async fn settle(telescope: &Telescope, kind: &OrderKind) -> Option<String> {
    let on_disk = on_disk(kind, &telescope.authority.hold, &telescope.orders.orders, &telescope.journal);
    let on_bus = async {
        let mut published = telescope.orders.published.subscribe();
        // The sender lives as long as the telescope, so waiting cannot fail.
        let _ = published
            .wait_for(|orders| {
                orders
                    .as_ref()
                    .is_some_and(|orders| *orders == operator_orders::orders(&telescope.authority, &telescope.orders))
            })
            .await;
    };
    let (written, _) = tokio::join!(tokio::time::timeout(SETTLED, on_disk), tokio::time::timeout(SETTLED, on_bus));
    match written {
        Ok(written) => written.err().map(|error| error.to_string()),
        Err(_) => {
            let data = telescope.authority.node.config.folders.data.display();
            Some(format!("{data}: no answer of the disk within {} s", SETTLED.as_secs()))
        }
    }
}

/// Writes what an order that acted at once has changed, as far as it is not written yet.
async fn on_disk(
    kind: &OrderKind,
    hold: &watch::Receiver<Hold>,
    orders: &Persisted<ActiveOrders>,
    journal: &Arc<Journal>,
) -> io::Result<()> {
    // The folder may be shared, and then it is the commander's to write.
    let commands = || match hold.borrow().may_publish() {
        true => Ok(()),
        false => Err(io::Error::other("this node does not command now: give the order again")),
    };
    let switch = async {
        match kind {
            OrderKind::Close | OrderKind::Robotic(_) => journal.write_switch_in_turn().await,
            // The switch is as it was.
            _ => Ok(()),
        }
    };
    commands()?;
    tokio::try_join!(orders.write(), switch)?;
    // A node that stood still lost the lease meanwhile.
    commands()
}

/// Follows an order that is on disk before it acts.
pub async fn when_written(telescope: &Telescope, tightened: &Tightened, order: &Order) -> Reply {
    log_order(order);
    let still = tightened.watch();
    let ordered_by = ordered_by(telescope, order);
    let done = match &order.kind {
        OrderKind::Robotic(_) => turn_robotic_on(telescope, &still).await,
        OrderKind::StayClosed(_) => {
            change(telescope, &still, |orders| {
                orders.stay_closed = None;
                Ok(())
            })
            .await
        }
        OrderKind::Override { input, for_s } => {
            change(telescope, &still, |orders| {
                orders.do_without(&telescope.orders.rules, input, *for_s, ordered_by.clone())
            })
            .await
        }
        OrderKind::Acknowledge(id) => about_alerts(telescope, |alerts| alerts.acknowledge(id, &ordered_by)).await,
        OrderKind::Shelve { alert, for_s } => {
            about_alerts(telescope, |alerts| alerts.shelve(alert, *for_s, ordered_by.clone())).await
        }
        OrderKind::Unshelve(id) => about_alerts(telescope, |alerts| alerts.unshelve(id)).await,
        OrderKind::PutSchedule { text, instead_of } => {
            let author = Author { name: order.from.clone(), reason: order.reason.clone() };
            schedule_file::put(&telescope.schedule_file, text, instead_of.as_deref(), author).await
        }
        OrderKind::Cool { camera, set_c } => cooler(telescope, camera, |config| match set_c.or(config.temperature_c) {
            Some(set_c) if (-273.15..=100.0).contains(&set_c) => Ok(Cooler::Cool { set_c }),
            Some(set_c) => Err(format!("a set point of {set_c} C: expected -273.15 to 100")),
            None => Err(format!(
                "{camera} has no temperature_c in its configuration: add the set point to the order (--temperature-c)"
            )),
        })
        .await,
        OrderKind::Warm(camera) => cooler(telescope, camera, |_| Ok(Cooler::Warm)).await,
        // The archive sees it in the state of the night.
        OrderKind::CompleteHeaders { night } => match night.as_deref().map(str::parse::<NightDate>) {
            Some(Err(_)) => Err(Unchanged::Refused(format!(
                "{:?} is no night: expected the date of its evening, such as 20261121",
                night.as_deref().unwrap_or_default()
            ))),
            Some(Ok(_)) | None => Ok(()),
        },
        OrderKind::Skip(row) => telescope.rows.skip(row, order, ordered_by.at_utc).await,
        OrderKind::Repeat(row) => telescope.rows.repeat(row, order, ordered_by.at_utc).await,
        OrderKind::ReloadSchedule => schedule_file::reload(&telescope.schedule_file).await,
        OrderKind::Close => Ok(()),
    };
    match done {
        Ok(()) => accept(&order.id),
        Err(Unchanged::Refused(why)) => {
            let reason = if still().is_ok() { Reason::Malformed } else { Reason::NotNow };
            refuse(&order.id, reason, &why)
        }
        Err(Unchanged::Device { reason, detail }) => refuse(&order.id, reason, &detail),
        Err(Unchanged::Overtaken(why)) => refuse(&order.id, Reason::WrongState, &why),
        Err(failed @ Unchanged::Disk { .. }) => refuse(&order.id, Reason::NotNow, &failed.to_string()),
    }
}

async fn change(
    telescope: &Telescope,
    still: impl Fn() -> Result<(), String>,
    does: impl Fn(&mut ActiveOrders) -> Result<(), String>,
) -> Result<(), Unchanged> {
    let changed = telescope.orders.orders.change_when_written(|orders| still().and_then(|()| does(orders)));
    changed.await
}

async fn about_alerts(
    telescope: &Telescope,
    does: impl Fn(&mut Annunciator) -> Result<(), String>,
) -> Result<(), Unchanged> {
    telescope.orders.annunciator.change_when_written(does).await
}

/// Gives a camera's cooler a command, and answers once the camera's node has taken it.
async fn cooler(
    telescope: &Telescope,
    camera: &str,
    command: impl Fn(&config::Camera) -> Result<Cooler, String>,
) -> Result<(), Unchanged> {
    let cameras = &telescope.devices.cameras;
    let Some(found) = cameras.iter().find(|known| known.config.common.name.as_str() == camera) else {
        let names = cameras.iter().map(|known| known.config.common.name.as_str());
        return Err(Unchanged::Refused(format!("no camera is named {camera:?}: {}", schedule::meant(camera, names))));
    };
    let command = command(&found.config).map_err(Unchanged::Refused)?;
    let taken = found.instrument.ask_within(&CommandId::fresh(), command, COOLER_TURN).await;
    taken.map_err(|error| {
        let reason = match &error {
            ActionError::Refused { reason, .. } => *reason,
            ActionError::Unanswered { .. } => Reason::NotConnected,
            _ => Reason::DeviceError,
        };
        Unchanged::Device { reason, detail: error.to_string() }
    })
}

async fn turn_robotic_on(telescope: &Telescope, still: impl Fn() -> Result<(), String>) -> Result<(), Unchanged> {
    let (journal, clock) = (telescope.journal.clone(), telescope.authority.node.bus.clock().clone());
    let written = tokio::task::spawn_blocking(move || journal.robotic_on(clock.utc())).await;
    let written = written.map_err(io::Error::other).and_then(|written| written);
    written.map_err(|source| Unchanged::Disk { path: "the journal".to_owned(), source })?;
    if let Err(why) = still() {
        robotic::note_off(&telescope.authority, &telescope.journal);
        return Err(Unchanged::Refused(why));
    }
    telescope.authority.robotic.send_replace(true);
    Ok(())
}

fn log_order(order: &Order) {
    tracing::info!(from = order.from, kind = ?brief(&order.kind), reason = order.reason, "order");
}

/// An order in short for a line of text: of a schedule only its length, because the versions hold the text.
pub fn brief(kind: &OrderKind) -> OrderKind {
    match kind {
        OrderKind::PutSchedule { text, instead_of } => {
            OrderKind::PutSchedule { text: format!("{} bytes", text.len()), instead_of: instead_of.clone() }
        }
        short => short.clone(),
    }
}

/// The person who gave the order, the reason, and the present time.
pub fn ordered_by(telescope: &Telescope, order: &Order) -> OrderedBy {
    OrderedBy {
        from: order.from.clone(),
        reason: order.reason.clone(),
        at_utc: telescope.authority.node.bus.clock().utc(),
    }
}

fn accept(id: &CommandId) -> Reply {
    Reply::Accepted(Accepted { id: id.clone(), token: None, not_written: None })
}

/// A refusal, for people and programs.
pub fn refuse(id: &CommandId, reason: Reason, detail: &str) -> Reply {
    Reply::Refusal(Refusal { id: id.clone(), reason, detail: detail.to_owned() })
}

#[cfg(test)]
mod tests {
    use test_support::LIMIT;
    use tokio::time::timeout;
    use units::Utc;

    use super::*;

    #[tokio::test]
    async fn only_an_order_about_the_switch_waits_for_the_journal_and_a_standby_writes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j.jsonl");
        let journal = Arc::new(Journal::open(&path).unwrap());
        let writer = "main".parse().unwrap();
        let orders = Persisted::new(folder.path().join("orders.json"), &writer, ActiveOrders::default());
        let settled = async |kind: OrderKind, hold: Hold, within: Duration| {
            timeout(within, on_disk(&kind, &watch::channel(hold).1, &orders, &journal)).await
        };
        let at = Utc::from_seconds(1000.0);
        journal.robotic_off(at);
        let written = || Journal::last_robotic_in(&path).unwrap();

        let standby = settled(OrderKind::Close, Hold::Standby, LIMIT).await.unwrap().unwrap_err().to_string();
        assert!(standby.contains("give the order again"), "{standby}");
        assert_eq!(written(), None);

        // A write of the switch hangs.
        let hangs = journal.hold_pen().await;
        settled(OrderKind::StayClosed(true), Hold::Claiming, LIMIT).await.unwrap().unwrap();
        for kind in [OrderKind::Close, OrderKind::Robotic(false)] {
            assert!(settled(kind.clone(), Hold::Claiming, Duration::ZERO).await.is_err(), "{kind:?}");
        }
        drop(hangs);
        settled(OrderKind::Close, Hold::Claiming, LIMIT).await.unwrap().unwrap();
        assert_eq!(written(), Some((at, false)));
    }
}
