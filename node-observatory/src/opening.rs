//! Opening: the slit to where the telescope looks, the roof, then cover and mount, each only while the sky stays safe.

use crate::control_room::ControlRoom;
use crate::rig::Chain;
use crate::slit;
use crate::trouble::Trouble;

/// Opens every enclosure, then the covers, and takes the mount of a chain out of its park position.
///
/// A dome turns before it opens: many cannot do both at once. The roof goes before the mount: a roll-off roof may hit a
/// mount that has left its park position. The runner drops this as soon as the sky is not safe.
pub async fn open(room: &ControlRoom, chain: &Chain<'_>) -> Result<(), Trouble> {
    if !room.is_safe() {
        return Err(Trouble::Impossible(format!("nothing is opened: {}", room.ruling.borrow().why())));
    }
    // whatever was to be closed gives way to what is observed now
    room.wish_closed.send_if_modified(|wish| wish.take().is_some());
    for dome in &room.rig.domes {
        slit::turn_before_opening(room, dome).await?;
        dome.open().await?;
    }
    for cover in &room.rig.covers {
        room.or_without(cover.open().await)?;
    }
    match chain.mount {
        Some(mount) => mount.unpark().await,
        None => Ok(()),
    }
}
