//! The other telescopes of the site: whether one of them works under a roof that this one shares.

use std::sync::{Arc, Mutex, PoisonError};

use bus::{Catch, MachineTime};
use contract::observatory::NightState;
use contract::{Key, Part, Topic};
use interlock::OtherTelescopes;
use node::Node;

use crate::devices::dome::Dome;

/// The last published nights of the other telescopes. Cheap to clone.
#[derive(Clone, Default)]
pub struct SharedRoofWatch {
    nights: Arc<Mutex<OtherTelescopes>>,
}

impl SharedRoofWatch {
    /// Receives the nights of the site for ever; only sites with shared roofs need it.
    pub async fn keep_receiving(self, node: Node) -> anyhow::Result<()> {
        if node.config.shared.dome.is_empty() {
            return std::future::pending().await;
        }
        let own = node.config.place.telescope.clone();
        let keys = Topic::Observatory(Part::Night).on_site(&node.config.place.site);
        let nights = node.bus.subscribe::<NightState>(keys, Catch::Newest, 64).await?;
        loop {
            let received = nights.recv().await;
            let Key::Observatory(address, Part::Night) = received.key else { continue };
            if address.telescope != own {
                let works = received.sample.body.robotic && !received.sample.body.ended;
                let mut nights = self.nights.lock().unwrap_or_else(PoisonError::into_inner);
                nights.receive(address.telescope, works, received.arrived);
            }
        }
    }

    /// Does another telescope that the guard of this dome knows still observe?
    pub fn work_under(&self, dome: &Dome, now: MachineTime) -> bool {
        let Some(guard) = dome.guard.get() else { return false };
        let nights = self.nights.lock().unwrap_or_else(PoisonError::into_inner);
        nights.work(guard.sample.body.permits.iter().map(|permit| permit.telescope.as_str()), now)
    }
}
