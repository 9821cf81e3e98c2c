//! The operator orders on the bus: the commander publishes them, a standby receives them.

use std::sync::Arc;
use std::time::Duration;

use bus::Latest;
use contract::Part;
use contract::observatory::OperatorOrders;
use safety::active_orders::ActiveOrders;

use crate::active_orders::OrderState;
use crate::authority::Authority;
use crate::persisted::replaced;
use crate::replicated;

const SECOND: Duration = Duration::from_secs(1);

/// The orders that this node publishes now.
pub fn orders(authority: &Authority, orders: &OrderState) -> OperatorOrders {
    orders.orders.get().published(authority.hold.borrow().token(), orders.annunciator.get().shelf())
}

/// Publishes them at each change and every second, while this node publishes for the telescope.
pub async fn keep_publishing(authority: Arc<Authority>, known: Arc<OrderState>) -> anyhow::Result<()> {
    let line = authority.node.bus.publisher::<OperatorOrders>(&authority.key(Part::OperatorOrders)).await?;
    let clock = authority.node.bus.clock().clone();
    let (mut active_orders, mut shelf, mut hold) =
        (known.orders.subscribe(), known.annunciator.subscribe(), authority.hold.clone());
    let mut published_at = None;
    loop {
        if authority.is_publishing() {
            let now = orders(&authority, &known);
            // Alerts come and go without a change of the shelved ones.
            let is_due = published_at.is_none_or(|at| clock.machine().since(at) >= SECOND - SECOND / 20);
            if is_due || known.published.borrow().as_ref() != Some(&now) {
                line.put(now.clone()).await?;
                known.published.send_replace(Some(now));
                published_at = Some(clock.machine());
            }
        }
        tokio::select! {
            changed = active_orders.changed() => changed?,
            changed = shelf.changed() => changed?,
            changed = hold.changed() => changed?,
            () = clock.tick(SECOND) => {}
        }
    }
}

/// Takes over what the commander publishes for as long as this node stands by, so that its verdict is the commander's
/// before it commands.
pub async fn keep_receiving(
    authority: Arc<Authority>,
    known: Arc<OrderState>,
    orders: Latest<OperatorOrders>,
) -> anyhow::Result<()> {
    let adopt = |orders| {
        known.orders.adopt(|active_orders| {
            let adopted = ActiveOrders { token: active_orders.token, ..ActiveOrders::from(&orders) };
            replaced(active_orders, &adopted)
        });
    };
    replicated::follow_commander(&authority, orders, adopt).await
}
