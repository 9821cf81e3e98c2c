//! Opening as the site's script has it; whatever fails in it is closed by default.

use std::time::Duration;

use contract::device::cover_calibrator::Cover;
use contract::device::dome::Shutter;
use rhai::Dynamic;
use units::seconds;

use super::call::CallError;
use super::host;
use super::line::{Answer, Host, Reply, Request};
use super::script::{Function, Script};
use crate::control_room::ControlRoom;
use crate::opening;
use crate::patience::patience;
use crate::rig::Chain;
use crate::trouble::Trouble;

/// After a failure the closing is waited for so long, sky time; it goes on by itself.
const CLOSED: Duration = Duration::from_secs(300);

/// Opens, unless everything is open already.
///
/// # Errors
/// When the script or a device fails, or it is not ready in time; everything was then ordered to close.
pub async fn open(room: &ControlRoom, chain: &Chain<'_>, script: &Script) -> Result<(), Trouble> {
    if is_open(room, chain) {
        return Ok(());
    }
    let opened = tell(&Opening { room, chain, script }).await;
    if let Err(trouble) = &opened {
        let most = patience(room.node.bus.clock(), CLOSED);
        // Half open is no state to leave things in; the closing itself never gives up.
        let _ = tokio::time::timeout(most, room.close(&format!("opening failed: {trouble}"))).await;
    }
    opened
}

async fn tell(opening: &Opening<'_>) -> Result<(), Trouble> {
    let Opening { room, chain, script } = *opening;
    opening.call_if_there(Function::BeforeOpen).await?;
    if script.has(Function::Open) {
        opening.call_if_there(Function::Open).await?;
    } else {
        opening::by_default(room, chain).await?;
    }
    opening.wait_until_ready().await?;
    opening.call_if_there(Function::AfterOpen).await
}

/// Nothing is left to open.
fn is_open(room: &ControlRoom, chain: &Chain<'_>) -> bool {
    let is_out = |mount: &crate::rig::telescope::Mount| {
        let parked = mount.instrument.fresh().and_then(|state| state.fields.at_park.known().copied());
        parked == Some(false) || mount.instrument.can().is_some_and(|can| !can.park)
    };
    room.rig.domes.iter().all(|dome| dome.shutter() == Some(Shutter::Open))
        && room.rig.covers.iter().all(|cover| matches!(cover.cover(), Some(Cover::Open | Cover::NotPresent)))
        && chain.mount.is_none_or(is_out)
}

struct Opening<'a> {
    room: &'a ControlRoom,
    chain: &'a Chain<'a>,
    script: &'a Script,
}

/// A function under way.
struct Doing<'a> {
    opening: &'a Opening<'a>,
    function: Function,
}

impl Opening<'_> {
    async fn call_if_there(&self, function: Function) -> Result<(), Trouble> {
        if self.script.has(function) { self.call(function).await.map(drop) } else { Ok(()) }
    }

    async fn call(&self, function: Function) -> Result<Dynamic, Trouble> {
        let limit = seconds(self.room.node.config.hooks.time_limit_s);
        let most = patience(self.room.node.bus.clock(), limit);
        tracing::info!(function = function.name(), "the site's script");
        let result = self.script.call(function, most, &Doing { opening: self, function }).await;
        host::told(self.room, function, result)
    }

    /// Calls `is_ready` each second until it returns true.
    async fn wait_until_ready(&self) -> Result<(), Trouble> {
        if !self.script.has(Function::IsReady) {
            return Ok(());
        }
        let (clock, limit_s) = (self.room.node.bus.clock(), self.room.node.config.hooks.ready_limit_s);
        let (began, most) = (clock.machine(), patience(clock, seconds(limit_s)));
        loop {
            let said = self.call(Function::IsReady).await?;
            let late = clock.machine().since(began) >= most;
            let wrong = match said.as_bool() {
                Ok(true) => return Ok(()),
                Ok(false) if !late => None,
                Ok(false) => Some(format!("not ready within {limit_s} s after opening")),
                Err(sort) => Some(format!("expected true or false, got {sort}")),
            };
            if let Some(why) = wrong {
                return host::told(self.room, Function::IsReady, Err(CallError::Failed(why)));
            }
            clock.sleep_sky(Duration::from_secs(1)).await;
        }
    }
}

impl Host for Doing<'_> {
    async fn answer(&self, request: Request) -> Answer {
        let Opening { room, chain, .. } = *self.opening;
        let done = match request {
            Request::Default if self.function == Function::Open => opening::by_default(room, chain).await,
            Request::OpenDomes if self.function == Function::Open => opening::open_domes(room).await,
            Request::OpenCovers if self.function == Function::Open => opening::open_covers(room).await,
            Request::Unpark if self.function == Function::Open => opening::unpark(room, chain).await,
            other => return host::answer(room, self.function, other).await,
        };
        done.map(|()| Reply::Done).map_err(|trouble| trouble.to_string())
    }
}
