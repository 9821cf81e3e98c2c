//! Publishes states of the telescope, each under its own key, while this node publishes for it.

use std::sync::Arc;
use std::time::Duration;

use bus::Publisher;
use contract::Part;
use tokio::sync::watch;

use crate::authority::Authority;

/// No two samples of a state follow each other faster; a fast demo changes hundreds of times a second.
pub const LEAST: Duration = Duration::from_millis(50);

/// Publishes a state of the telescope whenever it changes, and every 10 s.
pub async fn keep_publishing<T>(
    authority: Arc<Authority>,
    part: Part,
    mut state: watch::Receiver<T>,
) -> anyhow::Result<()>
where
    T: contract::Payload + Clone,
{
    let line = authority.node.bus.publisher::<T>(&authority.key(part)).await?;
    let mut hold = authority.hold.clone();
    loop {
        hold.mark_unchanged();
        let published = state.borrow_and_update().clone();
        publish(&authority, &line, published).await?;
        tokio::time::sleep(LEAST).await;
        tokio::select! {
            changed = state.changed() => changed?,
            // A node that becomes the commander publishes at once what it knows: its own end may come before 10 s are
            // over.
            changed = hold.changed() => changed?,
            () = tokio::time::sleep(Duration::from_secs(10)) => {}
        }
    }
}

/// Publishes a value while this node publishes for the telescope.
pub async fn publish<T: contract::Payload>(authority: &Authority, line: &Publisher<T>, body: T) -> anyhow::Result<()> {
    if authority.is_publishing() {
        line.put(body).await?;
    }
    Ok(())
}
