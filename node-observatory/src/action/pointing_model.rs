//! `pointing_model`: learns over the whole sky how the telescope misses where it is sent.

use schemars::JsonSchema;
use serde::Deserialize;
use sky::{Icrs, Observer};

use super::expose::{Series, Shot, expose, fits};
use super::parameters::{Defocus, LONGEST_S, Readout};
use super::{Action, Exposures, Needs, Stage, Wrong};
use crate::frames::dark;
use crate::opening;
use crate::plan::{Course, Halt};
use crate::pointing::{calm, forget, grid, learn, look, seen, send, sensor_looks_at};
use crate::rig::telescope::Mount;
use crate::slit::Aimed;
use crate::trouble::Trouble;

/// Learns over the whole sky how the telescope misses where it is sent: one frame at each of `n` places.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct PointingModel {
    /// Places over the sky, one frame each.
    #[serde(default = "fifty")]
    #[schemars(range(min = 1, max = MOST), extend("unit" = "places"))]
    n: u32,
    /// Exposure time.
    #[serde(default = "three")]
    #[schemars(range(min = 0, max = LONGEST_S), extend("unit" = "s"))]
    exptime: f64,
    /// Tell the mount at each place where it points, so that it builds a model of its own; this node then forgets its own.
    #[serde(default)]
    sync: bool,
    /// OBJECT keyword.
    #[serde(default = "title")]
    object: String,
    /// Take a dark of the same exposure first, and take it off each frame before it is measured and solved; the files stay
    /// as they are. For cameras with a shutter, whose hot pixels pass for stars.
    #[serde(default)]
    dark_subtraction: bool,
    /// Taken from other schedules, without effect: the catalogue is always a local one, that of the configuration.
    #[serde(default, rename = "use_local_db")]
    #[schemars(extend("deprecated" = true))]
    _use_local_db: bool,
    /// Filter; the one in the beam where absent.
    filter: Option<String>,
    #[serde(flatten)]
    defocus: Defocus,
    #[serde(flatten)]
    readout: Readout,
    /// Folder for the files, inside the folder of images.
    dir: Option<String>,
}

fn fifty() -> u32 {
    50
}

fn three() -> f64 {
    3.0
}

fn title() -> String {
    "Pointing Model".to_owned()
}

/// Places of one run, at most; more teach nothing new.
const MOST: u32 = 1000;
/// What a place takes beside its frame, for the plan: 30 deg at 3 deg/s, settling, and the solving.
const SLEW_S: f64 = 15.0;

impl PointingModel {
    async fn series(&self, stage: &Stage) -> Result<Series, Trouble> {
        Ok(Series {
            action: None,
            focus: None,
            object: Some(self.object.clone()),
            filter: self.filter.clone(),
            bin: self.readout.bin,
            subframe: self.readout.on(stage.chain()?.camera).await?,
            folder: self.dir.clone(),
            open_sky: true,
            ..Series::default()
        })
    }

    /// One place: slews there, takes a frame, and learns where it looks. False where the frame does not tell.
    async fn look_at(&self, stage: &Stage, mount: &Mount, series: &Series, target: Icrs) -> Result<bool, Trouble> {
        let before = stage.room.journal.progress(&stage.row.id).taken;
        let shot = |taken: u32, now| {
            let words = format!("place {} of {}, {} s", before + 1, self.n, self.exptime);
            let shot = Shot { exposure_s: self.exptime, image_type: "Light Frame", words };
            (taken == before && fits(now, self.exptime, stage.row.end)).then_some(shot)
        };
        let commanded = send(stage, mount, &target).await?;
        calm(stage, mount, self.exptime).await;
        let series = Series { target_deg: Some((target.ra.degrees(), target.dec.degrees())), ..series.clone() };
        if expose(stage, &series, shot).await? == before {
            return Ok(false);
        }
        let Some(frame) = stage.last_frame() else { return Ok(false) };
        let looked = look(stage, &frame).await;
        let solution = match seen(looked.as_deref()) {
            Ok(solution) => solution,
            Err((why, _)) => {
                tracing::warn!(%frame, why, "a place of the pointing model does not tell where it looks");
                return Ok(false);
            }
        };
        match &looked {
            Some(looked) if self.sync => {
                let seen = sensor_looks_at(stage, &looked.frame, solution);
                mount.sync(&seen, &stage.observer(stage.clock().utc())?).await?;
                forget(stage, mount);
            }
            Some(looked) => learn(stage, &commanded, &looked.frame, solution),
            None => {}
        }
        Ok(true)
    }

    /// What became of it, in words.
    fn told(&self, stage: &Stage, solved: u32, looked_at: u32) -> String {
        let places = format!("{solved} of {looked_at} places show where the telescope looks");
        if self.sync {
            return format!("{places}; the mount was told each time");
        }
        let book = stage.room.pointing_book.get();
        let models = book.models.iter().filter(|model| model.camera == stage.row.camera.as_str());
        let models = models.map(|model| {
            let side = model.pier_side.map(|side| format!("{side:?} of the pier: ").to_lowercase()).unwrap_or_default();
            let rms = model.rms_arcmin.map(|rms| format!(", rms {rms:.2} arcmin")).unwrap_or_default();
            let used = if model.used { "" } else { ", not used yet" };
            format!("{side}{} points{rms}{used}", model.points.len())
        });
        [vec![places], models.collect()].concat().join("; ")
    }
}

