//! The optics on the bus: the commander publishes them, a standby takes them over.

use std::sync::Arc;

use bus::Quality;
use contract::Part;
use contract::observatory::OpticsState;

use crate::control_room::ControlRoom;
use crate::night;

/// Publishes what is known of the optics at each change and every 10 s.
pub async fn keep_telling(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let line = room.node.bus.publisher::<OpticsState>(&room.key(Part::Optics), Quality::State { cache: 1 }).await?;
    let state = room.optics.subscribe();
    night::keep_saying(&room, &line, state).await
}

/// Takes over what the commander learned for as long as this node stands by: its first frame is then as quick as any.
pub async fn keep_hearing(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let mut optics = room.node.bus.latest::<OpticsState>(&room.key(Part::Optics)).await?;
    loop {
        optics.changed().await;
        let own = room.node.bus.boot_id();
        let Some(heard) = optics.get().filter(|heard| heard.said.boot_id != *own) else { continue };
        if room.may_speak() {
            continue;
        }
        // Written down once this node commands: its folder may be its own.
        room.optics.change(|known| {
            let is_new = *known != heard.said.body;
            *known = heard.said.body;
            is_new
        });
    }
}
