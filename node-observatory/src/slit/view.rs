//! One dome and the mount that looks out of it: who turns, where to, and whether the view is free.

use config::Follow;
use contract::device::dome::{Capabilities, Command, Fields};
use contract::device::telescope::{EquatorialSystem, PierSide};
use sky::slit::{Aim, Slit, TubeSide};
use sky::{Horizontal, Icrs, Observer, OfDate};
use units::{Angle, seconds};

use super::{SLAVING, Slits};
use crate::action_error::ActionError;
use crate::devices::dome::Dome;
use crate::devices::telescope::Mount;

/// The part that turns a dome.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DomeTurner {
    /// Nobody: there is nothing to turn and nothing to wait for.
    Alone,
    /// This node.
    Turn,
    /// The dome, once this node slaves it.
    Slave,
    /// The dome, because another program has slaved it.
    Itself,
}

/// Which part turns a dome with these capabilities and this slaving.
pub fn way(follow: Follow, can: &Capabilities, slaved: Option<bool>) -> DomeTurner {
    match follow {
        Follow::Off => DomeTurner::Alone,
        Follow::Turn => DomeTurner::Turn,
        Follow::Slave => DomeTurner::Slave,
        Follow::Auto if slaved == Some(true) => DomeTurner::Itself,
        Follow::Auto if can.set_azimuth => DomeTurner::Turn,
        Follow::Auto => DomeTurner::Alone,
    }
}

/// A mount that is so near to where it was sent has arrived; mounts use coordinates of date or of J2000, and point
/// with errors.
const THERE: Angle = Angle::from_degrees(2.0);
/// So far ahead the best azimuth is looked for, sky s.
const AHEAD_S: f64 = 4.0 * 3600.0;
/// A turn begins so long before it is needed, sky s ...
const LEAD_S: f64 = 60.0;
/// ... and so much longer for what polls, the bus and the dome's start take, machine s ...
const LAG_S: f64 = 3.0;
/// ... and for each degree of it, which takes a slow dome so long, s.
const S_PER_DEG: f64 = 1.0;
/// A turn that gains less than this, sky s, waits.
const GAIN_S: f64 = 60.0;

/// A dome and its mount.
pub struct View<'a> {
    slits: &'a Slits,
    dome: &'a Dome,
    mount: &'a Mount,
    slit: Slit,
    error: Angle,
}

impl<'a> View<'a> {
    /// The view out of a dome; none where there is nothing to follow.
    pub fn of(slits: &'a Slits, dome: &'a Dome) -> Option<Self> {
        if dome.follow == Follow::Off {
            return None;
        }
        let mount = slits.devices.mount_under(dome)?;
        let latitude = Angle::from_degrees(slits.authority.node.config.place.latitude_deg);
        let slit = geometry(latitude, &dome.slit, &mount.config);
        Some(Self { slits, dome, mount, slit, error: Angle::from_degrees(dome.slit.error_deg) })
    }

    /// Does this mount look out of it?
    pub fn is_of(&self, mount: Option<&Mount>) -> bool {
        mount.is_some_and(|mount| mount.instrument.device == self.mount.instrument.device)
    }

    /// The part that turns it; `None` while that is not known.
    pub fn way(&self) -> Option<DomeTurner> {
        let slaved = self.fields().and_then(|fields| fields.slaved.known().copied());
        let mut can = self.dome.instrument.can()?;
        // Nobody knows whether it can turn; a roof has no azimuth.
        can.set_azimuth &= !self.dome.instrument.is_unread("CanSetAzimuth") || self.azimuth().is_some();
        Some(way(self.dome.follow, &can, slaved))
    }

    /// The newest state of the dome, however old: the dome is where it was then.
    fn fields(&self) -> Option<Fields> {
        self.dome.instrument.newest().map(|received| received.sample.body.fields)
    }

    fn azimuth(&self) -> Option<Angle> {
        self.dome.azimuth_deg().map(Angle::from_degrees)
    }

