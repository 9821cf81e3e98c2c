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

use std::sync::Arc;
use std::time::Duration;

use contract::Name;
use contract::device::dome::Shutter;
use contract::observatory::AlertKind;
use sky::Icrs;
use tokio::sync::watch;
use units::{Utc, seconds};

pub use self::exposure::{ExposureThroughSlit, through_the_slit};
pub use self::follower::keep_following;
use self::view::{DomeTurner, View};
use crate::action_error::ActionError;
use crate::authority::Authority;
use crate::command_timeout::command_timeout;
use crate::devices::Devices;
use crate::devices::dome::Dome;
use crate::devices::telescope::Mount;

/// The slits of the domes, and where they are wanted.
pub struct Slits {
    /// Whether this node may act.
    pub authority: Arc<Authority>,
    /// The devices.
    pub devices: Arc<Devices>,
    /// Where a row is about to point a mount, or points it.
    pub aim: watch::Sender<Option<(Name, Icrs)>>,
}

/// A mount on its way to a target, as long as this lives.
pub struct Aimed<'a> {
    slits: &'a Slits,
}

impl<'a> Aimed<'a> {
    /// Publishes to the slits where a mount is about to look.
    pub fn at(slits: &'a Slits, mount: &Mount, target: Icrs) -> Self {
        let name: Name = mount.instrument.device.name.clone();
        slits.aim.send_replace(Some((name, target)));
        Self { slits }
    }
}

impl Drop for Aimed<'_> {
    fn drop(&mut self) {
        self.slits.aim.send_replace(None);
    }
}

/// How long a dome has to begin or to end being slaved, sky time.
const SLAVING: Duration = Duration::from_secs(30);

/// Before a shutter opens: turns the slit to where the telescope is about to look, or looks now.
///
/// A shutter that is open already is the follower's. A dome that does not turn stays shut: nothing could be observed
/// through it.
pub async fn turn_before_opening(slits: &Slits, dome: &Dome) -> Result<(), ActionError> {
    let Some(view) = View::of(slits, dome) else { return Ok(()) };
    if dome.shutter() == Some(Shutter::Open) {
        return Ok(());
    }
    dome.instrument.capabilities().await?;
    let turned = match view.way() {
        None | Some(DomeTurner::Alone | DomeTurner::Itself) => return Ok(()),
        Some(DomeTurner::Slave) => view.slave().await,
        Some(DomeTurner::Turn) => {
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
    note(slits, dome, &turned);
    turned
}

/// Waits until the shutter rests: it may still close from before.
async fn rest(dome: &Dome) -> Result<(), ActionError> {
    let most = command_timeout(dome.instrument.clock(), dome.travel);
    let rests = |received: &bus::Received<contract::DeviceState<contract::device::dome::Fields>>| {
        let shutter = received.sample.body.fields.shutter.known().copied();
        (!matches!(shutter, Some(Shutter::Opening | Shutter::Closing))).then_some(())
    };
    dome.instrument.until(most, "at rest", rests).await
}

/// The slits that a mount looks out of.
fn views_of<'a>(slits: &'a Slits, mount: Option<&Mount>) -> Vec<(&'a Dome, View<'a>)> {
    let views = slits.devices.domes.iter().filter_map(|dome| Some((dome, View::of(slits, dome)?)));
    views.filter(|(_, view)| view.is_of(mount)).collect()
}

/// Before an exposure of the sky: waits until every slit leaves the whole aperture free; one that cannot be brought
/// there in its time is a fault of the dome. `begins` gets the reason of a wait, and `ended` when it began.
pub async fn wait_until_clear(
    slits: &Slits,
    mount: Option<&Mount>,
    exposure_s: f64,
    begins: impl Fn(&str) + Send + Sync,
    ended: impl Fn(Utc) + Send + Sync,
) -> Result<(), ActionError> {
    for (dome, view) in views_of(slits, mount) {
        let (clock, mut stirred) = (dome.instrument.clock(), slits.devices.stirred());
        let most = command_timeout(clock, seconds(dome.slit.timeout_s));
        let (began, waits) = (clock.machine(), clock.utc());
        let mut has_begun = false;
        while let Err(why) = view.clear(exposure_s) {
            if clock.machine().since(began) >= most {
                let (device, verb) =
                    (dome.instrument.device.to_string(), "bring its slit to where the telescope looks");
                let late = Err(ActionError::Failed { device, verb: verb.to_owned(), reason: why });
                note(slits, dome, &late);
                return late;
            }
            if !std::mem::replace(&mut has_begun, true) {
                begins(&why);
            }
            tokio::select! {
                _ = stirred.changed() => {}
                () = tokio::time::sleep(Duration::from_millis(250)) => {}
            }
        }
        if has_begun {
            ended(waits);
        }
        // Nothing else reports on a dome that follows by itself.
        if has_begun || (dome.turning_fails() && view.way() != Some(DomeTurner::Turn)) {
            note(slits, dome, &Ok(()));
        }
    }
    Ok(())
}

/// Raises and clears the alert of a dome that does not turn.
fn note(slits: &Slits, dome: &Dome, turned: &Result<(), ActionError>) {
    if matches!(turned, Err(ActionError::Superseded { .. })) {
        // What took its place, such as a closing, says nothing of the turning.
        return;
    }
    let name = &dome.instrument.device.name;
    dome.set_turning_fails(turned.is_err());
    match turned {
        Ok(()) => slits.authority.node.alerts.clear(AlertKind::DomeNotTurned, name),
        Err(error) => slits.authority.node.alerts.raise(AlertKind::DomeNotTurned, name, &error.to_string()),
    }
}
