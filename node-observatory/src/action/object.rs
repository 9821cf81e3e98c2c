//! `object`: points at a target and takes frames until the window ends or there are enough.

use serde::Deserialize;
use sky::{Horizontal, Icrs, Observer};
use units::Utc;

use super::expose::{Series, Shot, expose, fits};
use super::parameters::{Metadata, Part, check_bin, check_exptime, half, one};
use super::{Action, Needs, Stage};
use crate::opening;
use crate::rig::focuser::Wanted;
use crate::slit::Aimed;
use crate::trouble::Trouble;

/// What to observe and how.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Object {
    /// OBJECT keyword.
    object: String,
    /// Exposure time, s.
    exptime: f64,
    /// Right ascension, ICRS degrees.
    ra: Option<f64>,
    /// Declination, ICRS degrees.
    dec: Option<f64>,
    /// Altitude, degrees, instead of ra and dec; where it stands when the row begins is then tracked.
    alt: Option<f64>,
    /// Azimuth from north through east, degrees.
    az: Option<f64>,
    /// Name to look up; not supported yet.
    lookup_name: Option<String>,
    /// Two-line elements; not supported yet.
    tle: Option<String>,
    /// Filter name.
    filter: Option<String>,
    /// Steps from the best focus.
    focus_shift: Option<f64>,
    /// Absolute focus position, steps; wins over the shift.
    focus_position: Option<f64>,
    /// Frames; absent or negative: until the window ends.
    n: Option<i64>,
    /// Guide; accepted, and told to be not done yet.
    #[serde(default)]
    guiding: bool,
    /// Correct the pointing by plate solving; accepted, and told to be not done yet.
    #[serde(default)]
    pointing: bool,
    /// Binning of both axes.
    #[serde(default = "one")]
    bin: u32,
    /// Folder for the files.
    dir: Option<String>,
    /// The next rows need not wait.
    #[serde(default)]
    execute_parallel: bool,
    /// Neither open nor slew.
    #[serde(default)]
    disable_telescope_movement: bool,
    /// Of the guider that is not built yet.
    #[serde(default, rename = "reset_guiding_reference")]
    _reset_guiding_reference: Option<bool>,
    /// Columns, binned.
    subframe_width: Option<u32>,
    /// Rows, binned.
    subframe_height: Option<u32>,
    /// 0 to 1.
    #[serde(default = "half")]
    subframe_center_x: f64,
    /// 0 to 1.
    #[serde(default = "half")]
    subframe_center_y: f64,
    /// Of moving targets, which are not built yet.
    #[serde(default, rename = "nonsidereal_recenter_interval")]
    _nonsidereal_recenter_interval: Option<f64>,
    /// Of moving targets.
    #[serde(default, rename = "nonsidereal_start_lead_time_seconds")]
    _nonsidereal_start_lead_time_seconds: Option<f64>,
    /// Of moving targets.
    #[serde(default, rename = "nonsidereal_rate_update_interval")]
    _nonsidereal_rate_update_interval: Option<f64>,
    /// For the header.
    #[serde(default)]
    metadata: Metadata,
}

impl Object {
    fn part(&self) -> Part {
        let (width, height) = (self.subframe_width, self.subframe_height);
        Part { width, height, center_x: self.subframe_center_x, center_y: self.subframe_center_y }
    }

    fn moves(&self) -> bool {
        !self.disable_telescope_movement && (self.ra.is_some() || self.alt.is_some())
    }

    fn focus(&self) -> Wanted {
        // steps are whole; `check` has refused what is not finite
        let steps = |steps: Option<f64>| steps.map(|steps| steps.round() as i64);
        Wanted { position: steps(self.focus_position), shift: steps(self.focus_shift), filter_offset: 0 }
    }

