//! What a node learns when it becomes the commander: what the one before it did, and what people ordered meanwhile.

use std::sync::Arc;
use std::time::Duration;

use bus::{BusError, Latest};
use contract::observatory::{AlertKind, NightState};
use contract::{BootId, Part};
use units::Utc;

use crate::control_room::ControlRoom;
use crate::journal::Journal;
use crate::standing::{self, Standing};

/// An order from last night is no order for this one, sky s.
const ORDER_HOLDS_S: f64 = 18.0 * 3600.0;
/// A commander says each second how it stands; what is older than this is no last word.
const LAST_WORD: Duration = Duration::from_secs(60);

/// The robotic switch as it was last ordered, else as configured.
pub fn robotic(journal: &Journal, configured: bool, now: Utc) -> bool {
    match journal.last_robotic() {
        Some((at, on)) if now.seconds_since(at).abs() < ORDER_HOLDS_S => on,
        _ => configured,
    }
}

/// Listens to the commander before, so that its last word is known.
pub async fn listen(room: &ControlRoom) -> Result<Latest<NightState>, BusError> {
    room.node.bus.latest(&room.key(Part::Night)).await
}

/// Learns it all. A disk that fails is told, and keeps nobody from commanding: who commands can close.
pub async fn learn(room: &Arc<ControlRoom>, last_word: &Latest<NightState>) {
    let (at, path, now) = (room.clone(), standing::path(&room.node.config), room.node.bus.clock().utc());
    let learnt = tokio::task::spawn_blocking(move || (at.journal.take_over(), Standing::read(&path, now))).await;
    let Ok((taken, standing)) = learnt else { return };
    match taken {
        Ok(()) => room.node.alerts.clear(AlertKind::Journal, ""),
        Err(error) => {
            let cause = format!("the journal cannot be taken over: {error}");
            room.node.alerts.raise(AlertKind::Journal, "", &cause);
        }
    }
    // an order that this life accepted and could not write is not forgotten with the lease
    let is_written = *room.standing.borrow() == *room.standing_on_disk.borrow();
    room.standing.send_if_modified(|known| {
        let holds = if is_written { standing } else { known.clone().stricter(standing) };
        let is_new = *known != holds;
        *known = holds;
        is_new
    });
    let own: &BootId = room.node.bus.boot_id();
    let heard = last_word.fresh(LAST_WORD).filter(|heard| heard.said.boot_id != *own);
    // the journal of a commander on another host is out of reach, its last word is not
    let on = match heard {
        Some(heard) => heard.said.body.robotic,
        None => robotic(&room.journal, *room.robotic.borrow(), now),
    };
    if room.robotic.send_replace(on) != on {
        tracing::info!(on, "the robotic switch stands as it was ordered");
    }
}
