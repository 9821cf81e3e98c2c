//! `starmesh focus`: where the focus is, from frames taken at several positions of the focuser.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail, ensure};
use clap::Args;
use fits::KeywordError;
use imaging::focus::{Hyperbola, Size};
use imaging::hfd::{HfdSearch, measure_hfd};
use serde_json::{Value, json};

use super::exposure::{Chosen, Exposure};
use super::{Output, each, rounded};

/// Options of `starmesh focus`.
#[derive(Debug, Args)]
pub struct Options {
    /// FITS images of one field at different positions of the focuser (FOCUSPOS in their headers), in any order.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    chosen: Chosen,
    #[command(flatten)]
    output: Output,
}

/// The result of one frame.
struct Point {
    file: PathBuf,
    position: f64,
    /// Half-flux diameter and its error, px, and the stars it is taken from; else why there is none.
    size: Result<(f64, f64, usize), String>,
}

/// Measures all frames, then fits.
pub fn run(options: &Options) -> anyhow::Result<()> {
    let mut points = Vec::new();
    each(&options.files, |file| {
        points.push(point(file, options.chosen)?);
        Ok(())
    })?;
    points.sort_by(|a, b| a.position.total_cmp(&b.position));
    let sizes: Vec<Size> = points
        .iter()
        .map(|point| {
            let (size, error) = point.size.as_ref().map_or((f64::NAN, f64::NAN), |(size, error, _)| (*size, *error));
            Size { position: point.position, size, error }
        })
        .collect();
    let curve = fitted(&sizes);
    options.output.print(&answer(&points, &curve), || sentences(&points, &curve))?;
    curve.map(|_| ()).context("no focus from these frames")
}

/// The curve, with its minimum among the frames: beyond them it is a guess.
fn fitted(sizes: &[Size]) -> anyhow::Result<Hyperbola> {
    let curve = Hyperbola::fit(sizes)?;
    let used = || sizes.iter().zip(&curve.used).filter(|(_, used)| **used).map(|(size, _)| size.position);
    let (low, high) = (used().fold(f64::INFINITY, f64::min), used().fold(f64::NEG_INFINITY, f64::max));
    ensure!(
        (low..=high).contains(&curve.best_position),
        "the focus seems to be near {:.0}, beyond the frames ({low:.0} to {high:.0}); take frames there",
        curve.best_position
    );
    Ok(curve)
}

fn point(file: &Path, chosen: Chosen) -> anyhow::Result<Point> {
    let exposure = Exposure::open(file, chosen)?;
    let numbers = ["FOCUSPOS", "FOCPOS"].map(|keyword| exposure.header().number(keyword));
    let position = numbers.iter().flatten().copied().find(|position| position.is_finite());
    let Some(position) = position else {
        // A value of another type is a better reason than a missing keyword.
        let odd = numbers.into_iter().filter_map(Result::err).find(|why| matches!(why, KeywordError::Kind { .. }));
        if let Some(why) = odd {
            bail!("{why}: the focuser's position in steps")
        }
        bail!("{} has no FOCUSPOS in its header; expected the focuser's position in steps", file.display())
    };
    let size = if exposure.mosaic {
        // Filters on the pixels break the sums of light: the width of the stars in its binned frame instead.
        let measured = exposure.measure()?;
        let count = measured.stars.len();
        let width = measured.quality.fwhm_px.map(|width| (width.value, width.error, count));
        width.ok_or_else(|| format!("no star good enough among {count}"))
    } else {
        let found = measure_hfd(&exposure.frame()?, &exposure.camera(), &HfdSearch::default());
        found.map(|hfd| (hfd.hfd_px.value, hfd.hfd_px.error, hfd.stars.len())).map_err(|reason| reason.to_string())
    };
    Ok(Point { file: exposure.file, position, size })
}

/// The JSON answer: steps of the focuser and px; null where there is no focus.
fn answer(points: &[Point], curve: &anyhow::Result<Hyperbola>) -> Value {
    let fit = curve.as_ref().ok();
    let point = |(n, point): (usize, &Point)| {
        let size = point.size.as_ref().ok();
        json!({
            "file": point.file.display().to_string(),
            "position": rounded(point.position, 3),
            "hfd_px": size.and_then(|(size, ..)| rounded(*size, 4)),
            "error_px": size.and_then(|(_, error, _)| rounded(*error, 4)),
            "stars": size.map_or(0, |(.., stars)| *stars),
            "used": fit.map(|fit| fit.used.get(n).copied().unwrap_or(false)),
        })
    };
    json!({
        "best_position": fit.and_then(|fit| rounded(fit.best_position, 2)),
        "error": fit.and_then(|fit| rounded(fit.best_position_error, 2)),
        "model": "hyperbola",
        "hfd_px": fit.and_then(|fit| rounded(fit.least_size, 4)),
        "critical_zone": fit.and_then(|fit| rounded(fit.critical_zone(), 2)),
        "points": points.iter().enumerate().map(point).collect::<Vec<_>>(),
        "reason": curve.as_ref().err().map(|error| format!("{error:#}")),
    })
}

fn sentences(points: &[Point], curve: &anyhow::Result<Hyperbola>) -> String {
    let mut lines = vec![match curve {
        Ok(fit) => format!(
            "best focus at {:.1} +- {:.1} (hyperbola), HFD {:.2} px there, critical zone +- {:.1}",
            fit.best_position,
            fit.best_position_error,
            fit.least_size,
            fit.critical_zone()
        ),
        Err(error) => format!("no focus: {error:#}"),
    }];
    lines.push("  position   HFD px  +- px  stars  used  file".to_owned());
    for (n, point) in points.iter().enumerate() {
        let file = point.file.display();
        let used = curve.as_ref().is_ok_and(|fit| fit.used.get(n) == Some(&true));
        let used = if used { "yes" } else { "no" };
        lines.push(match &point.size {
            Ok((size, error, stars)) => {
                format!("{:10.1}{size:9.2}{error:7.2}{stars:7}{used:>6}  {file}", point.position)
            }
            Err(reason) => format!("{:10.1}  {reason}  {file}", point.position),
        });
    }
    lines.join("\n")
}