    /// The frame that follows `taken` others, if it is wanted and fits into the window.
    fn shot(&self, taken: u32, now: Utc, end: Utc) -> Option<Shot> {
        let wanted = self.frames_wanted();
        if wanted.is_some_and(|wanted| taken >= wanted) || !fits(now, self.exptime, end) {
            return None;
        }
        let of = wanted.map(|wanted| format!(" of {wanted}")).unwrap_or_default();
        let filter = self.filter.as_ref().map(|filter| format!(", {filter}")).unwrap_or_default();
        let words = format!("exposing {}{of}, {} s{filter}", taken + 1, self.exptime);
        Some(Shot { exposure_s: self.exptime, image_type: "Light Frame", words })
    }

    /// What was asked for and is not done, in words.
    fn not_done(&self) -> Vec<&'static str> {
        let pointing = self.pointing.then_some("pointing is not built yet: frames are not re-centred");
        let guiding = self.guiding.then_some("guiding is not built yet: the mount only tracks");
        pointing.into_iter().chain(guiding).collect()
    }

    /// Where to point, at an instant.
    fn target(&self, stage: &Stage, at: Utc) -> Result<Option<Icrs>, Trouble> {
        match (self.ra, self.dec, self.alt, self.az) {
            (Some(ra), Some(dec), ..) => Ok(Some(Icrs::from_degrees(ra, dec).checked()?)),
            (_, _, Some(alt), Some(az)) => Ok(Some(stage.observer(at)?.to_icrs(&Horizontal::from_degrees(alt, az)))),
            _ => Ok(None),
        }
    }
}

impl Action for Object {
    const NAME: &'static str = "object";
    const EXAMPLE: &'static str =
        r#"{"object": "TRAPPIST-1", "exptime": 30, "ra": 346.6223, "dec": -5.0413, "filter": "V", "n": 100}"#;

    fn check(&self) -> Result<(), String> {
        check_exptime(self.exptime)?;
        check_bin(self.bin)?;
        self.part().check()?;
        if self.lookup_name.is_some() {
            return Err("lookup_name: names are not looked up yet; give ra and dec".to_owned());
        }
        if self.tle.is_some() {
            return Err("tle: satellites are not supported yet".to_owned());
        }
        if self.ra.is_some() != self.dec.is_some() {
            return Err("ra: give ra and dec, or neither".to_owned());
        }
        if self.alt.is_some() != self.az.is_some() {
            return Err("alt: give alt and az, or neither".to_owned());
        }
        if self.ra.is_some() && self.alt.is_some() {
            return Err("alt: give ra and dec, or alt and az, not both".to_owned());
        }
        for (name, value, low, high) in [
            ("ra", self.ra, -360.0, 360.0),
            ("dec", self.dec, -90.0, 90.0),
            ("alt", self.alt, 0.0, 90.0),
            ("az", self.az, -360.0, 360.0),
            ("focus_shift", self.focus_shift, -1e9, 1e9),
            ("focus_position", self.focus_position, 0.0, 1e9),
        ] {
            if value.is_some_and(|value| !(low..=high).contains(&value)) {
                return Err(format!("{name}: expected {low} to {high}, found {}", value.unwrap_or_default()));
            }
        }
        Ok(())
    }

    fn needs(&self) -> Needs {
        Needs { safe: true, mount: self.moves(), parallel: self.execute_parallel, all_before: false }
    }

    fn object(&self) -> Option<&str> {
        Some(&self.object)
    }

    fn frames_wanted(&self) -> Option<u32> {
        self.n.and_then(|n| u32::try_from(n).ok())
    }

    fn azimuth_deg(&self, sky: &Observer) -> Option<f64> {
        match (self.ra, self.dec) {
            _ if !self.moves() => None,
            (Some(ra), Some(dec)) => Some(sky.to_horizontal(&Icrs::from_degrees(ra, dec)).azimuth.degrees()),
            _ => self.az,
        }
    }

    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        let chain = stage.chain()?;
        let mut told: Vec<String> = self.not_done().into_iter().map(str::to_owned).collect();
        for word in &told {
            tracing::warn!(object = self.object, "{word}");
        }
        chain.camera.start_cooling().await?;
        let target = self.target(stage, stage.clock().utc())?;
        let pointed = target.filter(|_| self.moves()).zip(chain.mount);
        // the slit goes there beside the mount
        let _aimed = pointed.map(|(target, mount)| Aimed::at(&stage.room, mount, target));

