//! Opening as the site's script has it; whatever fails in it is closed by default.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use contract::device::cover_calibrator::Cover;
use rhai::Dynamic;
use units::seconds;

use super::Opener;
use crate::action_error::ActionError;
use crate::command_timeout::command_timeout;
use crate::devices::Chain;
use crate::hooks::line::{Host, HostAnswer, Reply, Request};
use crate::hooks::{CallError, Function, Script, host};

/// After a failure the closing is waited for so long, sky time; it goes on by itself.
const CLOSED: Duration = Duration::from_secs(300);

/// Opens, unless everything is open already.
///
/// # Errors
/// When the script or a device fails, it is not ready in time, or nothing may be opened any more; everything was then
/// ordered to close.
pub async fn open(opener: &Opener, chain: &Chain<'_>, script: &Script) -> Result<(), ActionError> {
    if is_open(opener, chain) {
        return Ok(());
    }
    let opened = run_script(&Opening { opener, chain, script }).await;
    if let Err(error) = &opened {
        let most = command_timeout(opener.authority.node.bus.clock(), CLOSED);
        // Half open is no state to leave things in; the closing itself never gives up.
        let _ = tokio::time::timeout(most, opener.authority.close(&format!("opening failed: {error}"))).await;
    }
    opened
}

async fn run_script(opening: &Opening<'_>) -> Result<(), ActionError> {
    let Opening { opener, chain, script } = *opening;
    opening.call_if_there(Function::BeforeOpen).await?;
    if script.has(Function::Open) {
        super::wait_until_known(opener).await?;
        opening.call_if_there(Function::Open).await?;
    } else {
        super::by_default(opener, chain).await?;
    }
    opening.wait_until_ready().await?;
    opening.call_if_there(Function::AfterOpen).await
}

/// Nothing is left to open.
fn is_open(opener: &Opener, chain: &Chain<'_>) -> bool {
    let is_out = |mount: &crate::devices::telescope::Mount| {
        let parked = mount.instrument.fresh().and_then(|state| state.fields.at_park.known().copied());
        parked == Some(false) || mount.instrument.can().is_some_and(|can| !can.park)
    };
    opener.devices.are_domes_open()
        && opener.devices.covers.iter().all(|cover| matches!(cover.cover(), Some(Cover::Open | Cover::NotPresent)))
        && chain.mount.is_none_or(is_out)
}

struct Opening<'a> {
    opener: &'a Opener,
    chain: &'a Chain<'a>,
    script: &'a Script,
}

/// A function under way.
struct OpeningFunction<'a> {
    opening: &'a Opening<'a>,
    function: Function,
    /// Why nothing may be opened now, if that is so.
    not_safe: OnceLock<String>,
    /// It waits for something to be opened; so it stays where the wait is dropped because its time is over.
    waits: AtomicBool,
}

impl Opening<'_> {
    async fn call_if_there(&self, function: Function) -> Result<(), ActionError> {
        if self.script.has(function) { self.call(function).await.map(drop) } else { Ok(()) }
    }

    async fn call(&self, function: Function) -> Result<Dynamic, ActionError> {
        let limit = seconds(self.opener.authority.node.config.hooks.time_limit_s);
        let most = command_timeout(self.opener.authority.node.bus.clock(), limit);
        tracing::info!(function = function.name(), "the site's script");
        let under_way =
            OpeningFunction { opening: self, function, not_safe: OnceLock::new(), waits: AtomicBool::default() };
        let result = self.script.call(function, most, &under_way).await;
        let kept_shut = || self.opener.authority.verdict.borrow().why_kept_shut();
        let waits_for = under_way.waits.into_inner().then(kept_shut).flatten();
        if let Some(error) = no_fault(&result, under_way.not_safe.into_inner(), waits_for) {
            return Err(error);
        }
        host::reported(&self.opener.authority, function, result)
    }

    /// Calls `is_ready` each second until it returns true.
    async fn wait_until_ready(&self) -> Result<(), ActionError> {
        if !self.script.has(Function::IsReady) {
            return Ok(());
        }
        let (clock, limit_s) =
            (self.opener.authority.node.bus.clock(), self.opener.authority.node.config.hooks.ready_limit_s);
        let (began, most) = (clock.machine(), command_timeout(clock, seconds(limit_s)));
        loop {
            let answer = self.call(Function::IsReady).await?;
            let late = clock.machine().since(began) >= most;
            let wrong = match answer.as_bool() {
                Ok(true) => return Ok(()),
                Ok(false) if !late => None,
                Ok(false) => Some(format!("not ready within {limit_s} s after opening")),
                Err(sort) => Some(format!("expected true or false, got {sort}")),
            };
            if let Some(why) = wrong {
                return host::reported(&self.opener.authority, Function::IsReady, Err(CallError::Failed(why)));
            }
            clock.sleep_sky(Duration::from_secs(1)).await;
        }
    }
}

/// The failure of a function that is none of the script: nothing may be opened now, or its time ran out while it waited
/// for what keeps a dome shut. It passes, and is no alert.
fn no_fault<T>(
    result: &Result<T, CallError>,
    not_safe: Option<String>,
    waits_for: Option<String>,
) -> Option<ActionError> {
    let why = match result {
        Err(CallError::Failed(_)) => not_safe,
        Err(CallError::Late { .. }) => waits_for,
        Ok(_) => None,
    };
    why.map(ActionError::NotSafe)
}

impl Host for OpeningFunction<'_> {
    async fn answer(&self, request: Request) -> HostAnswer {
        let Opening { opener, chain, .. } = *self.opening;
        self.waits.store(true, Ordering::Relaxed);
        let done = match request {
            Request::Default if self.function == Function::Open => super::by_default(opener, chain).await,
            Request::OpenDomes if self.function == Function::Open => super::open_domes(opener).await,
            Request::OpenCovers if self.function == Function::Open => super::open_covers(opener).await,
            Request::Unpark if self.function == Function::Open => super::unpark(opener, chain).await,
            other => {
                self.waits.store(false, Ordering::Relaxed);
                return host::answer(&opener.authority, &opener.devices, self.function, other).await;
            }
        };
        self.waits.store(false, Ordering::Relaxed);
        if let Err(ActionError::NotSafe(why)) = &done {
            // The first reason is the one that counts.
            let _ = self.not_safe.set(why.clone());
        }
        done.map(|()| Reply::Done).map_err(|error| error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dome_that_is_kept_shut_is_no_fault_of_the_script() {
        let failed = || Err::<(), _>(CallError::Failed("nothing is opened (line 1, position 14)".to_owned()));
        let kept_shut = || Some("safetymonitor/m: what it published is not known".to_owned());
        let error = no_fault(&failed(), kept_shut(), None).unwrap();
        assert!(matches!(&error, ActionError::NotSafe(_)) && error.may_pass(), "{error}");
        assert!(no_fault(&failed(), None, kept_shut()).is_none(), "it failed by itself");
        let late = || Err::<(), _>(CallError::Late { after_s: 600.0 });
        assert!(no_fault(&late(), kept_shut(), None).is_none(), "and went on");
        let error = no_fault(&late(), None, kept_shut()).unwrap();
        assert!(matches!(&error, ActionError::NotSafe(_)) && error.may_pass(), "it waited: {error}");
        assert!(no_fault(&Ok(()), kept_shut(), kept_shut()).is_none(), "it knew how to go on");
    }
}
