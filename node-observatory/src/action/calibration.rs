//! `calibration`: bias and dark frames, whatever the sky does.

use serde::Deserialize;

use super::expose::{Series, Shot, expose, fits};
use super::parameters::{Metadata, Part, check_bin, check_exptime, half, one};
use super::{Action, Needs, Stage};
use crate::rig::focuser::Wanted;
use crate::trouble::Trouble;

/// So many frames of each exposure time; 0 s is a bias.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Exposure times, s.
    exptime: Vec<f64>,
    /// Frames of each.
    n: Vec<u32>,
    /// Filter to turn to first.
    filter: Option<String>,
    /// Folder for the files.
    dir: Option<String>,
    /// Binning of both axes.
    #[serde(default = "one")]
    bin: u32,
    /// The next rows need not wait.
    #[serde(default)]
    execute_parallel: bool,
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
    /// For the header.
    #[serde(default)]
    metadata: Metadata,
}

impl Calibration {
    fn part(&self) -> Part {
        let (width, height) = (self.subframe_width, self.subframe_height);
        Part { width, height, center_x: self.subframe_center_x, center_y: self.subframe_center_y }
    }

    /// The frame that follows `taken` others, if there is one.
    fn shot(&self, taken: u32) -> Option<Shot> {
        let mut before = 0_u32;
        for (exptime, n) in self.exptime.iter().zip(&self.n) {
            before = before.saturating_add(*n);
            if taken < before {
                let (image_type, word) = if *exptime == 0.0 { ("Bias Frame", "bias") } else { ("Dark Frame", "dark") };
                let (nth, all) = (taken + 1, self.frames());
                let words = format!("exposing {nth} of {all}, {word} {exptime} s");
                return Some(Shot { exposure_s: *exptime, image_type, words });
            }
        }
        None
    }

    fn frames(&self) -> u32 {
        self.n.iter().fold(0, |all, n| all.saturating_add(*n))
    }
}

impl Action for Calibration {
    const NAME: &'static str = "calibration";
    const EXAMPLE: &'static str = r#"{"exptime": [0, 30], "n": [10, 5]}"#;

    fn check(&self) -> Result<(), String> {
        if self.exptime.is_empty() || self.exptime.len() != self.n.len() {
            let (exptime, n) = (self.exptime.len(), self.n.len());
            return Err(format!("n: exptime has {exptime} and n has {n} values; expected as many, at least one"));
        }
        self.exptime.iter().try_for_each(|exptime| check_exptime(*exptime))?;
        check_bin(self.bin)?;
        self.part().check()
    }

    fn needs(&self) -> Needs {
        Needs { safe: false, mount: false, parallel: self.execute_parallel, all_before: false }
    }

    fn frames_wanted(&self) -> Option<u32> {
        Some(self.frames())
    }

    async fn run(&self, stage: &Stage) -> Result<String, Trouble> {
        stage.step("cooling, filter and focus");
        let ready = stage.filter_and_focus(self.filter.as_deref(), Wanted::default());
        tokio::try_join!(stage.cool(), ready)?;
        let series = Series {
            filter: self.filter.clone(),
            bin: self.bin,
            subframe: self.part().on(stage.chain()?.camera, self.bin).await?,
            folder: self.dir.clone(),
            metadata: self.metadata.texts(),
            ..Series::default()
        };
        let end = stage.row.end;
        let plan = |taken, now| self.shot(taken).filter(|shot| fits(now, shot.exposure_s, end));
        let taken = expose(stage, &series, plan).await?;
        Ok(if taken < self.frames() { format!("the window ended after {taken} frames") } else { String::new() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lists_are_worked_through_in_order_from_wherever_a_restart_finds_them() {
        let calibration: Calibration = serde_json::from_str(r#"{"exptime": [0, 5.5], "n": [2, 1]}"#).unwrap();
        let plan: Vec<(f64, &str)> =
            (0..).map_while(|taken| calibration.shot(taken)).map(|s| (s.exposure_s, s.image_type)).collect();
        assert_eq!(plan, [(0.0, "Bias Frame"), (0.0, "Bias Frame"), (5.5, "Dark Frame")]);
        assert_eq!(calibration.shot(2).unwrap().words, "exposing 3 of 3, dark 5.5 s");
        assert_eq!(calibration.frames_wanted(), Some(3));
    }
}
