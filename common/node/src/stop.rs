//! The signal that ends a node.

use std::sync::Arc;

use tokio::sync::watch;

/// Signals once, to all holders of a clone, that it is time to end.
#[derive(Debug, Clone)]
pub struct Stop {
    requested: Arc<watch::Sender<bool>>,
}

impl Default for Stop {
    fn default() -> Self {
        Self { requested: Arc::new(watch::channel(false).0) }
    }
}

impl Stop {
    /// Sets it.
    pub fn stop(&self) {
        self.requested.send_replace(true);
    }

    /// Is it set?
    pub fn is_stopped(&self) -> bool {
        *self.requested.borrow()
    }

    /// Waits until it is set.
    pub async fn wait(&self) {
        let mut received = self.requested.subscribe();
        // The sender lives in self, so waiting cannot fail.
        let _ = received.wait_for(|stopped| *stopped).await;
    }

    /// Runs a future until it ends or the stop is set; `None` for the latter.
    pub async fn or<T>(&self, work: impl Future<Output = T>) -> Option<T> {
        tokio::select! {
            biased;
            () = self.wait() => None,
            done = work => Some(done),
        }
    }
}
