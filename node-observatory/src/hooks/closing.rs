//! The script's moment before, around and after the default closing.
//!
//! The default waits for `before_close` and `close`, but never longer than `close_wait_s`, nor when they fail; it then
//! does all that it does without a script.

use std::sync::Arc;

use bus::MachineTime;
use tokio::sync::watch;
use tokio::task::JoinSet;
use units::seconds;

use super::host;
use super::line::{Answer, Host, Reply, Request};
use super::script::{Function, Script};
use crate::closing::decide::Sight;
use crate::control_room::ControlRoom;
use crate::patience::patience;

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
    pub fn begin(&mut self, room: &Arc<ControlRoom>, sight: &Sight, now: MachineTime) {
        self.running = None;
        self.calls = JoinSet::new();
        let Ok(Some(script)) = room.hooks.script() else { return };
        let for_closing = [Function::BeforeClose, Function::Close, Function::AfterClose];
        if !for_closing.into_iter().any(|function| script.has(function)) || !is_known_open(sight) {
            return;
        }
        let wait = seconds(room.node.config.hooks.close_wait_s);
        let (release, released) = watch::channel(false);
        let (closed, seen) = watch::channel(false);
        self.running = Some(Running { until: now.plus(wait), released, closed });
        let (room, script) = (room.clone(), script.clone());
        self.calls.spawn(async move { tell(&room, &script, release, seen).await });
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

/// Something is seen to be open or to move, so that this is no closing of what is unknown or closed.
fn is_known_open(sight: &Sight) -> bool {
    sight.domes.iter().any(|dome| dome.shutter.is_some() && !dome.is_closed())
        || sight.mounts.iter().any(|mount| mount.parked.is_some() && !mount.is_stopped())
        || sight.covers.iter().any(|cover| cover.cover.is_some() && !cover.is_closed())
}

async fn tell(room: &ControlRoom, script: &Script, release: watch::Sender<bool>, mut closed: watch::Receiver<bool>) {
    let most = patience(room.node.bus.clock(), seconds(room.node.config.hooks.time_limit_s));
    for function in [Function::BeforeClose, Function::Close] {
        if !script.has(function) {
            continue;
        }
        tracing::info!(function = function.name(), "the site's script");
        let doing = Doing { room, function, release: &release, closed: closed.clone() };
        let result = script.call(function, most, &doing).await;
        if host::told(room, function, result).is_err() {
            break;
        }
    }
    release.send_replace(true);
    if script.has(Function::AfterClose) && closed.wait_for(|closed| *closed).await.is_ok() {
        let function = Function::AfterClose;
        let result = script.call(function, most, &Doing { room, function, release: &release, closed }).await;
        // Its alert reports the result.
        let _ = host::told(room, function, result);
    }
}

struct Doing<'a> {
    room: &'a ControlRoom,
    function: Function,
    release: &'a watch::Sender<bool>,
    closed: watch::Receiver<bool>,
}

impl Host for Doing<'_> {
    async fn answer(&self, request: Request) -> Answer {
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
            other => host::answer(self.room, self.function, other).await,
        }
    }
}
