//! The nodes that publish in the name of a dome's guard: each incarnation for itself, since a stranger may use that
//! name too.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bus::{Bus, Catch, Incarnations, MachineTime};
use contract::device::dome::Guard;
use contract::{BootId, Device, Key};
use tokio::sync::watch;

/// A guard publishes each second; one that was silent for so long is not there.
const LIVING: Duration = Duration::from_secs(5);

/// The guards of one dome: one, unless something is wrong. Cheap to clone.
#[derive(Clone)]
pub struct Guards {
    words: Arc<Mutex<Incarnations<Guard>>>,
    received: watch::Receiver<u64>,
    _listening: Arc<Listening>,
}

struct Listening(tokio::task::JoinHandle<()>);

impl Drop for Listening {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl Guards {
    /// Subscribes to the guards of a dome.
    pub async fn listen(bus: &Bus, dome: &Device) -> anyhow::Result<Self> {
        let subscriber = bus.subscribe::<Guard>(&Key::Guard(dome.clone()).to_string(), Catch::Newest, 32).await?;
        let words = Arc::new(Mutex::new(Incarnations::new(LIVING)));
        let (stir, received) = watch::channel(0_u64);
        let into = words.clone();
        let listening = tokio::spawn(async move {
            loop {
                let received = subscriber.recv().await;
                let mut words = into.lock().unwrap_or_else(PoisonError::into_inner);
                words.observe(&received.sample.boot_id, received.sample.body, received.arrived);
                stir.send_modify(|count| *count = count.wrapping_add(1));
            }
        });
        Ok(Self { words, received, _listening: Arc::new(Listening(listening)) })
    }

    /// What was published within the last 5 s, by incarnation.
    pub fn living(&self, now: MachineTime) -> Vec<(BootId, Guard)> {
        let words = self.words.lock().unwrap_or_else(PoisonError::into_inner);
        words.within(LIVING, now).map(|(boot_id, guard)| (boot_id.clone(), guard.clone())).collect()
    }

    /// Waits for the next sample.
    pub async fn changed(&mut self) {
        if self.received.changed().await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}