impl Action for PointingModel {
    const NAME: &'static str = "pointing_model";
    const EXAMPLE: &'static str = r#"{"n": 50, "exptime": 3, "filter": "V"}"#;

    fn check(&self) -> Result<(), Wrong> {
        self.readout.check()
    }

    fn needs(&self) -> Needs {
        Needs { safe: true, mount: true, parallel: false, all_before: false }
    }

    fn object(&self) -> Option<&str> {
        Some(&self.object)
    }

    fn frames_wanted(&self) -> Option<u32> {
        Some(self.n)
    }

    fn azimuth_deg(&self, _sky: &Observer) -> Option<f64> {
        // all around
        None
    }

    fn exposures(&self) -> Vec<Exposures> {
        vec![Exposures::of(self.exptime, Some(self.n)).beside(SLEW_S)]
    }

    fn filters(&self) -> Vec<&str> {
        self.filter.as_deref().into_iter().collect()
    }

    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        course.start_cooling();
        let filter_there = course.now.plus_seconds(course.turn_to(self.filter.as_deref()));
        course.open()?;
        course.wait_until(filter_there)?;
        course.cool()?;
        course.reads(&self.readout);
        if self.dark_subtraction {
            course.aside(self.exptime, false)?;
        }
        let outlook = course.outlook();
        let is_measured = course.overheads().frame(Self::NAME).measured > 0;
        while course.taken < self.n && fits(course.now, self.exptime, course.row.end) {
            let observer = course.observer(course.now)?;
            let Some(target) = grid::target(course.taken, self.n, &outlook, &observer) else { break };
            if is_measured && course.taken > 0 {
                // what was measured between two frames has the slew in it
                course.reaches(&target)?;
            } else {
                course.slew(Some(&target))?;
            }
            if !fits(course.now, self.exptime, course.row.end) {
                break;
            }
            course.frame(self.exptime, true)?;
        }
        if course.taken < self.n {
            course.tell(format!("{} of {} places", course.taken, self.n));
        }
        Ok(())
    }

    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        let chain = stage.chain()?;
        let mount = chain.mount.ok_or_else(|| Trouble::Impossible(format!("{} has no mount", stage.row.camera)))?;
        chain.camera.start_cooling().await?;
        stage.step("opening");
        let open = opening::open(&stage.room, &chain);
        tokio::try_join!(open, stage.filter_and_focus(self.filter.as_deref(), self.defocus.wanted()))?;
        stage.step("cooling");
        stage.cool().await?;
        let series = self.series(stage).await?;
        let dark = match self.dark_subtraction {
            true => Some(dark::take(stage, &series, self.exptime).await?),
            false => None,
        };
        let no_dark = dark.as_ref().and_then(|dark| dark.as_ref().err());
        if let Some(why) = no_dark {
            tracing::warn!(why, "there is no dark: frames are measured as they are");
        }
        let (mut solved, mut looked_at) = (0, 0);
        loop {
            let place = stage.room.journal.progress(&stage.row.id).taken;
            let now = stage.clock().utc();
            if place >= self.n || !fits(now, self.exptime, stage.row.end) {
                break;
            }
            let Some(target) = grid::target(place, self.n, &mount.outlook, &stage.observer(now)?) else { break };
            // the slit goes there beside the mount
            let _aimed = Aimed::at(&stage.room, mount, target);
            solved += u32::from(self.look_at(stage, mount, &series, target).await?);
            looked_at += 1;
        }
        mount.track(false).await?;
        if looked_at > 0 && solved == 0 {
            let why = format!("none of {looked_at} frames shows where {} looks", stage.row.camera);
            return Err(Trouble::Unproven { why, again: false });
        }
        let no_dark = no_dark.map(|why| format!("; without a dark: {why}")).unwrap_or_default();
        Ok(self.told(stage, solved, looked_at) + no_dark.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_predecessors_rows_are_read_and_nonsense_is_refused() {
        let read = |text: &str| crate::action::read_text::<PointingModel>(text);
        let old = read(
            r#"{"n": 50, "exptime": 3.0, "dark_subtraction": false, "object": "Pointing Model",
            "use_local_db": true, "filter": "r'", "bin": 2}"#,
        )
        .unwrap();
        assert_eq!((old.n, old.exptime, old.readout.bin), (50, 3.0, 2));
        let plain = read("{}").unwrap();
        assert_eq!((plain.n, plain.exptime, plain.sync), (50, 3.0, false));
        for (text, word) in [
            (r#"{"n": 0}"#, "n: expected a whole number, 1 to 1000 places, found 0"),
            (r#"{"exptime": -1}"#, "exptime"),
            (r#"{"bin": 0}"#, "bin"),
            (r#"{"subframe_width": 10}"#, "subframe_width"),
            (r#"{"focus_shift": 1e300}"#, "focus_shift"),
            (r#"{"points": 3}"#, "points"),
        ] {
            let refused = read(text).unwrap_err();
            assert!(refused.starts_with(word), "{text}: {refused}");
        }
    }
}
