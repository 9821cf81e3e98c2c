//! The operator orders on the bus: the commander publishes them, a standby receives them.

use std::sync::Arc;
use std::time::Duration;

use bus::Quality;
use contract::Part;
use contract::observatory::StandingOrders;
use safety::standing::Standing;

use crate::control_room::ControlRoom;

const SECOND: Duration = Duration::from_secs(1);

/// The orders that this node publishes now.
pub fn orders(room: &ControlRoom) -> StandingOrders {
    room.standing.get().published(room.hold.borrow().token(), room.annunciator.get().shelf())
}

/// Publishes them at each change and every second, while this node publishes for the telescope.
pub async fn keep_telling(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let line =
        room.node.bus.publisher::<StandingOrders>(&room.key(Part::Standing), Quality::State { cache: 1 }).await?;
    let clock = room.node.bus.clock().clone();
    let (mut standing, mut shelf, mut hold) =
        (room.standing.subscribe(), room.annunciator.subscribe(), room.hold.clone());
    let mut said_at = None;
    loop {
        if room.may_speak() {
            let now = orders(&room);
            // Alerts come and go without a change of the shelved ones.
            let is_due = said_at.is_none_or(|at| clock.machine().since(at) >= SECOND - SECOND / 20);
            if is_due || room.standing_said.borrow().as_ref() != Some(&now) {
                line.put(now.clone()).await?;
                room.standing_said.send_replace(Some(now));
                said_at = Some(clock.machine());
            }
        }
        tokio::select! {
            changed = standing.changed() => changed?,
            changed = shelf.changed() => changed?,
            changed = hold.changed() => changed?,
            () = clock.tick(SECOND) => {}
        }
    }
}

/// Takes over what the commander publishes for as long as this node stands by, so that its verdict is the commander's
/// before it commands.
pub async fn keep_hearing(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let mut orders = room.before.standing.clone();
    loop {
        orders.changed().await;
        let own = room.node.bus.boot_id();
        let Some(heard) = orders.get().filter(|heard| heard.said.boot_id != *own) else { continue };
        if room.may_speak() {
            continue;
        }
        room.standing.adopt(|standing| {
            let adopted = Standing { token: standing.token, ..Standing::from(&heard.said.body) };
            let is_new = *standing != adopted;
            *standing = adopted;
            is_new
        });
    }
}
