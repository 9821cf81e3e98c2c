//! The dome's slit: where the telescope looks before the shutter opens, and as long as it is open.
//!
//! ```text
//!  opening: turned first, then opened ---> open, and followed ---> something must close: nothing is turned any more
//!                                            |          ^
//!                     the slit hides a part, |          |  turned ahead, to where it stays clear for longest,
//!                     or will before long    +----------+  for a slew straight to its end
//! ```
//! `dome.follow` and the dome's own state settle which part turns a dome ([`view`]). The geometry is `sky::slit`. An
//! exposure of the sky waits until the slit is clear ([`wait_until_clear`]), and is watched while it runs: the light
//! that it loses behind a dome that does not follow is summed, and decides what becomes of the frame ([`exposure`],
//! [`light`]). Closing waits for nothing here: a turn is a command like any other, which closing interrupts, and none
//! is given to a dome that closes, is closed, or should be ([`follower`]).

mod exposure;
mod follower;
mod light;
mod view;

use std::time::Duration;

use contract::Name;
use contract::device::dome::Shutter;
use contract::observatory::AlertKind;
use sky::Icrs;

pub use self::exposure::{Seen, through_the_slit};
pub use self::follower::keep_following;
use self::view::{View, Way};
use units::seconds;

use crate::action::Stage;
use crate::control_room::ControlRoom;
use crate::patience::patience;
use crate::rig::dome::Dome;
use crate::rig::telescope::Mount;
use crate::trouble::Trouble;
use schedule::plan::overheads::Span;

/// A mount on its way to a target, as long as this lives.
pub struct Aimed<'a> {
    room: &'a ControlRoom,
}

impl<'a> Aimed<'a> {
    /// Publishes to the slits where a mount is about to look.
    pub fn at(room: &'a ControlRoom, mount: &Mount, target: Icrs) -> Self {
        let name: Name = mount.instrument.device.name.clone();
        room.aim.send_replace(Some((name, target)));
        Self { room }
    }
}

impl Drop for Aimed<'_> {
    fn drop(&mut self) {
        self.room.aim.send_replace(None);
    }
}

/// How long a dome has to begin or to end being slaved, sky time.
const SLAVING: Duration = Duration::from_secs(30);

/// Before a shutter opens: turns the slit to where the telescope is about to look, or looks now.
///
/// A shutter that is open already is the follower's. A dome that does not turn stays shut: nothing could be observed
/// through it.
pub async fn turn_before_opening(room: &ControlRoom, dome: &Dome) -> Result<(), Trouble> {
    let Some(view) = View::of(room, dome) else { return Ok(()) };
    if dome.shutter() == Some(Shutter::Open) {
        return Ok(());
    }
    dome.instrument.capabilities().await?;
    let turned = match view.way() {
        None | Some(Way::Alone | Way::Itself) => return Ok(()),
        Some(Way::Slave) => view.slave().await,
        Some(Way::Turn) => {
            rest(dome).await?;
            let Some(aim) = view.aim().or_else(|| view.mount_aim()) else {
                tracing::info!(dome = %dome.instrument.device.name, "opened without turning: where to is not known");
                return Ok(());
            };
            match view.better(&aim) {
                Some(azimuth) => view.turn(azimuth).await,
                None => Ok(()),
            }
        }
    };
    note(room, dome, &turned);
    turned
}

/// Waits until the shutter rests: it may still close from before.
async fn rest(dome: &Dome) -> Result<(), Trouble> {
    let most = patience(dome.instrument.clock(), dome.travel);
    let rests = |heard: &bus::Heard<contract::DeviceState<contract::device::dome::Fields>>| {
        let shutter = heard.said.body.fields.shutter.known().copied();
        (!matches!(shutter, Some(Shutter::Opening | Shutter::Closing))).then_some(())
    };
    dome.instrument.until(most, "at rest", rests).await
}

/// The slits that the row's telescope looks out of.
fn views_of(stage: &Stage) -> Result<Vec<(&Dome, View<'_>)>, Trouble> {
    let (room, mount) = (&*stage.room, stage.chain()?.mount);
    let views = room.rig.domes.iter().filter_map(|dome| Some((dome, View::of(room, dome)?)));
    Ok(views.filter(|(_, view)| view.is_of(mount)).collect())
}

/// Before an exposure of the sky: waits until every slit leaves the whole aperture free; one that cannot be brought
/// there in its time is a fault of the dome.
pub async fn wait_until_clear(stage: &Stage, exposure_s: f64) -> Result<(), Trouble> {
    let room = &*stage.room;
    for (dome, view) in views_of(stage)? {
        let (clock, mut stirred) = (dome.instrument.clock(), room.rig.stirred());
        let most = patience(clock, seconds(dome.slit.timeout_s));
        let (began, waits) = (clock.machine(), clock.utc());
        let mut told = false;
        while let Err(why) = view.clear(exposure_s) {
            if clock.machine().since(began) >= most {
                let (device, verb) =
                    (dome.instrument.device.to_string(), "bring its slit to where the telescope looks");
                let late = Err(Trouble::Failed { device, verb: verb.to_owned(), reason: why });
                note(room, dome, &late);
                return late;
            }
            if !std::mem::replace(&mut told, true) {
                stage.step(format!("waiting for the dome's slit: {why}"));
            }
            tokio::select! {
                _ = stirred.changed() => {}
                () = tokio::time::sleep(Duration::from_millis(250)) => {}
            }
        }
        if told {
            stage.took(Span::Slit, waits);
        }
        // Nothing else reports on a dome that follows by itself.
        if told || (dome.turning_fails() && view.way() != Some(Way::Turn)) {
            note(room, dome, &Ok(()));
        }
    }
    Ok(())
}

/// Raises and clears the alert of a dome that does not turn.
fn note(room: &ControlRoom, dome: &Dome, turned: &Result<(), Trouble>) {
    let name = &dome.instrument.device.name;
    dome.set_turning_fails(turned.is_err());
    match turned {
        Ok(()) => room.node.alerts.clear(AlertKind::DomeNotTurned, name),
        Err(trouble) => room.node.alerts.raise(AlertKind::DomeNotTurned, name, &trouble.to_string()),
    }
}
