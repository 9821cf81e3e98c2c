//! `autofocus`: finds the focus with a run of frames near the zenith, and keeps it.

mod field;
mod search;

use schemars::JsonSchema;
use serde::Deserialize;
use sky::{Horizontal, Observer};
use units::Angle;

use self::field::Field;
use self::search::Search;
use super::expose::{Series, fits};
use super::parameters::{LONGEST_S, Readout, takes_light, yes};
use super::{Action, Exposures, Needs, Place, Stage, Wrong};
use crate::focus::run::{Wish, find};
use crate::focus::{half_range, offset, tell};
use crate::opening;
use crate::plan::{Course, Halt};
use crate::pointing;
use crate::rig::focuser::Wanted;
use crate::slit::Aimed;
use crate::trouble::Trouble;

/// Finds the focus with a run of frames near the zenith, and keeps it: every later row begins there.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Autofocus {
    /// Exposure time.
    #[serde(default = "three")]
    #[schemars(range(min = 0, max = LONGEST_S), extend("unit" = "s"))]
    exptime: f64,
    /// Halve the exposure while one of the five brightest stars is saturated: five times, not below 0.1 s.
    #[serde(default)]
    reduce_exposure_time: bool,
    /// Filter; its offset is taken off what is kept. The one in the beam where absent.
    filter: Option<String>,
    #[serde(flatten)]
    search: Search,
    /// Width of the stars at the begin; found out where absent.
    #[schemars(range(min = 0.5, max = 500), extend("unit" = "px"))]
    fwhm: Option<f64>,
    /// Keep what was found as the best focus; false: look, but keep nothing.
    #[serde(default = "yes")]
    save: bool,
    /// Folder for the files, inside the folder of images.
    save_path: Option<String>,
    #[serde(flatten)]
    field: Field,
    #[serde(flatten)]
    readout: Readout,
}

fn three() -> f64 {
    3.0
}

