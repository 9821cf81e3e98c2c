//! `[[dome]] follow` and `slit`: how the dome's slit comes to stand where the telescope looks.

use serde::Deserialize;

/// The part that turns a dome.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Follow {
    /// This system, if the dome says that it can turn and that nobody else turns it.
    #[default]
    Auto,
    /// This system.
    Turn,
    /// The dome by itself, once it is slaved to the mount (ASCOM `Slaved`).
    Slave,
    /// The site, or nobody: nothing is commanded and nothing waited for.
    Off,
}

/// The slit, and the mount's place in the dome. Lengths in metres.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Slit {
    /// Of the slit; with `radius_m`. Where absent, `tolerance_deg` is all that is known of the dome.
    pub width_m: Option<f64>,
    /// Of the dome's sphere.
    pub radius_m: Option<f64>,
    /// How far the slit reaches behind the zenith, along the ground; half its width where absent.
    pub past_zenith_m: Option<f64>,
    /// Where the mount's axes meet, east of the middle of the dome's sphere.
    pub east_m: f64,
    /// North of it.
    pub north_m: f64,
    /// Above it.
    pub up_m: f64,
    /// Without a width: the slit is clear within so many degrees of the telescope's azimuth at the horizon.
    pub tolerance_deg: f64,
    /// The dome may stand so far from where it says, or from where it was sent, degrees.
    pub error_deg: f64,
    /// A slit that is not where it belongs after so long is a fault of the dome, sky s.
    pub timeout_s: f64,
}

impl Slit {
    /// A turn that ends so far from where the dome was sent is done, degrees: within `error_deg`, or, where nothing of the
    /// slit is known but `tolerance_deg`, within that.
    pub fn arrived_deg(&self) -> f64 {
        if self.width_m.is_some() { self.error_deg } else { self.error_deg.max(self.tolerance_deg) }
    }
}

impl Default for Slit {
    fn default() -> Self {
        Self {
            width_m: None,
            radius_m: None,
            past_zenith_m: None,
            east_m: 0.0,
            north_m: 0.0,
            up_m: 0.0,
            tolerance_deg: 5.0,
            error_deg: 1.0,
            timeout_s: 300.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::parse;

    fn site(mount: &str, dome: &str) -> Result<crate::Observatory, String> {
        let text = format!(
            "[observatory]\nsite = \"p\"\ntelescope = \"t\"\nlatitude_deg = 1\nlongitude_deg = 2\nelevation_m = 3\n\
             [[telescope]]\nname = \"m\"\nserver = \"a:1\"\n{mount}\n[[dome]]\nname = \"d\"\nserver = \"a:1\"\n{dome}\n"
        );
        parse(&text, Path::new("/site")).map_err(|error| error.to_string())
    }

    #[test]
    fn a_dome_without_settings_follows_by_a_tolerance() {
        let dome = &site("", "").unwrap().dome[0];
        assert_eq!((dome.follow, dome.slit), (Follow::Auto, Slit::default()));
    }

    #[test]
    fn a_whole_geometry_is_read() {
        let slit = "follow = \"turn\"\nslit = { width_m = 1.2, radius_m = 2.5, north_m = -0.1, up_m = 0.2 }";
        let read = site("aperture_m = 0.35\narm_m = 0.4", slit).unwrap();
        assert_eq!((read.dome[0].follow, read.dome[0].slit.width_m), (Follow::Turn, Some(1.2)));
        assert_eq!((read.telescope[0].aperture_m, read.telescope[0].arm_m), (Some(0.35), 0.4));
    }

    #[test]
    fn what_does_not_fit_is_reported_with_its_place() {
        let fault = |mount: &str, dome: &str| site(mount, dome).unwrap_err();
        let message = fault("", "slit = { width_m = 1.2, radius_m = 2.5 }");
        assert!(message.contains("line 14: dome \"d\": slit.width_m: telescope \"m\" needs aperture_m"), "{message}");
        let message = fault("", "slit = { width_m = 1.2 }");
        assert!(message.contains("width_m and radius_m go together"), "{message}");
        let message = fault("aperture_m = 1.3", "slit = { width_m = 1.2, radius_m = 2.5 }");
        assert!(message.contains("cannot look out"), "{message}");
        let message = fault("aperture_m = 0.5\narm_m = 2.4", "slit = { width_m = 1.2, radius_m = 2.5 }");
        assert!(message.contains("would look from outside"), "{message}");
        let message = fault("aperture_m = nan", "slit = { tolerance_deg = nan, timeout_s = 1 }");
        for word in ["aperture_m = NaN", "slit.tolerance_deg = NaN: expected 0.5 to 45", "slit.timeout_s = 1"] {
            assert!(message.contains(word), "{word}: {message}");
        }
        let message = fault("", "follow = \"turn\"\ntelescopes = [\"t\", \"u\"]");
        assert!(message.contains("has no slit to follow"), "{message}");
        let message = fault("", "slit = { tolerance_deg = 3 }\ntelescopes = [\"t\", \"u\"]");
        assert!(message.contains("slit: a dome over several telescopes"), "{message}");
        assert!(fault("", "follow = \"sometimes\"").contains("expected \"auto\" or \"turn\""));
        assert!(fault("", "slit = { widht_m = 1.2 }").contains("did you mean \"width_m\"?"));
    }

    /// Two mounts, and cameras whose `telescope` and `dome` are these.
    fn two_mounts(dome: &str, cameras: &[(&str, &str)]) -> Result<crate::Observatory, String> {
        let camera = |(number, (telescope, dome)): (usize, &(&str, &str))| {
            format!("[[camera]]\nname = \"c{number}\"\nserver = \"a:1\"\nnumber = {number}\n{telescope}\n{dome}\n")
        };
        let cameras: String = cameras.iter().enumerate().map(camera).collect();
        site("", &format!("{dome}\n[[telescope]]\nname = \"n\"\nserver = \"a:2\"\n{cameras}"))
    }

    #[test]
    fn two_mounts_under_one_slit_are_refused_and_under_a_roof_are_not() {
        let (m, n, d) = ("telescope = \"m\"", "telescope = \"n\"", "dome = \"d\"");
        let error = two_mounts("", &[(m, d), (n, d)]).unwrap_err();
        let expected = "dome \"d\": telescopes \"m\" and \"n\" look out of one slit, which cannot stand where each looks; \
                        name its one mount by `dome` and `telescope` of the cameras, or set follow = \"off\"";
        assert!(error.contains(expected), "{error}");
        // the only dome is every camera's
        assert!(two_mounts("follow = \"slave\"", &[(m, ""), (n, "")]).unwrap_err().contains("one slit"));
        assert!(two_mounts("", &[("", "")]).unwrap_err().contains("no camera is paired with"));
        assert!(two_mounts("follow = \"off\"", &[(m, d), (n, d)]).is_ok());
        assert!(two_mounts("telescopes = [\"t\", \"u\"]", &[(m, d), (n, d)]).is_ok());
        let second = "[[dome]]\nname = \"e\"\nserver = \"a:2\"";
        assert!(two_mounts(second, &[(m, d), (n, "dome = \"e\"")]).is_ok(), "each has a dome of its own");
        assert!(two_mounts("", &[(m, d), (m, d)]).is_ok(), "two cameras on one of them");
        assert!(site("", "").is_ok());
    }
}
