//! Opening: the slit to where the telescope looks, the roof, then cover and mount, each only while the sky stays safe. A
//! dome that is shut waits until it is known what was missed of the safety inputs.
//!
//! A site's script may wrap it or replace it ([`crate::hooks`]).

mod by_script;

use std::sync::Arc;

use futures_util::future::join_all;
use safety::current_verdict::CurrentVerdict;
use schedule::plan::overheads::{TOOK, TimedPart};
use tokio::sync::watch;

use crate::action_error::ActionError;
use crate::authority::Authority;
use crate::devices::dome::Dome;
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
    let (clock, was_shut) = (opener.authority.node.bus.clock(), !opener.devices.are_domes_open());
    wait_until_known(opener).await?;
    if join_all(opener.devices.domes.iter().map(Dome::until_asked)).await.contains(&true) {
        wait_until_known(opener).await?;
    }
    // A pending close request gives way to what is observed now.
    opener.authority.close_request.send_if_modified(|request| request.take().is_some());
    let began = clock.utc();
    let (authority, script) = (&opener.authority, opener.site.hooks.script()?);
    let is_kept_shut = || authority.kept_shut(false).is_some();
    let mut half_open = HalfOpen { close_request: &authority.close_request, is_kept_shut, is_over: false };
    let opened = match script {
        Some(script) => by_script::open(opener, chain, script).await,
        None => by_default(opener, chain).await,
    };
    half_open.is_over = true;
    opened?;
    if was_shut {
        tracing::info!(span = TimedPart::Open.word(), took_s = took_s(clock, began), "{TOOK}");
    }
    Ok(())
}

/// Orders everything to close where the opening is dropped because a dwell keeps a shut dome shut: half open is no state to
/// leave things in, and the verdict is safe.
struct HalfOpen<'a, F: Fn() -> bool> {
    close_request: &'a watch::Sender<Option<String>>,
    is_kept_shut: F,
    is_over: bool,
}

impl<F: Fn() -> bool> Drop for HalfOpen<'_, F> {
    fn drop(&mut self) {
        if !self.is_over && (self.is_kept_shut)() {
            self.close_request.send_replace(Some("opening was ended, since a shut dome is kept shut".to_owned()));
        }
    }
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
        dome.open(|| {
            only_while_safe(opener)?;
            may_open(&opener.authority.verdict.borrow())
        })
        .await?;
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

/// Waits until nothing keeps a shut dome shut, outside of the site's script: it may take a dwell.
async fn wait_until_known(opener: &Opener) -> Result<(), ActionError> {
    only_while_safe(opener)?;
    let devices = &opener.devices;
    until_known(opener.authority.verdict.clone(), devices.stirred(), || devices.are_domes_open()).await;
    only_while_safe(opener)
}

fn only_while_safe(opener: &Opener) -> Result<(), ActionError> {
    if opener.authority.is_safe() {
        return Ok(());
    }
    Err(ActionError::NotSafe(opener.authority.verdict.borrow().why()))
}

/// May a shut dome be opened? Not yet, while a device node is asked for what was missed.
///
/// # Errors
/// Where a dwell runs over what is not known: too long for a device or a script to wait, so that opening begins anew.
fn may_open(verdict: &CurrentVerdict) -> Result<bool, ActionError> {
    match verdict.shut_for_a_dwell() {
        Some(why) => Err(ActionError::NotSafe(why)),
        None => Ok(verdict.keeps_shut.is_empty()),
    }
}

/// Waits until nothing keeps a shut dome shut: an answer about what was missed has come, or its dwell has run again. Or
/// until all are known to be open, since the state of one may be unknown for a moment.
async fn until_known(
    mut verdict: watch::Receiver<CurrentVerdict>,
    mut stirred: watch::Receiver<u64>,
    is_open: impl Fn() -> bool,
) {
    let mut is_told = false;
    loop {
        let why = verdict.borrow_and_update().why_kept_shut();
        let Some(why) = why.filter(|_| !is_open()) else { return };
        if !std::mem::replace(&mut is_told, true) {
            tracing::info!(why, "opening waits");
        }
        tokio::select! {
            changed = verdict.changed() => {
                if changed.is_err() {
                    // The safety loop has ended, and its node ends with it.
                    return std::future::pending().await;
                }
            }
            Ok(()) = stirred.changed() => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::Duration;

    use contract::observatory::Unsafe;
    use futures_util::FutureExt as _;
    use units::{MachineTime, Utc};

    use super::*;

    fn keeps_shut(clears_in_s: Option<f64>) -> Unsafe {
        Unsafe { input: "safetymonitor/m".to_owned(), why: "it is not known".to_owned(), clears_in_s }
    }

    fn verdict() -> CurrentVerdict {
        CurrentVerdict::none(MachineTime::from_boot(Duration::from_secs(100)), Utc::EPOCH)
    }

    #[test]
    fn an_opening_that_is_dropped_over_a_dome_that_is_kept_shut_is_closed_again() {
        for (is_kept_shut, is_over, closes) in [(true, false, true), (true, true, false), (false, false, false)] {
            let close_request = watch::channel(None).0;
            drop(HalfOpen { close_request: &close_request, is_kept_shut: || is_kept_shut, is_over });
            assert_eq!(close_request.borrow().is_some(), closes, "{is_kept_shut} {is_over}");
        }
    }

    #[test]
    fn opening_waits_until_it_is_known_what_was_missed_or_that_all_is_open() {
        let ((sender, verdict), (stir, stirred)) = (watch::channel(verdict()), watch::channel(0));
        let is_open = &AtomicBool::new(false);
        let wait = || Box::pin(until_known(verdict.clone(), stirred.clone(), move || is_open.load(Ordering::Relaxed)));
        assert_eq!(wait().now_or_never(), Some(()));
        sender.send_modify(|verdict| verdict.keeps_shut.push(keeps_shut(None)));
        let (mut answered, mut opened) = (wait(), wait());
        assert_eq!(answered.as_mut().now_or_never(), None);
        sender.send_modify(|verdict| verdict.keeps_shut.clear());
        assert_eq!(answered.as_mut().now_or_never(), Some(()));

        sender.send_modify(|verdict| verdict.keeps_shut.push(keeps_shut(Some(1200.0))));
        assert_eq!(opened.as_mut().now_or_never(), None);
        // Its state was unknown for a moment.
        is_open.store(true, Ordering::Relaxed);
        stir.send_modify(|count| *count += 1);
        assert_eq!(opened.as_mut().now_or_never(), Some(()));

        is_open.store(false, Ordering::Relaxed);
        let mut ended = wait();
        drop(sender);
        assert_eq!(ended.as_mut().now_or_never(), None, "without a safety loop nothing is opened");
    }

    #[test]
    fn an_answer_is_waited_for_before_each_command_and_a_dwell_begins_opening_anew() {
        let mut verdict = verdict();
        assert!(matches!(may_open(&verdict), Ok(true)));
        verdict.keeps_shut.push(keeps_shut(None));
        assert!(matches!(may_open(&verdict), Ok(false)));
        verdict.keeps_shut.push(keeps_shut(Some(1200.0)));
        let error = may_open(&verdict).unwrap_err();
        assert!(error.may_pass(), "it is tried again");
        assert_eq!(error.to_string(), "nothing is opened: safetymonitor/m: it is not known");
    }
}