impl Action for Autofocus {
    const NAME: &'static str = "autofocus";
    const EXAMPLE: &'static str = r#"{"exptime": 3, "filter": "V", "search_range": 500, "search_range_is_relative": true,
        "n_steps": [9, 7], "selection_method": "maximal"}"#;

    fn check(&self) -> Result<(), Wrong> {
        self.readout.check()?;
        takes_light(self.exptime)?;
        self.search.check()?;
        self.field.check()
    }

    fn needs(&self) -> Needs {
        Needs { safe: true, mount: true, parallel: false, all_before: false }
    }

    fn azimuth_deg(&self, sky: &Observer) -> Option<f64> {
        self.field.azimuth_deg(sky)
    }

    fn looks_at(&self) -> Option<Place> {
        self.field.place().map(Place::Icrs)
    }

    fn exposures(&self) -> Vec<Exposures> {
        let ((coarse, fine), (first, closer)) = (self.search.positions(), self.search.frames());
        let look = |(positions, frames): (usize, u32)| {
            let all = u32::try_from(positions).unwrap_or(u32::MAX).saturating_mul(frames);
            Exposures::of(self.exptime, Some(all))
        };
        [(coarse, first), (fine, closer)].map(look).to_vec()
    }

    fn filters(&self) -> Vec<&str> {
        self.filter.as_deref().into_iter().collect()
    }

    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        let up = Horizontal { altitude: Angle::from_degrees(90.0), azimuth: Angle::default() };
        let zenith = course.observer(course.now)?.to_icrs(&up);
        let place = self.field.place().unwrap_or(zenith);
        course.begin(Some(Some(&place)), self.filter.as_deref())?;
        course.reads(&self.readout);
        let ((coarse, fine), (first, closer)) = (self.search.positions(), self.search.frames());
        // at the end it is looked once more where the focus was found
        let positions = std::iter::repeat_n(first, coarse).chain(std::iter::repeat_n(closer, fine.saturating_add(1)));
        for count in positions {
            if !fits(course.now, self.exptime * f64::from(count), course.row.end) {
                return Err(Halt::Failed("the row's window is over before the focus is found".to_owned()));
            }
            for _ in 0..count {
                course.frame(self.exptime, true)?;
            }
        }
        Ok(())
    }

    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        let chain = stage.chain()?;
        let impossible = |why: String| Trouble::Impossible(why);
        let nonsense = |wrong: Wrong| Trouble::Impossible(wrong.to_string());
        let camera = &stage.row.camera;
        let focuser = chain.focuser.ok_or_else(|| impossible(format!("{camera} has no focuser")))?;
        let can = focuser.instrument.capabilities().await?;
        if !can.absolute {
            return Err(impossible(format!("{} does not know its position", focuser.name())));
        }
        chain.camera.start_cooling().await?;
        let chosen = match chain.mount {
            Some(_) => Some(self.field.choose(stage).await?),
            None => None,
        };
        let place = chosen.as_ref().map(|chosen| chosen.place);
        let pointed = place.zip(chain.mount);
        let _aimed = pointed.map(|(place, mount)| Aimed::at(&stage.room, mount, place));
        let point = async {
            stage.step("opening");
            opening::open(&stage.room, &chain).await?;
            if let (Some((place, mount)), Some(chosen)) = (pointed, &chosen) {
                stage.visible(&place)?;
                stage.step(format!("slewing to {}", chosen.words));
                pointing::send(stage, mount, &place).await?;
            }
            Ok(())
        };
        tokio::try_join!(point, stage.filter_and_focus(self.filter.as_deref(), Wanted::default()))?;
        stage.step("cooling");
        stage.cool().await?;

        let series = Series {
            target_deg: place.map(|place| (place.ra.degrees(), place.dec.degrees())),
            filter: self.filter.clone(),
            bin: self.readout.bin,
            subframe: self.readout.on(chain.camera).await?,
            folder: self.save_path.clone(),
            open_sky: true,
            ..Series::default()
        };
        let unknown = || Trouble::Failed {
            device: focuser.instrument.device.to_string(),
            verb: "focus".to_owned(),
            reason: "its position is not known".to_owned(),
        };
        let start = focuser.position().ok_or_else(unknown)?;
        let usual = half_range(stage, focuser, can.max_step);
        let wish = Wish {
            plan: self.search.plan(focuser, start, usual, can.max_step).map_err(nonsense)?,
            meter: self.search.meter(self.reduce_exposure_time).map_err(nonsense)?,
            exposure_s: self.exptime,
            frames: self.search.frames(),
            reduce_exposure: self.reduce_exposure_time,
            expected_px: self.fwhm,
            filter: offset(stage, &series, focuser),
            keep: self.save,
            counts: true,
        };
        let run = find(stage, &series, focuser, &wish).await?;
        tell(stage, &run);
        if let Some(mount) = chain.mount {
            mount.track(false).await?;
        }
        let detail = stage.room.focus.borrow().detail.clone();
        let where_to = chosen.map(|chosen| format!("; field: {}", chosen.words)).unwrap_or_default();
        match run.reason {
            None => Ok(format!("{detail}{where_to}")),
            Some(_) => Err(Trouble::Impossible(format!("{detail}{where_to}"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::action::read_text;

    #[test]
    fn the_predecessors_rows_are_read_with_their_defaults() {
        let plain = read_text::<Autofocus>("{}").unwrap();
        assert_eq!((plain.exptime, plain.readout.bin, plain.save), (3.0, 1, true));
        let all = r#"{"exptime": 2, "filter": "V", "bin": 2, "reduce_exposure_time": true, "search_range": [8000, 12000],
            "search_range_is_relative": false, "n_steps": [30, 20], "n_exposures": 2, "decrease_search_range": true,
            "star_find_threshold": 5.0, "fwhm": 8, "percent_to_cut": 60, "focus_measure_operator": "HFR",
            "extremum_estimator": "LOWESS", "extremum_estimator_kwargs": {"frac": 0.5},
            "secondary_focus_measure_operators": ["fft", "normalized_variance", "tenengrad"], "save": false,
            "maximal_zenith_angle": 10, "airmass_threshold": 1.01, "g_mag_range": [0, 10], "j_mag_range": [0, 10],
            "fov_height": 0.2, "fov_width": 0.2, "selection_method": "MAXIMAL", "use_gaia": true,
            "observation_time": "2026-11-21T03:00:00Z", "maximal_number_of_stars": 1000, "subframe_width": 512,
            "subframe_height": 512}"#;
        let all = read_text::<Autofocus>(all).unwrap();
        assert_eq!((all.exptime, all.readout.bin, all.save, all.fwhm), (2.0, 2, false, Some(8.0)));
    }

    #[test]
    fn what_makes_no_sense_is_refused_by_the_name_of_its_parameter() {
        for (text, parameter) in [
            (r#"{"exptime": -1}"#, "exptime"),
            (r#"{"ra": 10}"#, "ra"),
            (r#"{"search_range": 300}"#, "search_range"),
            (r#"{"search_range": "wide"}"#, "search_range"),
            (r#"{"n_steps": [4, 9]}"#, "n_steps"),
            (r#"{"n_steps": 4}"#, "n_steps"),
            (r#"{"n_steps": []}"#, "n_steps"),
            (r#"{"n_exposures": 0}"#, "n_exposures"),
            (r#"{"percent_to_cut": 0}"#, "percent_to_cut"),
            (r#"{"focus_measure_operator": "sharpness"}"#, "focus_measure_operator"),
            (r#"{"extremum_estimator": "guess"}"#, "extremum_estimator"),
            (r#"{"secondary_focus_measure_operators": ["x"]}"#, "secondary_focus_measure_operators"),
            (r#"{"selection_method": "best"}"#, "selection_method"),
            (r#"{"g_mag_range": [10, 5]}"#, "g_mag_range"),
            (r#"{"airmass_threshold": 0.5}"#, "airmass_threshold"),
            (r#"{"observation_time": "tonight"}"#, "observation_time"),
            (r#"{"filtre": "V"}"#, "filtre"),
        ] {
            let refused = read_text::<Autofocus>(text).err().unwrap();
            assert!(refused.starts_with(&format!("{parameter}: ")), "{text}: {refused}");
        }
    }
}
