//! Opening: the slit to where the telescope looks, the roof, then cover and mount, each only while the sky stays safe.
//!
//! A site's script may wrap it or replace it ([`crate::hooks`]).

use contract::device::dome::Shutter::Open;

use crate::action::took_s;
use crate::control_room::ControlRoom;
use crate::hooks;
use crate::rig::Chain;
use crate::slit;
use crate::trouble::Trouble;
use schedule::plan::overheads::{Span, TOOK};

/// Opens as the site's script has it, or by default where it does not define it.
///
/// The runner drops this as soon as the sky is not safe.
pub async fn open(room: &ControlRoom, chain: &Chain<'_>) -> Result<(), Trouble> {
    only_while_safe(room)?;
    // A pending close request gives way to what is observed now.
    room.wish_closed.send_if_modified(|wish| wish.take().is_some());
    let (clock, was_shut) = (room.node.bus.clock(), room.rig.domes.iter().any(|dome| dome.shutter() != Some(Open)));
    let began = clock.utc();
    match room.hooks.script()? {
        Some(script) => hooks::opening::open(room, chain, script).await?,
        None => by_default(room, chain).await?,
    }
    if was_shut {
        tracing::info!(span = Span::Open.word(), took_s = took_s(clock, began), "{TOOK}");
    }
    Ok(())
}

/// Opens every enclosure, then the covers, and takes the mount of a chain out of its park position.
///
/// A dome turns before it opens: many cannot do both at once. The roof goes before the mount: a roll-off roof may hit a
/// mount that has left its park position.
pub async fn by_default(room: &ControlRoom, chain: &Chain<'_>) -> Result<(), Trouble> {
    open_domes(room).await?;
    open_covers(room).await?;
    unpark(room, chain).await
}

/// Opens every enclosure.
pub async fn open_domes(room: &ControlRoom) -> Result<(), Trouble> {
    for dome in &room.rig.domes {
        only_while_safe(room)?;
        slit::turn_before_opening(room, dome).await?;
        dome.open().await?;
    }
    Ok(())
}

/// Opens every cover.
pub async fn open_covers(room: &ControlRoom) -> Result<(), Trouble> {
    for cover in &room.rig.covers {
        only_while_safe(room)?;
        room.or_without(cover.open().await)?;
    }
    Ok(())
}

/// Takes the mount of a chain out of its park position.
pub async fn unpark(room: &ControlRoom, chain: &Chain<'_>) -> Result<(), Trouble> {
    only_while_safe(room)?;
    match chain.mount {
        Some(mount) => mount.unpark().await,
        None => Ok(()),
    }
}

fn only_while_safe(room: &ControlRoom) -> Result<(), Trouble> {
    if room.is_safe() {
        return Ok(());
    }
    Err(Trouble::NotSafe(room.ruling.borrow().why()))
}
