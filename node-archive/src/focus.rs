//! Writes focus runs with all that was measured into the database, and a plot next to the frames.
//!
//! The observatory node publishes a run once, when it has ended, with all its points; an archive that was away can
//! recover it from the bus. The archive draws the plot from the points, so that only numbers are published.

use anyhow::Context as _;
use bus::Catch;
use contract::observatory::{FocusCurve, FocusPass, FocusRun};
use contract::{Key, Scalar};
use imaging::focus::plot::Plot;
use imaging::focus::sweep::{FocusFit, FocusMeasurement, Pass};
use imaging::focus::{Better, Hyperbola, SMOOTHERS};
use imaging::quality::Estimate;
use node::Node;
use tokio::sync::mpsc;

use crate::database::{Database, StoredRun, Write};
use crate::folder::put;
use crate::name::part;

/// Folder of the plots, inside the folder of images.
const FOLDER: &str = "autofocus";
/// Runs that wait here when the database is slow.
const WAITING: usize = 256;

/// Stores the focus runs of this telescope; the plot of each is for [`draw`], whose disk may be away.
pub async fn keep(node: Node, database: Database, plots: mpsc::UnboundedSender<FocusRun>) -> anyhow::Result<()> {
    let key = Key::FocusRun(node.config.address());
    let runs = node.bus.subscribe::<FocusRun>(&key.to_string(), Catch::All, WAITING).await?;
    let mut count = 0;
    loop {
        let received = runs.recv().await;
        let (run, at) = (received.sample.body, received.sample.at_utc);
        let origin = (received.sample.boot_id, received.sample.seq);
        let stored = StoredRun { plot: plot_name(&run), at, origin, run: run.clone() };
        database.commit(vec![Write::Focus(Box::new(stored))]).await?;
        // Without a receiver the archive ends.
        let _ = plots.send(run);
        count += 1;
        node.figure("focus_runs", Scalar::Int(count));
    }
}

/// Writes the plots next to the frames.
pub async fn draw(node: Node, mut plots: mpsc::UnboundedReceiver<FocusRun>) -> anyhow::Result<()> {
    loop {
        let run = plots.recv().await.context("no more focus runs come")?;
        let (images, title) = (node.config.folders.images.clone(), node.config.place.telescope.to_string());
        let drawn = tokio::task::spawn_blocking(move || {
            put(&images, &images.join(plot_name(&run)), svg(&run, &title).as_bytes())
        });
        if let Err(error) = drawn.await? {
            // The numbers are in the database.
            tracing::warn!(%error, "the plot of a focus run could not be written");
        }
    }
}

/// Where the plot of a run goes, relative to the folder of images.
fn plot_name(run: &FocusRun) -> String {
    let filter = run.filter.as_ref().map(|filter| format!("_{filter}")).unwrap_or_default();
    let stamp = run.started_utc.strftime("%Y%m%d_%H%M%S");
    let name = part(&format!("{}_{}{filter}_{stamp}.svg", run.camera, run.focuser));
    format!("{FOLDER}/{}/{name}", part(&run.night))
}

/// The run as a picture.
pub fn svg(run: &FocusRun, telescope: &str) -> String {
    let filter = run.filter.as_deref().unwrap_or("no filter named");
    let at = run.started_utc.strftime("%Y-%m-%d %H:%M:%S");
    let points: Vec<FocusMeasurement> = run.points.iter().filter_map(point).collect();
    let fit = run.curve.as_ref().and_then(|curve| fit(curve, run));
    Plot {
        title: &format!("{telescope} {}, {filter}, {at} UTC", run.camera),
        value_label: &run.value_label,
        points: &points,
        fit: fit.as_ref(),
        // `as` saturates.
        chosen: run.best_position.map(|best| best.round() as i32),
    }
    .svg()
}

fn point(point: &contract::observatory::FocusPoint) -> Option<FocusMeasurement> {
    let pass = match point.pass {
        FocusPass::Coarse => Pass::Coarse,
        FocusPass::Fine => Pass::Fine,
        FocusPass::Verification => Pass::Verification,
    };
    let value = point.value.map(|value| Estimate { value, error: point.error.unwrap_or(f64::NAN) });
    Some(FocusMeasurement { position: i32::try_from(point.position).ok()?, pass, value })
}

fn fit(curve: &FocusCurve, run: &FocusRun) -> Option<FocusFit> {
    if let Some(slope) = curve.slope_per_step {
        let of_curve = run.points.iter().filter(|point| point.pass != FocusPass::Verification);
        return Some(FocusFit::Hyperbola(Hyperbola {
            best_position: curve.best_position,
            best_position_error: run.best_position_error.unwrap_or(f64::NAN),
            least_size: curve.best_value,
            slope,
            asymmetry: 0.0,
            used: of_curve.map(|point| point.used.unwrap_or(false)).collect(),
        }));
    }
    let smoother = SMOOTHERS.iter().find(|smoother| smoother.name == curve.model)?;
    Some(FocusFit::Smoothed {
        smoother: smoother.name,
        better: if curve.larger_is_better { Better::Larger } else { Better::Smaller },
        curve: curve.places.iter().map(|[position, value]| (*position, *value)).collect(),
        best: (curve.best_position, curve.best_value),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The contract's own sample: a smoothed curve, one point without a value.
    fn sample() -> FocusRun {
        let text = include_str!("../../common/contract/golden/v1/observatory.focus_run.json");
        serde_json::from_str(text).unwrap()
    }

    #[test]
    fn a_plot_stands_in_the_night_of_its_run_under_a_harmless_name() {
        assert_eq!(plot_name(&sample()), "autofocus/20261120/andor_focuser_V_20261121_030800.svg");
        let odd = FocusRun { night: "../..".to_owned(), filter: Some("a/b".to_owned()), ..sample() };
        assert_eq!(plot_name(&odd), "autofocus/__/andor_focuser_a_b_20261121_030800.svg");
    }

    #[test]
    fn the_picture_shows_what_was_published() {
        let smoothed = svg(&sample(), "callisto");
        let count = |svg: &str, what: &str| svg.matches(what).count();
        assert!(smoothed.contains("callisto andor, V, 2026-11-21 03:08:00 UTC"), "{smoothed}");
        assert_eq!((count(&smoothed, "<circle"), count(&smoothed, "class=\"none\"")), (2, 1), "{smoothed}");
        assert_eq!((count(&smoothed, "class=\"fit\""), count(&smoothed, "class=\"chosen\"")), (1, 1));
        let mut sized = sample();
        let curve = sized.curve.as_mut().unwrap();
        (curve.model, curve.slope_per_step, curve.best_value) = ("hyperbola".to_owned(), Some(0.0161), 1.9);
        let sized = svg(&sized, "callisto");
        assert!(sized.contains("23150 ± 3.1") && count(&sized, "fill=\"#fff\" stroke") == 0, "{sized}");
        let bare = FocusRun { points: vec![], curve: None, best_position: None, filter: None, ..sample() };
        assert!(svg(&bare, "x").ends_with("</svg>\n"));
    }
}
