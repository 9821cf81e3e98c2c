//! `starmesh shift`: how far the stars moved from one FITS file to another.

use std::path::PathBuf;

use anyhow::{Context as _, ensure};
use clap::Args;
use imaging::projection::from_projections;
use imaging::shift::{Method, from_stars_either_way};
use imaging::{Clean, NoShift, Shift};
use serde_json::{Value, json};

use super::exposure::{Chosen, Exposure};
use super::{Output, rounded};

/// Options of `starmesh shift`.
#[derive(Debug, Args)]
pub struct Options {
    /// The FITS image that is compared with.
    reference: PathBuf,
    /// The one whose stars may have moved.
    check: PathBuf,
    #[command(flatten)]
    chosen: Chosen,
    #[command(flatten)]
    output: Output,
}

/// Compares the two.
pub fn run(options: &Options) -> anyhow::Result<()> {
    let (mut reference, mut check) =
        (Exposure::open(&options.reference, options.chosen)?, Exposure::open(&options.check, options.chosen)?);
    let shape = |exposure: &Exposure| (exposure.width_px(), exposure.height_px());
    ensure!(
        shape(&reference) == shape(&check),
        "{} is {} x {} px, {} is {} x {} px; give two frames of one camera and binning",
        reference.file.display(),
        reference.width_px(),
        reference.height_px(),
        check.file.display(),
        check.width_px(),
        check.height_px()
    );
    // frames of one camera are both mosaics or neither, though one may be too dark to show it
    reference.mosaic |= check.mosaic;
    check.mosaic = reference.mosaic;
    let shift = between(&reference, &check)
        .with_context(|| format!("no shift from {} to {}", reference.file.display(), check.file.display()))?;
    options.output.print(&answer(&shift), || sentence(&shift))
}

/// By stars, and by projections where there are too few of them. Stars that are there and do not match are not
/// overruled: projections of two different fields may agree by chance.
fn between(reference: &Exposure, check: &Exposure) -> anyhow::Result<Shift> {
    let measured = [reference.measure()?, check.measure()?];
    let (width, height) = (reference.width_px(), reference.height_px());
    let by_stars = from_stars_either_way(&measured[0].stars, &measured[1].stars, width, height);
    match by_stars {
        // projections of a mosaic would show its pattern
        Err(reason @ (NoShift::TooFewStars { .. } | NoShift::Uncertain { .. })) if !reference.mosaic => {
            let clean = |exposure: &Exposure, n: usize| {
                let width = measured[n].quality.fwhm_px.map(|width| width.value as f32);
                Clean::new(&exposure.frame()?, &exposure.camera(), width).map_err(anyhow::Error::from)
            };
            from_projections(&clean(reference, 0)?, &clean(check, 1)?).with_context(|| reason.to_string())
        }
        by_stars => Ok(by_stars?),
    }
}

fn method(shift: &Shift) -> &'static str {
    match shift.method {
        Method::Stars => "stars",
        Method::Projections => "projections",
    }
}

/// The greater standard error of the two axes, px.
fn sigma_px(shift: &Shift) -> f64 {
    let (x, y) = shift.error_px();
    x.max(y)
}

/// Rotation in degrees from +x towards +y; `None` where it was not fitted: by projections, or with too few stars.
fn rotation_deg(shift: &Shift) -> Option<f64> {
    (shift.covariance[2][2] > 0.0).then_some(shift.rotation_deg)
}

/// The answer as JSON: check minus reference at the frame's centre.
fn answer(shift: &Shift) -> Value {
    json!({
        "dx_px": rounded(shift.dx_px, 4),
        "dy_px": rounded(shift.dy_px, 4),
        "sigma_px": rounded(sigma_px(shift), 4),
        "rotation_deg": rotation_deg(shift).and_then(|angle| rounded(angle, 5)),
        "stars": shift.stars,
        "method": method(shift),
    })
}

fn sentence(shift: &Shift) -> String {
    let rotation = rotation_deg(shift).map_or("not measured".to_owned(), |angle| {
        let turned = if angle.abs() > 90.0 { " (upside down, as after a meridian flip)" } else { "" };
        format!("{angle:.4} deg{turned}")
    });
    let by = match shift.method {
        Method::Stars => format!("{} stars", shift.stars),
        Method::Projections => "projections".to_owned(),
    };
    format!(
        "the stars moved by {:+.3}, {:+.3} px (+- {:.3}) at the centre, rotation {rotation}, by {by}",
        shift.dx_px,
        shift.dy_px,
        sigma_px(shift)
    )
}
