//! `starmesh archive frames`: finds frames by what they show.

use clap::Args;
use contract::frame_search::{FoundFrame, FrameSearch, SkyPlace};
use node_archive::reader::{FoundFrames, IMAGE_TYPES};
use units::Utc;

use crate::console::{document_line, foreign_line, line};
use crate::night::Telescope;

/// Conditions; a frame is found when it meets all that are given.
#[derive(Debug, Args)]
pub struct Options {
    /// Night of the schedule row, such as 20261121.
    #[arg(long)]
    night: Option<String>,
    /// From this time on, such as 2026-11-21T22:00:00Z.
    #[arg(long, value_name = "UTC")]
    from: Option<Utc>,
    /// Before this time.
    #[arg(long, value_name = "UTC")]
    to: Option<Utc>,
    /// Name of the camera.
    #[arg(long)]
    camera: Option<String>,
    /// Name of the target.
    #[arg(long, value_name = "NAME")]
    object: Option<String>,
    /// Name of the filter.
    #[arg(long)]
    filter: Option<String>,
    #[arg(long = "type", value_name = "TYPE", help = kinds())]
    image_type: Option<String>,
    /// A place that the frame shows by its plate solution: right ascension and declination, degrees, ICRS.
    #[arg(long, value_name = "RA,DEC", allow_hyphen_values = true)]
    covers: Option<SkyPlace>,
    /// Stars at most so wide, arcsec.
    #[arg(long, value_name = "ARCSEC", value_parser = arcsec)]
    fwhm_max: Option<f64>,
    /// At least so many stars.
    #[arg(long, value_name = "N")]
    stars_min: Option<u32>,
    /// Also the bias, dark and flat frames that calibrate what was found.
    #[arg(long)]
    with_calibration: bool,
    /// At most so many frames, the newest.
    #[arg(long, default_value_t = 1000)]
    limit: usize,
    /// Print one JSON object per line.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    telescope: Telescope,
}

impl Options {
    fn search(&self) -> FrameSearch {
        FrameSearch {
            night: self.night.clone(),
            camera: self.camera.clone(),
            object: self.object.clone(),
            filter: self.filter.clone(),
            image_type: self.image_type.clone(),
            covers: self.covers,
            fwhm_max_arcsec: self.fwhm_max,
            stars_min: self.stars_min,
            with_calibration: self.with_calibration,
        }
    }
}

/// The help of `--type`.
fn kinds() -> String {
    format!("Kind of frame: {}, or any IMAGETYP keyword", IMAGE_TYPES.map(|(word, _)| word).join(", "))
}

fn arcsec(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| number.is_finite());
    number.ok_or_else(|| "expected a number of arcseconds, such as 2.5".to_owned())
}

/// Runs the command.
///
/// # Errors
/// The archive cannot be used.
pub fn run(options: &Options) -> anyhow::Result<()> {
    let search = options.search();
    let archive = options.telescope.open()?;
    let between = (options.from, options.to);
    let FoundFrames { frames: found, calibrating, has_more } =
        archive.reader.search(&search, between, options.limit)?;
    for frame in found.iter().chain(&calibrating) {
        if options.json {
            document_line(&serde_json::to_string(frame)?)?
        } else {
            foreign_line(format_args!("{}", row(frame)))?
        }
    }
    if options.json {
        return Ok(());
    }
    let (frames, also) = (found.len(), calibrating.len());
    if has_more {
        return line(format_args!("the newest {frames} frames; there are more, see --limit"));
    }
    if options.with_calibration {
        return line(format_args!("{frames} frames, and {also} that calibrate them"));
    }
    line(format_args!("{frames} frames"))
}

/// A frame as a line for people; the file is last, as it may contain blanks.
fn row(frame: &FoundFrame) -> String {
    let or_dash = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
    let fwhm = or_dash(frame.fwhm_arcsec.map(|fwhm_arcsec| format!("{fwhm_arcsec:.2}\"")));
    let stars = or_dash(frame.stars.map(|stars| stars.to_string()));
    let target = frame.object.clone().unwrap_or_else(|| frame.image_type.clone());
    let filter = or_dash(frame.filter.clone());
    let (at, exposure_s) = (frame.at_utc.fits(), frame.exposure_s);
    format!("{at}  {target:20} {filter:8} {exposure_s:8.3} s  {fwhm:>6} {stars:>6} stars  {}", frame.file)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Arguments {
        #[command(flatten)]
        options: Options,
    }

    fn options(arguments: &[&str]) -> Result<Options, clap::Error> {
        let all = ["frames"].into_iter().chain(arguments.iter().copied());
        Arguments::try_parse_from(all).map(|arguments| arguments.options)
    }

    #[test]
    fn conditions_are_written_as_people_write_them() {
        let search = |arguments: &[&str]| options(arguments).unwrap().search();
        assert_eq!(search(&[]), FrameSearch::default());
        assert_eq!(search(&["--covers", "0,-90"]).covers, Some(SkyPlace { ra_deg: 0.0, dec_deg: -90.0 }));
    }

    #[test]
    fn the_help_names_each_kind_of_frame_that_is_found_by_its_word() {
        let command = Options::augment_args(clap::Command::new("frames"));
        let help = command.get_arguments().find(|argument| argument.get_long() == Some("type")).unwrap().get_help();
        let expected = "Kind of frame: light, acquisition, bias, dark, flat, test, or any IMAGETYP keyword";
        assert_eq!(help.unwrap().to_string(), expected);
    }

    #[test]
    fn what_is_no_condition_is_refused() {
        for arguments in [
            ["--covers", "6h"],
            ["--covers", "-5,3"],
            ["--covers", "NaN,0"],
            ["--from", "yesterday"],
            ["--to", "2026-02-29T00:00:00Z"],
            ["--stars-min", "many"],
            ["--limit", "1e3"],
            ["--fwhm-max", "wide"],
            ["--fwhm-max", "NaN"],
            ["--fwhm-max", "inf"],
            ["--colour", "red"],
        ] {
            let refused = options(&arguments).map(|options| options.search()).unwrap_err().to_string();
            assert!(refused.contains(arguments[0]), "{arguments:?}: {refused}");
        }
    }
}
