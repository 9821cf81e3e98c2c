//! The script's moment before, around and after the default closing.
//!
//! The default waits for `before_close` and `close`, but never longer than `close_wait_s`, nor when they fail; it then
//! does all that it does without a script.

use std::sync::Arc;

use bus::MachineTime;
use tokio::sync::watch;
use tokio::task::JoinSet;
use units::seconds;

use super::line::{Host, HostAnswer, Reply, Request};
use super::script::{Function, Script};
use super::{ScriptedSite, host};
use crate::command_timeout::command_timeout;

/// The script at a closing.
#[derive(Default)]
pub struct AtClosing {
    running: Option<Running>,
    /// The functions under way; a new closing ends those of the one before.
    calls: JoinSet<()>,
}

struct Running {
    until: MachineTime,
    released: watch::Receiver<bool>,
    closed: watch::Sender<bool>,
}

impl AtClosing {
    /// A closing begins. Parts that are not known to be open are closed without a call of the script.
    pub fn begin(&mut self, site: &Arc<ScriptedSite>, is_known_open: bool, now: MachineTime) {
        self.running = None;
        self.calls = JoinSet::new();
        let Ok(Some(script)) = site.hooks.script() else { return };
        let for_closing = [Function::BeforeClose, Function::Close, Function::AfterClose];
        if !for_closing.into_iter().any(|function| script.has(function)) || !is_known_open {
            return;
        }
        let wait = seconds(site.authority.node.config.hooks.close_wait_s);
        let (release, released) = watch::channel(false);
        let (closed, seen) = watch::channel(false);
        self.running = Some(Running { until: now.plus(wait), released, closed });
        let (site, script) = (site.clone(), script.clone());
        self.calls.spawn(async move { run_script(&site, &script, release, seen).await });
    }

    /// Nothing calls for closing any more; `after_close` may still run if everything was closed.
    pub fn end(&mut self) {
        self.running = None;
    }

    /// Must the default wait?
    pub fn holds(&self, now: MachineTime) -> bool {
        let waits = |running: &Running| now < running.until && !*running.released.borrow();
        // The other end is gone where the script is over, however it ended.
        self.running.as_ref().is_some_and(|running| waits(running) && running.released.has_changed().is_ok())
    }

    /// Informs the script whether everything is verified closed.
    pub fn see(&self, is_closed: bool) {
        if let Some(running) = &self.running {
            running.closed.send_if_modified(|closed| std::mem::replace(closed, is_closed) != is_closed);
        }
    }

    /// Ends when the default need not wait any longer; never, where it does not wait.
    pub async fn freed(&mut self, now: MachineTime) {
        let holds = self.holds(now);
        let Some(running) = self.running.as_mut().filter(|_| holds) else { return std::future::pending().await };
        // The script's end counts as a release, and so does the end of the wait.
        let _ = tokio::time::timeout(running.until.since(now), running.released.changed()).await;
    }
}

async fn run_script(
    site: &ScriptedSite,
    script: &Script,
    release: watch::Sender<bool>,
    mut closed: watch::Receiver<bool>,
) {
    let most = command_timeout(site.authority.node.bus.clock(), seconds(site.authority.node.config.hooks.time_limit_s));
    for function in [Function::BeforeClose, Function::Close] {
        if !script.has(function) {
            continue;
        }
        tracing::info!(function = function.name(), "the site's script");
        let doing = ClosingFunction { site, function, release: &release, closed: closed.clone() };
        let result = script.call(function, most, &doing).await;
        if host::reported(&site.authority, function, result).is_err() {
            break;
        }
    }
    release.send_replace(true);
    if script.has(Function::AfterClose) && closed.wait_for(|closed| *closed).await.is_ok() {
        let function = Function::AfterClose;
        let result = script.call(function, most, &ClosingFunction { site, function, release: &release, closed }).await;
        // Its alert reports the result.
        let _ = host::reported(&site.authority, function, result);
    }
}

struct ClosingFunction<'a> {
    site: &'a ScriptedSite,
    function: Function,
    release: &'a watch::Sender<bool>,
    closed: watch::Receiver<bool>,
}

impl Host for ClosingFunction<'_> {
    async fn answer(&self, request: Request) -> HostAnswer {
        match request {
            Request::Default if self.function == Function::Close => {
                self.release.send_replace(true);
                let mut closed = self.closed.clone();
                let verified = closed.wait_for(|closed| *closed).await.is_ok();
                if verified {
                    Ok(Reply::Done)
                } else {
                    Err("the closing ended before all was verified closed".to_owned())
                }
            }
            other => host::answer(&self.site.authority, &self.site.devices, self.function, other).await,
        }
    }
}