    /// Where the telescope looks, or is about to: a slew counts as its end from its first moment on. None while it
    /// follows nothing.
    pub fn aim(&self) -> Option<Aim> {
        let fields = self.mount.instrument.fresh().map(|state| state.fields);
        let follows =
            fields.is_some_and(|mount| mount.slewing.known() == Some(&false) && mount.tracking.known() == Some(&true));
        let now = self.mount_aim().filter(|_| follows);
        let aim = self.slits.aim.borrow().clone();
        let Some((_, target)) = aim.filter(|(name, _)| *name == self.mount.instrument.device.name) else { return now };
        let apparent = self.observer()?.to_of_date(&target);
        let target = self.at(apparent)?;
        now.filter(|now| now.separation(&target) < THERE).or(Some(target))
    }

    /// Where the mount is, whether it follows anything or not.
    pub fn mount_aim(&self) -> Option<Aim> {
        let mount = self.mount.instrument.newest()?.sample.body.fields;
        let pair = |a: Option<&f64>, b: Option<&f64>| Some((*a?, *b?)).filter(|(a, b)| a.is_finite() && b.is_finite());
        let aim = if let Some((ra, dec)) = pair(mount.ra_deg.known(), mount.dec_deg.known()) {
            self.at(match self.mount.frame() {
                EquatorialSystem::Topocentric => OfDate::from_degrees(ra, dec),
                _ => self.observer()?.to_of_date(&Icrs::from_degrees(ra, dec)),
            })?
        } else {
            let (altitude, azimuth) = pair(mount.altitude_deg.known(), mount.azimuth_deg.known())?;
            Aim::towards(&Horizontal::from_degrees(altitude, azimuth), self.slit.latitude)
        };
        Some(match mount.pier_side.known() {
            Some(PierSide::East) => aim.on(TubeSide::East),
            Some(PierSide::West) => aim.on(TubeSide::West),
            Some(PierSide::Unknown) | None => aim,
        })
    }

    fn at(&self, apparent: OfDate) -> Option<Aim> {
        Some(Aim::at(self.observer()?.sidereal_time() - apparent.ra, apparent.dec))
    }

    fn observer(&self) -> Option<Observer> {
        self.slits.authority.observer(self.slits.authority.node.bus.clock().utc()).ok()
    }

    /// Is the view free, and will it be through an exposure? Else why not.
    pub fn clear(&self, exposure_s: f64) -> Result<(), String> {
        let Some(way) = self.way() else { return Err("the dome has not yet published its capabilities".to_owned()) };
        if way == DomeTurner::Alone {
            return Ok(());
        }
        let fields = self.fields().unwrap_or_default();
        if fields.slewing.known() == Some(&true) {
            return Err("the dome turns".to_owned());
        }
        if way == DomeTurner::Slave && fields.slaved.known() != Some(&true) {
            return Err("the dome is not slaved to the mount".to_owned());
        }
        if way != DomeTurner::Turn && self.dome.slit.width_m.is_none() {
            // A dome that follows by itself knows its geometry; here nothing is known to judge it by.
            return Ok(());
        }
        // Nothing turns the slit if the dome does not turn; the next move of a dome that follows by itself is not
        // known.
        let need_s = if way == DomeTurner::Turn && self.dome.turning_fails() { exposure_s } else { 0.0 };
        self.is_clear(need_s)
    }

    fn is_clear(&self, need_s: f64) -> Result<(), String> {
        let Some(aim) = self.aim() else { return Err("the mount does not say where it looks".to_owned()) };
        let Some(azimuth) = self.azimuth() else { return Err("the dome does not say its azimuth".to_owned()) };
        if self.slit.clear_for_s(&aim, azimuth, self.error, need_s).is_some_and(|s| s >= need_s) {
            return Ok(());
        }
        let stands = format!("the slit stands at {:.1} deg", azimuth.wrapped_positive().degrees());
        Err(match self.slit.clear(&aim) {
            Some(arc) => {
                let (middle, half) = (arc.middle().degrees(), 0.5 * arc.width().degrees());
                format!("{stands} and must stand within {half:.1} deg of {middle:.1} deg")
            }
            None => format!("{stands}; at no azimuth does it leave the whole aperture free"),
        })
    }

