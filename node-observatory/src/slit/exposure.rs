//! An exposure is watched while the sky turns on: a dome that hangs, refuses or is too slow puts its wall before it.

use std::time::Duration;

use bus::{Clock, SkyTime};
use contract::CommandId;
use contract::observatory::AlertKind;
use units::seconds;

use super::light::{Light, Worth};
use super::view::View;
use super::{Slits, views_of};
use crate::action_error::ActionError;
use crate::devices::camera::Camera;
use crate::devices::dome::Dome;
use crate::devices::telescope::Mount;

/// A dome's state may be so late, machine s: a poll and the bus, with room for a busy machine.
const LATE_S: f64 = 2.0;
/// The slit is looked at at least so often.
const LOOK: Duration = Duration::from_millis(250);

/// How an exposure of the sky went, as far as the domes' slits are concerned.
#[derive(Debug)]
pub enum ExposureThroughSlit {
    /// The frame counts; so much of its light is lost, 0 to 1, if that can be seen.
    Counts(Option<f64>),
    /// It is exposed, has lost so much of its light, 0 to 1, and is to be taken again: a fault of the dome.
    Spoilt(f64, ActionError),
    /// As `Spoilt`, but it goes on still: to be aborted.
    Hopeless(f64, ActionError),
}

/// Waits until a frame is exposed, or has lost so much behind a dome that it had better be ended.
///
/// Fails as the camera does.
pub async fn through_the_slit(
    slits: &Slits,
    mount: Option<&Mount>,
    camera: &Camera,
    frame: &CommandId,
    exposure_s: f64,
) -> Result<ExposureThroughSlit, ActionError> {
    let clock = slits.authority.node.bus.clock();
    let views = views_of(slits, mount).into_iter();
    let mut watches: Vec<Watch<'_>> = views.map(|(dome, view)| Watch { dome, view, light: None }).collect();
    let mut stirred = slits.devices.stirred();
    let exposed = camera.exposed(frame, exposure_s);
    tokio::pin!(exposed);
    // A camera that is polled each 5 s reports late that it exposes; the slit is watched from its acceptance of the
    // command.
    let (accepted, mut began) = (clock.sky(), None);
    let is_over = loop {
        tokio::select! {
            biased;
            exposed = &mut exposed => {
                exposed?;
                break true;
            }
            _ = stirred.changed(), if !watches.is_empty() => {}
            () = tokio::time::sleep(LOOK), if !watches.is_empty() => {}
        }
        if began.is_none()
            && let Some(at) = begin(clock, camera, frame)
        {
            // Until now it was taken to have begun when it was accepted. What began long before, as after a restart, was
            // looked at in other moments than that: a jump over them would count their light as lost.
            if accepted.since(at).as_secs_f64() > LATE_S * clock.speed() {
                watches.iter_mut().for_each(|watch| watch.light = None);
            }
            began = Some(at);
        }
        let now_s = clock.sky().since(began.unwrap_or(accepted)).as_secs_f64();
        watches.iter_mut().for_each(|watch| watch.look(now_s, exposure_s));
        if watches.iter().any(|watch| watch.is_hopeless(clock)) {
            break false;
        }
    };
    let Some(worst) = watches.iter().max_by(|a, b| a.lost().total_cmp(&b.lost())) else {
        return Ok(ExposureThroughSlit::Counts(None));
    };
    let (name, alerts) = (&worst.dome.instrument.device.name, &slits.authority.node.alerts);
    let worth = worst.light.as_ref().map_or(Worth::Whole, Light::worth);
    let (lost, what) = match (is_over, worth) {
        (true, Worth::Whole) => {
            // The follower reports whether it turns.
            if !worst.dome.turning_fails() {
                alerts.clear(AlertKind::DomeNotTurned, name);
            }
            return Ok(ExposureThroughSlit::Counts(None));
        }
        (true, Worth::Dimmed(lost)) => return Ok(ExposureThroughSlit::Counts(Some(lost))),
        (true, Worth::Spoilt(lost)) => (lost, "is taken again"),
        (false, _) => (worst.lost(), "was ended"),
    };
    let (why, percent) = (worst.view.hidden_by(), 100.0 * lost);
    let device = worst.dome.instrument.device.to_string();
    let reason = format!("{why}; a frame lost {percent:.0} % of its light behind the dome, and {what}");
    let fault = ActionError::Failed { device, verb: "keep its slit where the telescope looks".to_owned(), reason };
    alerts.raise(AlertKind::DomeNotTurned, name, &fault.to_string());
    Ok(if is_over { ExposureThroughSlit::Spoilt(lost, fault) } else { ExposureThroughSlit::Hopeless(lost, fault) })
}

/// When a frame's exposure began, once its camera reports that it exposes.
fn begin(clock: &Clock, camera: &Camera, frame: &CommandId) -> Option<SkyTime> {
    let exposure = camera.instrument.fresh()?.fields.exposure.filter(|exposure| exposure.id == *frame)?;
    let age_s = clock.utc().seconds_since(exposure.started_utc);
    Some(clock.sky().minus(seconds(age_s.min(exposure.exposure_s))))
}

/// A dome and the light that comes through its slit.
struct Watch<'a> {
    dome: &'a Dome,
    view: View<'a>,
    light: Option<Light>,
}

impl Watch<'_> {
    fn look(&mut self, now_s: f64, exposure_s: f64) {
        self.light.get_or_insert_with(|| Light::new(exposure_s, now_s)).look(now_s, self.view.free());
    }

    fn lost(&self) -> f64 {
        self.light.as_ref().map_or(0.0, Light::lost)
    }

    fn is_hopeless(&self, clock: &Clock) -> bool {
        let sure_s = LATE_S * clock.speed();
        self.light.as_ref().is_some_and(|light| light.is_hopeless(sure_s, self.dome.slit.timeout_s))
    }
}
