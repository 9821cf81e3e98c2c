//! Opening: the slit to where the telescope looks, the roof, then cover and mount, each only while the sky stays safe.
//!
//! A site's script may wrap it or replace it ([`crate::hooks`]).

mod by_script;

use std::sync::Arc;

use contract::device::dome::Shutter::Open;
use schedule::plan::overheads::{TOOK, TimedPart};

use crate::action_error::ActionError;
use crate::authority::Authority;
use crate::devices::{Chain, Devices};
use crate::hooks::ScriptedSite;
use crate::slit::{self, Slits};
use crate::took::took_s;

/// What opening works with.
pub struct Opener {
    /// Whether this node may act.
    pub authority: Arc<Authority>,
    /// The devices.
    pub devices: Arc<Devices>,
    /// The slits of the domes.
    pub slits: Arc<Slits>,
    /// The site's script.
    pub site: Arc<ScriptedSite>,
}

/// Opens as the site's script has it, or by default where it does not define it.
///
/// The runner drops this as soon as the sky is not safe.
pub async fn open(opener: &Opener, chain: &Chain<'_>) -> Result<(), ActionError> {
    only_while_safe(opener)?;
    // A pending close request gives way to what is observed now.
    opener.authority.close_request.send_if_modified(|request| request.take().is_some());
    let (clock, was_shut) =
        (opener.authority.node.bus.clock(), opener.devices.domes.iter().any(|dome| dome.shutter() != Some(Open)));
    let began = clock.utc();
    match opener.site.hooks.script()? {
        Some(script) => by_script::open(opener, chain, script).await?,
        None => by_default(opener, chain).await?,
    }
    if was_shut {
        tracing::info!(span = TimedPart::Open.word(), took_s = took_s(clock, began), "{TOOK}");
    }
    Ok(())
}

/// Opens every enclosure, then the covers, and takes the mount of a chain out of its park position.
///
/// A dome turns before it opens: many cannot do both at once. The roof goes before the mount: a roll-off roof may hit a
/// mount that has left its park position.
pub async fn by_default(opener: &Opener, chain: &Chain<'_>) -> Result<(), ActionError> {
    open_domes(opener).await?;
    open_covers(opener).await?;
    unpark(opener, chain).await
}

/// Opens every enclosure.
pub async fn open_domes(opener: &Opener) -> Result<(), ActionError> {
    for dome in &opener.devices.domes {
        only_while_safe(opener)?;
        slit::turn_before_opening(&opener.slits, dome).await?;
        dome.open().await?;
    }
    Ok(())
}

/// Opens every cover.
pub async fn open_covers(opener: &Opener) -> Result<(), ActionError> {
    for cover in &opener.devices.covers {
        only_while_safe(opener)?;
        opener.authority.or_without(cover.open().await)?;
    }
    Ok(())
}

/// Takes the mount of a chain out of its park position.
pub async fn unpark(opener: &Opener, chain: &Chain<'_>) -> Result<(), ActionError> {
    only_while_safe(opener)?;
    match chain.mount {
        Some(mount) => mount.unpark().await,
        None => Ok(()),
    }
}

fn only_while_safe(opener: &Opener) -> Result<(), ActionError> {
    if opener.authority.is_safe() {
        return Ok(());
    }
    Err(ActionError::NotSafe(opener.authority.verdict.borrow().why()))
}