    /// The part of the aperture that looks out free now, 0 to 1, whether the dome turns or not. Zero where that is not
    /// known: a frame is to be taken of the sky for sure.
    pub fn free(&self) -> f64 {
        let Some(way) = self.way() else { return 0.0 };
        let strays = self.fields().is_some_and(|fields| fields.slaved.known() == Some(&false));
        let unknown = self.dome.slit.width_m.is_none() && way != DomeTurner::Turn && !strays;
        if way == DomeTurner::Alone || unknown {
            return 1.0;
        }
        self.aim().zip(self.azimuth()).map_or(0.0, |(aim, azimuth)| self.slit.free(&aim, azimuth))
    }

    /// What hides a part of the view, in words.
    pub fn hidden_by(&self) -> String {
        self.is_clear(0.0).err().unwrap_or_else(|| "the slit hid a part of the aperture".to_owned())
    }

    /// Where the slit is to be turned now, if it is.
    pub fn better(&self, aim: &Aim) -> Option<Angle> {
        let Some(azimuth) = self.azimuth() else { return Some(self.slit.azimuth(aim)) };
        better(&self.slit, aim, azimuth, self.error, self.slits.authority.node.bus.clock().speed())
    }

    /// Turns the slit, and waits until it is there.
    pub async fn turn(&self, azimuth: Angle) -> Result<(), ActionError> {
        let dome = &self.dome.instrument;
        let azimuth_deg = (azimuth.wrapped_positive().degrees() * 10.0).round() / 10.0 % 360.0;
        if self.fields().is_some_and(|fields| fields.slaved.known() == Some(&true)) {
            dome.execute(Command::Slave { on: false }, SLAVING).await?;
        }
        tracing::info!(dome = %dome.device.name, azimuth_deg, "turning the slit");
        self.dome.forget_azimuth();
        let state = dome.execute(Command::SlewToAzimuth { azimuth_deg }, seconds(self.dome.slit.timeout_s)).await?;
        let stands = state.fields.azimuth_deg.known();
        match stands.and_then(|stands| missed(&self.dome.slit, *stands, azimuth_deg)) {
            Some(reason) => {
                let (device, verb) = (dome.device.to_string(), format!("turn to {azimuth_deg:.1} deg"));
                Err(ActionError::Failed { device, verb, reason })
            }
            None => Ok(()),
        }
    }

    /// Lets the dome follow by itself.
    pub async fn slave(&self) -> Result<(), ActionError> {
        if self.is_slaved() {
            return Ok(());
        }
        self.dome.instrument.execute(Command::Slave { on: true }, SLAVING).await.map(|_| ())
    }

    /// Does the dome report that it follows by itself?
    pub fn is_slaved(&self) -> bool {
        self.fields().is_some_and(|fields| fields.slaved.known() == Some(&true))
    }
}

/// Why a turn that has ended did not arrive, if so: by the tolerance by which its device node calls it done.
fn missed(slit: &config::Slit, stands_deg: f64, asked_deg: f64) -> Option<String> {
    let off_deg = Angle::from_degrees(stands_deg - asked_deg).wrapped_signed().abs().degrees();
    (off_deg > slit.arrived_deg().max(0.1)).then(|| format!("it stands at {stands_deg:.1} deg"))
}

/// Where a slit at `azimuth` is to be turned now, if it is: only when it hides a part of the view or will
/// before a turn that begins later could be done, and then to where it stays clear for longest.
fn better(slit: &Slit, aim: &Aim, azimuth: Angle, error: Angle, speed: f64) -> Option<Angle> {
    let least_s = LEAD_S + LAG_S * speed;
    let most_s = least_s + 180.0 * S_PER_DEG;
    let clear_s = slit.clear_for_s(aim, azimuth, error, most_s);
    if clear_s.is_some_and(|s| s >= most_s) {
        return None;
    }
    // The dome may stop off its aim.
    let Some((to, lasts_s)) = slit.lasting(aim, azimuth, error + error, AHEAD_S) else {
        // As near as can be; what it hides is reported when it matters.
        let to = slit.azimuth(aim);
        return ((to - azimuth).wrapped_signed().abs() > error).then_some(to);
    };
    let Some(clear_s) = clear_s else { return Some(to) };
    let lead_s = least_s + S_PER_DEG * (to - azimuth).wrapped_signed().abs().degrees();
    // A sky so fast that it outruns any lead is not turned after at every look.
    (clear_s < lead_s.min(lasts_s / 3.0) && lasts_s >= clear_s + GAIN_S).then_some(to)
}

