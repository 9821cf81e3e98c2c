//! What does not hold of a device's block, in words that begin with the key.

use std::collections::BTreeSet;

use contract::Name;

use crate::device::{Camera, Dome, Focuser, Telescope};
use crate::observatory::Observatory;
use crate::slit::{Follow, Slit};

/// Finest and coarsest size of a pixel that a camera may be given, arcsec: a planetary camera, a fish-eye.
const SCALES_ARCSEC_PX: std::ops::RangeInclusive<f64> = 0.01..=600.0;

/// What is wrong with a camera's block, as far as its frames are solved.
pub(crate) fn camera(camera: &Camera) -> Option<String> {
    let scale = camera.scale_arcsec_px.filter(|scale| !SCALES_ARCSEC_PX.contains(scale))?;
    Some(format!("scale_arcsec_px = {scale}: expected 0.01 to 600, arcsec of an unbinned pixel"))
}

/// What does not hold of a focuser, in words that begin with the key.
pub(crate) fn focuser(focuser: &Focuser) -> Vec<String> {
    let mut found = Vec::new();
    if !(0..=1_000_000).contains(&focuser.backlash_steps) {
        found.push(format!("backlash_steps = {}: expected 0 to 1000000 steps", focuser.backlash_steps));
    }
    if let Some(steps) = focuser.search_steps.filter(|steps| !(2..=1_000_000).contains(steps)) {
        found.push(format!("search_steps = {steps}: expected 2 to 1000000 steps"));
    }
    found
}

/// What does not hold of a mount's sizes, in words.
pub(crate) fn mount(mount: &Telescope) -> Vec<String> {
    let mut found = Vec::new();
    if let Some(aperture_m) = mount.aperture_m.filter(|aperture_m| !(0.01..=20.0).contains(aperture_m)) {
        found.push(format!("aperture_m = {aperture_m}: expected 0.01 to 20"));
    }
    if !(0.0..=20.0).contains(&mount.arm_m) {
        found.push(format!("arm_m = {}: expected 0 to 20", mount.arm_m));
    }
    found
}

impl Slit {
    /// What does not hold, in words that begin with the key; `mounts` are those that may stand in this dome.
    fn faults(&self, mounts: &[Telescope]) -> Vec<String> {
        let mut found = Vec::new();
        for (key, value, low, high) in [
            ("width_m", self.width_m, 0.05, 50.0),
            ("radius_m", self.radius_m, 0.3, 50.0),
            ("past_zenith_m", self.past_zenith_m, 0.0, 50.0),
            ("east_m", Some(self.east_m), -50.0, 50.0),
            ("north_m", Some(self.north_m), -50.0, 50.0),
            ("up_m", Some(self.up_m), -50.0, 50.0),
            ("tolerance_deg", Some(self.tolerance_deg), 0.5, 45.0),
            ("error_deg", Some(self.error_deg), 0.0, 10.0),
            ("timeout_s", Some(self.timeout_s), 10.0, 3600.0),
        ] {
            if let Some(value) = value.filter(|value| !(low..=high).contains(value)) {
                found.push(format!("{key} = {value}: expected {low} to {high}"));
            }
        }
        if !found.is_empty() {
            return found;
        }
        match (self.width_m, self.radius_m) {
            (Some(width_m), Some(radius_m)) => found.extend(self.misfits(width_m, radius_m, mounts)),
            (None, None) => {}
            _ => found.push("width_m and radius_m go together; give both or neither".to_owned()),
        }
        found
    }

    /// What does not fit into a dome of this size.
    fn misfits(&self, width_m: f64, radius_m: f64, mounts: &[Telescope]) -> Vec<String> {
        let mut found = Vec::new();
        if width_m >= 2.0 * radius_m {
            found.push(format!("width_m = {width_m}: is wider than the dome of radius_m = {radius_m}"));
        }
        let away_m = self.east_m.hypot(self.north_m).hypot(self.up_m);
        for mount in mounts {
            let name = &mount.common.name;
            let Some(aperture_m) = mount.aperture_m else {
                found.push(format!("width_m: telescope \"{name}\" needs aperture_m, to know when it looks out free"));
                continue;
            };
            if aperture_m >= width_m {
                let why = format!("telescope \"{name}\" with aperture_m = {aperture_m} cannot look out");
                found.push(format!("width_m = {width_m}: {why}"));
            }
            if away_m + mount.arm_m + 0.5 * aperture_m >= radius_m {
                let why = format!("telescope \"{name}\" would look from outside: east_m, north_m, up_m, arm_m");
                found.push(format!("radius_m = {radius_m}: {why}"));
            }
        }
        found
    }
}

/// What does not hold of a dome's following, in words; `shared` in the file of a site's shared devices.
pub(crate) fn dome(dome: &Dome, mounts: &[Telescope], shared: bool) -> Vec<String> {
    let slit = dome.slit.faults(mounts).into_iter().map(|fault| format!("slit.{fault}"));
    let mut found: Vec<String> = slit.collect();
    let over_several = shared || dome.telescopes.len() > 1;
    if over_several && matches!(dome.follow, Follow::Turn | Follow::Slave) {
        found.push("follow: a dome over several telescopes has no slit to follow; leave it out".to_owned());
    }
    if over_several && dome.slit != Slit::default() {
        found.push("slit: a dome over several telescopes has no slit to follow; leave it out".to_owned());
    }
    found
}

/// Domes whose slit would have to stand in two places, or nobody knows where, with the words for it; cameras are paired
/// by then.
pub(crate) fn torn_slits(observatory: &Observatory) -> Vec<(Name, String)> {
    let (mounts, cameras) = (&observatory.telescope, &observatory.camera);
    let followed = observatory.dome.iter().filter(|dome| dome.follow != Follow::Off && dome.telescopes.len() < 2);
    let torn = |dome: &Dome| {
        let name = &dome.common.name;
        let under = cameras.iter().filter(|camera| camera.dome.as_ref() == Some(name));
        let under: BTreeSet<&Name> = under.filter_map(|camera| camera.telescope.as_ref()).collect();
        let list: Vec<String> = under.iter().map(|mount| format!("\"{mount}\"")).collect();
        let why = match under.len() {
            1 => return None,
            0 => format!("{} mounts, and no camera is paired with the one that looks out of it", mounts.len()),
            _ => format!("telescopes {} look out of one slit, which cannot stand where each looks", list.join(" and ")),
        };
        let mend = "name its one mount by `dome` and `telescope` of the cameras, or set follow = \"off\" where it is a \
                    roof or the site turns it";
        Some((name.clone(), format!("dome \"{name}\": {why}; {mend}")))
    };
    if mounts.len() < 2 || cameras.is_empty() { Vec::new() } else { followed.filter_map(torn).collect() }
}
