//! `starmesh measure`: sky, noise, and the stars of FITS files.

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Args;
use imaging::{Measured, Star};
use serde_json::{Value, json};

use super::exposure::{Chosen, Exposure};
use super::{Output, each, rounded, significant};

/// Stars in the text; JSON has all.
const SHOWN: usize = 20;

/// Options of `starmesh measure`.
#[derive(Debug, Args)]
pub struct Options {
    /// FITS images, plain or packed (.fz, .gz, .bz2).
    #[arg(required = true)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    chosen: Chosen,
    #[command(flatten)]
    output: Output,
}

/// Measures one file after the other.
pub fn run(options: &Options) -> anyhow::Result<()> {
    each(&options.files, |file| {
        let exposure = Exposure::open(file, options.chosen)?;
        let measured = exposure.measure()?;
        options.output.print(&answer(&exposure, &measured), || sentences(&exposure, &measured))
    })
}

/// The JSON answer: ADU of a pixel, px with (0, 0) at the centre of the first pixel; null where no star gives a value.
fn answer(exposure: &Exposure, measured: &Measured) -> Value {
    let quality = &measured.quality;
    let star = |star: &Star| {
        json!({
            "x_px": rounded(star.x_px, 4),
            "y_px": rounded(star.y_px, 4),
            "flux_adu": significant(star.flux_adu, 6),
            "fwhm_px": rounded(star.fwhm_px, 4),
            "snr": rounded(star.snr, 2),
            "flags": star.flags.words(),
        })
    };
    json!({
        "file": exposure.file.display().to_string(),
        "background_adu": significant(quality.background_adu, 6),
        "noise_adu": significant(quality.noise_adu, 6),
        "fwhm_px": quality.fwhm_px.and_then(|width| rounded(width.value, 4)),
        "ellipticity": quality.ellipticity.and_then(|ellipticity| rounded(ellipticity.value, 4)),
        "stars": measured.stars.iter().map(star).collect::<Vec<_>>(),
    })
}

fn sentences(exposure: &Exposure, measured: &Measured) -> String {
    let quality = &measured.quality;
    let mut text = format!(
        "{}: {} x {} px{}, background {} ADU, noise {} ADU",
        exposure.file.display(),
        exposure.width_px(),
        exposure.height_px(),
        if exposure.mosaic { " in a colour mosaic" } else { "" },
        significant(quality.background_adu, 5).unwrap_or_default(),
        significant(quality.noise_adu, 4).unwrap_or_default()
    );
    // Writing to a String cannot fail.
    let _ = match (quality.fwhm_px, quality.ellipticity) {
        (Some(width), Some(shape)) => write!(
            text,
            ", FWHM {:.2} +- {:.2} px, ellipticity {:.2}{}",
            width.value,
            width.error,
            shape.value,
            if quality.trailed { " (trailed)" } else { "" }
        ),
        _ => write!(text, ", no star well enough seen for a width"),
    };
    let count = measured.stars.len();
    let _ = write!(text, ", {count} stars");
    if count > 0 {
        let _ = write!(text, "\n      x px      y px     flux ADU  FWHM px       S/N  flags");
    }
    for star in measured.stars.iter().take(SHOWN) {
        let _ = write!(
            text,
            "\n{:10.2}{:10.2}{:13.0}{:9.2}{:10.1}  {}",
            star.x_px,
            star.y_px,
            star.flux_adu,
            star.fwhm_px,
            star.snr,
            star.flags.words().join(" ")
        );
    }
    if count > SHOWN {
        let _ = write!(text, "\n  and {} fainter ones (--json prints all)", count - SHOWN);
    }
    text
}