        let point = async {
            let Some(target) = target.filter(|_| self.moves()) else { return Ok(()) };
            let mount = chain.mount.ok_or_else(|| Trouble::Impossible(format!("{} has no mount", stage.row.camera)))?;
            visible(stage, &target)?;
            stage.step("opening");
            opening::open(&stage.room, &chain).await?;
            stage.step("slewing");
            mount.point(&target, &visible(stage, &target)?).await
        };
        tokio::try_join!(point, stage.filter_and_focus(self.filter.as_deref(), self.focus()))?;
        stage.step("cooling");
        stage.cool().await?;

        let series = Series {
            object: Some(self.object.clone()),
            target_deg: target.map(|target| (target.ra.degrees(), target.dec.degrees())),
            filter: self.filter.clone(),
            bin: self.bin,
            subframe: self.part().on(chain.camera, self.bin).await?,
            folder: self.dir.clone(),
            open_sky: self.moves(),
            metadata: self.metadata.texts(),
        };
        let end = stage.row.end;
        let taken = expose(stage, &series, |taken, now| self.shot(taken, now, end)).await?;
        if let Some(mount) = chain.mount.filter(|_| self.moves()) {
            mount.track(false).await?;
        }
        if self.frames_wanted().is_some_and(|wanted| taken < wanted) {
            told.push(format!("the window ended after {taken} frames"));
        }
        Ok(told.join("; "))
    }
}

/// The sky now, if the target stands in it.
fn visible(stage: &Stage, target: &Icrs) -> Result<Observer, Trouble> {
    let observer = stage.observer(stage.clock().utc())?;
    let altitude_deg = observer.to_horizontal(target).altitude.degrees();
    if altitude_deg > 0.0 {
        Ok(observer)
    } else {
        let (ra, dec) = (target.ra.degrees(), target.dec.degrees());
        Err(Trouble::Impossible(format!(
            "ra {ra:.4}, dec {dec:.4} deg stands {altitude_deg:.1} deg, below the horizon"
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn object(extra: &str) -> Object {
        serde_json::from_str(&format!(r#"{{"object": "x", "exptime": 60{extra}}}"#)).unwrap()
    }

    fn at(text: &str) -> Utc {
        text.parse().unwrap()
    }

    #[test]
    fn frames_are_taken_until_there_are_enough_or_the_window_ends() {
        let (now, end) = (at("2026-11-21T03:00:00Z"), at("2026-11-21T03:30:00Z"));
        let ten = object(r#", "n": 10, "filter": "V""#);
        assert_eq!(ten.shot(2, now, end).unwrap().words, "exposing 3 of 10, 60 s, V");
        assert_eq!(ten.shot(10, now, end), None);
        let endless = object(r#", "n": -1"#);
        assert!(endless.shot(5000, now, end).is_some());
        assert_eq!(endless.shot(5000, at("2026-11-21T03:29:01Z"), end), None);
        assert_eq!(object(r#", "n": 0"#).shot(0, now, end), None);
    }

    #[test]
    fn without_a_place_or_without_leave_to_move_the_mount_stays() {
        assert!(object(r#", "ra": 1, "dec": 2"#).needs().mount);
        assert!(!object(r#", "ra": 1, "dec": 2, "disable_telescope_movement": true"#).needs().mount);
        assert!(!object("").needs().mount);
    }

    #[test]
    fn what_is_not_built_is_said() {
        assert_eq!(object(r#", "guiding": true, "pointing": true"#).not_done().len(), 2);
        assert_eq!(object("").not_done().len(), 0);
    }
}
