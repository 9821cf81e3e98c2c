//! The learned pointing models on the bus: a standby takes them over.

use std::sync::Arc;

use contract::Part;
use contract::observatory::PointingState;

use super::learnt::Book;
use crate::control_room::ControlRoom;

/// Takes over what the commander learned for as long as this node stands by: its first slew is then as good as any.
pub async fn keep_hearing(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let mut pointing = room.node.bus.latest::<PointingState>(&room.key(Part::Pointing)).await?;
    loop {
        pointing.changed().await;
        let own = room.node.bus.boot_id();
        let Some(heard) = pointing.get().filter(|heard| heard.said.boot_id != *own) else { continue };
        if room.may_speak() {
            continue;
        }
        let models = heard.said.body.models;
        room.pointing.send_modify(|state| state.models.clone_from(&models));
        // Written down once this node commands: its folder may be its own.
        room.pointing_book.change(|known| {
            let is_new = known.models != models;
            *known = Book { models };
            is_new
        });
    }
}