/// What the configuration knows of a dome and a mount in it.
fn geometry(latitude: Angle, dome: &config::Slit, mount: &config::Telescope) -> Slit {
    let (Some(width_m), Some(radius_m)) = (dome.width_m, dome.radius_m) else {
        return Slit::of_tolerance(latitude, Angle::from_degrees(dome.tolerance_deg));
    };
    Slit {
        latitude,
        radius_m,
        width_m,
        past_zenith_m: dome.past_zenith_m.unwrap_or(0.5 * width_m),
        axes_m: [dome.east_m, dome.north_m, dome.up_m],
        arm_m: mount.arm_m,
        // The configuration's check asks for it together with a width.
        aperture_m: mount.aperture_m.unwrap_or_default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn deg(degrees: f64) -> Angle {
        Angle::from_degrees(degrees)
    }

    #[test]
    fn a_turn_that_its_device_node_calls_done_has_arrived() {
        let unknown = config::Slit::default();
        let known = config::Slit { width_m: Some(2.0), radius_m: Some(3.0), ..unknown };
        assert_eq!(missed(&unknown, 359.2, 1.0), None, "tolerance_deg is all that is known of this dome");
        assert_eq!(missed(&known, 75.8, 77.2).as_deref(), Some("it stands at 75.8 deg"));
        assert_eq!((missed(&known, 76.4, 77.2), missed(&unknown, 70.0, 77.2).is_some()), (None, true));
    }

    #[test]
    fn who_turns_is_settled_by_the_word_of_the_site_and_of_the_dome() {
        let can = |set_azimuth| Capabilities { set_azimuth, ..Capabilities::default() };
        for (follow, turns, slaved, expected) in [
            (Follow::Auto, true, Some(false), DomeTurner::Turn),
            (Follow::Auto, true, None, DomeTurner::Turn),
            (Follow::Auto, true, Some(true), DomeTurner::Itself),
            (Follow::Auto, false, None, DomeTurner::Alone),
            (Follow::Turn, false, Some(true), DomeTurner::Turn),
            (Follow::Slave, false, Some(false), DomeTurner::Slave),
            (Follow::Off, true, Some(true), DomeTurner::Alone),
        ] {
            assert_eq!(way(follow, &can(turns), slaved), expected, "{follow:?} {turns} {slaved:?}");
        }
    }

    #[test]
    fn a_slit_that_is_clear_for_long_rests_and_one_that_will_not_be_turns_ahead() {
        let slit = Slit::of_tolerance(deg(-24.6), deg(5.0));
        let aim = Aim::at(deg(-45.0), deg(-30.0));
        let wanted = better(&slit, &aim, deg(300.0), deg(1.0), 1.0).unwrap();
        assert_eq!(better(&slit, &aim, wanted, deg(1.0), 1.0), None, "it has just turned there");
        // It is followed to the end of what is clear, and turned before that.
        let clear_s = slit.clear_for_s(&aim, wanted, deg(1.0), 1e5).unwrap();
        assert!(clear_s > 600.0, "{clear_s}");
        let soon = aim.after(clear_s - 30.0);
        assert!(slit.clear(&soon).unwrap().contains(wanted));
        assert!(better(&slit, &soon, wanted, deg(1.0), 1.0).is_some());
        assert_eq!(better(&slit, &aim.after(clear_s - 600.0), wanted, deg(1.0), 1.0), None);
    }

    #[test]
    fn where_nothing_is_clear_the_slit_goes_as_near_as_can_be_and_stays_there() {
        let slit = Slit { aperture_m: 1.0, ..Slit::of_tolerance(deg(-24.6), deg(5.0)) };
        let aim = Aim::at(deg(-45.0), deg(-30.0));
        let wanted = better(&slit, &aim, deg(300.0), deg(1.0), 1.0).unwrap();
        assert_eq!(better(&slit, &aim, wanted, deg(1.0), 1.0), None);
    }
}
