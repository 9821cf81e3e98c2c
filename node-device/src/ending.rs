//! How a device node ends: what is open is closed first, unless another guard takes over.

use std::time::Duration;

use anyhow::bail;
use contract::observatory::AlertKind;
use interlock::Deadlines;
use node::{Node, NodeAlerts, NodeOptions};

use crate::child::END_LIMIT;
use crate::guard_process::link::{GuardLink, SHARES_CLOCK};
use crate::guard_process::places::Places;
use crate::guard_process::{GUARD_LOCK, NODE_LOCK, RESTART};
use crate::start::Enclosure;

/// The guard process waits this much longer than its node, so that the node can still report how it ended.
const MARGIN: Duration = Duration::from_secs(5);
/// A node without its guard process looks so often whether there is a new one.
const LOOK: Duration = Duration::from_millis(500);

/// Waits for the order to end, closes every enclosure, and then ends the node.
pub async fn close_first(node: Node, link: Option<GuardLink>, enclosures: Vec<Enclosure>) -> anyhow::Result<()> {
    let asked = async {
        match &link {
            Some(link) => link.asked_to_end.wait().await,
            None => std::future::pending().await,
        }
    };
    tokio::select! {
        () = node.stop.wait() => return Ok(()),
        () = node.ending.wait() => {}
        () = asked => {}
    }
    // The guard process asks by its own line.
    node.ending.stop();
    for Enclosure { name, guard, closed } in &enclosures {
        guard.lock().unwrap_or_else(std::sync::PoisonError::into_inner).end();
        if !*closed.borrow() {
            tracing::info!(dome = %name, "the node was asked to end; the dome is closed first");
        }
    }
    let mut open: Vec<String> = Vec::new();
    let closing = async {
        for Enclosure { closed, .. } in &enclosures {
            // Its sender exists as long as the guard's task, whose end ends the node.
            let _ = closed.clone().wait_for(|closed| *closed).await;
        }
    };
    if tokio::time::timeout(END_LIMIT.saturating_sub(MARGIN), closing).await.is_err() {
        let still = enclosures.iter().filter(|enclosure| !*enclosure.closed.borrow());
        open.extend(still.map(|enclosure| enclosure.name.to_string()));
    }
    if !enclosures.is_empty() {
        node.ends_closed(open.is_empty());
    }
    node.stop.stop();
    if !open.is_empty() {
        bail!("NOBODY GUARDS dome {} now, and it is not verified closed: close it by hand", open.join(", "));
    }
    Ok(())
}

/// Guards on when the guard process has died, raises the alert unless the next one runs soon, and ends when that does.
pub async fn outlive_guard_process(
    node: Node,
    link: GuardLink,
    options: NodeOptions,
    enclosures: Vec<String>,
) -> anyhow::Result<()> {
    let places = Places::of(&options.config, node.id.as_str());
    // Held as long as this process runs; where no file can be locked nobody waits for it.
    let _lock = places.lock(NODE_LOCK).ok();
    if node.stop.or(link.orphaned.wait()).await.is_none() {
        return Ok(());
    }
    if options.with_parent {
        node.stop.stop();
        return Ok(());
    }
    tracing::error!("the guard process has ended; this node guards on alone and leaves to the next one");
    // The disk may hang, and the alert does not wait for it.
    let raising = async {
        raise_after(RESTART, &node.alerts, &enclosures).await;
        std::future::pending::<()>().await;
    };
    tokio::select! {
        () = raising => Ok(()),
        () = leave_to_the_next(&node, &link, &places) => Ok(()),
    }
}

/// Raises the alert that the guard process is gone, after the time that a restart of it takes.
async fn raise_after(restart: Duration, alerts: &NodeAlerts, enclosures: &[String]) {
    tokio::time::sleep(restart).await;
    for dome in enclosures {
        let cause = format!("the guard process of dome {dome} has ended; its device node guards on alone");
        alerts.raise(AlertKind::GuardProcess, dome, &cause);
    }
}

/// Keeps the countdown until there is a new guard process, and ends this node then.
async fn leave_to_the_next(node: &Node, link: &GuardLink, places: &Places) {
    while node.stop.or(tokio::time::sleep(LOOK)).await.is_some() {
        let (places, now, clock) = (places.clone(), node.bus.clock().machine(), node.bus.clock().clone());
        let last = link.last();
        let looking = tokio::task::spawn_blocking(move || {
            let until = last.domes.iter().map(|(dome, report)| (dome.clone(), report.open_until(now, SHARES_CLOCK)));
            // A disk that is full only shortens the time until the dome closes.
            let _ = places.keep_countdown(clock.machine(), &until.collect::<Deadlines>());
            places.lock(GUARD_LOCK).is_err()
        });
        // A disk that hangs is asked again when it answers.
        if looking.await.unwrap_or(false) {
            tracing::warn!("a new guard process has started; this node leaves to it, and nothing is closed for that");
            return node.stop.stop();
        }
    }
}

#[cfg(test)]
mod tests {
    use bus::Clock;

    use super::*;

    #[tokio::test]
    async fn a_guard_process_that_is_restarted_is_no_alert_and_one_that_stays_away_is() {
        let (alerts, domes) = (NodeAlerts::new(Clock::machine_clock()), ["roof".to_owned()]);
        let ids = || alerts.watch().borrow().alerts.iter().map(|alert| alert.id.clone()).collect::<Vec<_>>();
        let next_one_came = tokio::time::timeout(Duration::ZERO, raise_after(RESTART, &alerts, &domes)).await;
        assert!(next_one_came.is_err() && ids().is_empty());
        raise_after(Duration::ZERO, &alerts, &domes).await;
        assert_eq!(ids(), ["guard-process/roof"]);
    }
}
