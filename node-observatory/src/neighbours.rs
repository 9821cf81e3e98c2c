//! The other telescopes of the site: whether one of them works under a roof that this one shares.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bus::{Catch, MachineTime, Node};
use contract::observatory::NightState;
use contract::{Chunk, Key, Part};

use crate::rig::dome::Dome;

/// The last published nights of the other telescopes. Cheap to clone.
#[derive(Clone, Default)]
pub struct Neighbours {
    nights: Arc<Mutex<BTreeMap<Chunk, (bool, MachineTime)>>>,
}

/// Telescopes of one site.
const MOST_NEIGHBOURS: usize = 256;
/// Another telescope that published nothing for so long does not work.
const SILENCE: Duration = Duration::from_secs(10);

impl Neighbours {
    /// Receives the nights of the site for ever; only sites with shared roofs need it.
    pub async fn keep_hearing(self, node: Node) -> anyhow::Result<()> {
        if node.config.shared.dome.is_empty() {
            return std::future::pending().await;
        }
        let own = node.config.place.telescope.clone();
        let expression =
            format!("{}/{}/*/observatory/{}/state", contract::key::ROOT, node.config.place.site, Part::Night.word());
        let nights = node.bus.subscribe::<NightState>(&expression, Catch::Newest, 64).await?;
        loop {
            let heard = nights.hear().await;
            let Key::Observatory(address, Part::Night) = heard.key else { continue };
            if address.telescope != own {
                let works = heard.said.body.robotic && !heard.said.body.ended;
                let mut nights = self.nights.lock().unwrap_or_else(PoisonError::into_inner);
                if nights.len() < MOST_NEIGHBOURS || nights.contains_key(&address.telescope) {
                    nights.insert(address.telescope, (works, heard.arrived));
                }
            }
        }
    }

    /// Does another telescope that the guard of this dome knows still observe?
    pub fn work_under(&self, dome: &Dome, now: MachineTime) -> bool {
        let Some(guard) = dome.guard.get() else { return false };
        let nights = self.nights.lock().unwrap_or_else(PoisonError::into_inner);
        guard.said.body.permits.iter().any(|permit| {
            nights.iter().any(|(telescope, (works, arrived))| {
                telescope.as_str() == permit.telescope && *works && now.since(*arrived) <= SILENCE
            })
        })
    }
}
