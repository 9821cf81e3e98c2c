//! Follows the users file: what is taken away in it ends here within two seconds.

use std::net::SocketAddr;
use std::sync::PoisonError;
use std::sync::atomic::Ordering;
use std::time::Duration;

use contract::observatory::AlertKind;
use node::NodeAlerts;

use super::Authentication;

const EVERY: Duration = Duration::from_secs(1);
const KEY: &str = "web.users";
const OPEN: &str = "web.insecure_open";

impl Authentication {
    /// Follows the users file for ever, and raises an alert while it does not count.
    /// An open door is an alert too, as long as it is open.
    pub async fn follow(self, alerts: NodeAlerts, listens: SocketAddr) -> anyhow::Result<()> {
        loop {
            match self.refresh().await {
                None => alerts.clear(AlertKind::Configuration, KEY),
                Some(fault) => alerts.raise(AlertKind::Configuration, KEY, &fault),
            }
            if self.is_insecurely_open() {
                let why = format!(
                    "{OPEN}: everybody who reaches {listens} may read everything and order everything, such as open the dome; make \
                     users with `starmesh user add`"
                );
                alerts.raise(AlertKind::Configuration, OPEN, &why);
            } else {
                alerts.clear(AlertKind::Configuration, OPEN);
            }
            tokio::time::sleep(EVERY).await;
        }
    }

    /// Looks at the users file now; returns why it does not count, if so.
    pub async fn refresh(&self) -> Option<String> {
        let this = self.clone();
        // A disk that does not answer must not hold a thread of the runtime.
        let looked = tokio::task::spawn_blocking(move || {
            let mut watched = this.0.watched.lock().unwrap_or_else(PoisonError::into_inner);
            if watched.look() {
                let users = watched.users().cloned();
                if let Some(users) = users.as_ref().filter(|_| watched.fault().is_none()) {
                    let ended = this.sessions().end_all(|_, session| !session.is_of(users));
                    tracing::info!(
                        users = users.users.len(),
                        tokens = users.tokens.len(),
                        ended,
                        "the users file was read"
                    );
                }
                this.0.is_faulty.store(watched.fault().is_some(), Ordering::Relaxed);
                *this.0.users.write().unwrap_or_else(PoisonError::into_inner) = users;
            }
            watched.fault().map(str::to_owned)
        });
        looked.await.unwrap_or_else(|error| Some(format!("{KEY}: it could not be looked at: {error}")))
    }
}
