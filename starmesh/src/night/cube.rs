//! `starmesh night cube`: all frames of a target as one FITS file.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::bail;
use clap::Args;
use contract::frame_search::{FoundFrame, FrameSearch};
use fits::cube::write_cube;

use super::Selection;
use crate::console::{foreign_line, line};

/// Which frames, and where to.
#[derive(Debug, Args)]
pub struct Options {
    #[command(flatten)]
    selection: Selection,
    /// Name of the target.
    #[arg(long, value_name = "NAME")]
    object: String,
    /// Only frames of this camera.
    #[arg(long)]
    camera: Option<String>,
    /// Only frames with this filter.
    #[arg(long)]
    filter: Option<String>,
    /// The new file.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// The archive, the frames or the file cannot be used.
pub fn run(options: &Options) -> anyhow::Result<()> {
    let (archive, night) = options.selection.open()?;
    let search = FrameSearch {
        camera: options.camera.clone(),
        object: Some(options.object.clone()),
        filter: options.filter.clone(),
        image_type: Some("Light Frame".to_owned()),
        ..FrameSearch::default()
    };
    let found = archive.reader.search(&search, (Some(night.from), Some(night.to)), usize::MAX)?.frames;
    if found.is_empty() {
        bail!(
            "no light frame of {:?} is stored of the night {}; `starmesh archive frames --night {}` lists what is",
            options.object,
            night.date,
            night.date
        );
    }
    one_kind(&found)?;
    let images = &archive.config.folders.images;
    let files: Vec<PathBuf> = found.iter().map(|frame| images.join(&frame.file)).collect();
    let incomplete = found.iter().filter(|frame| !frame.header_complete).count();
    if incomplete > 0 {
        line(format_args!("{incomplete} headers are not complete yet: what they lack is blank in the table"))?;
    }
    let cube = write_cube(&files, &options.out)?;
    foreign_line(format_args!(
        "{}: {} frames, {} columns in METADATA, {:.3} GB",
        options.out.display(),
        cube.frames,
        cube.columns,
        cube.bytes as f64 / 1e9
    ))
}

/// Frames of a cube have one camera, one size and one binning.
fn one_kind(found: &[FoundFrame]) -> anyhow::Result<()> {
    let mut kinds: BTreeMap<(&str, u32, u32, u32), usize> = BTreeMap::new();
    for frame in found {
        *kinds.entry((frame.camera.as_str(), frame.width_px, frame.height_px, frame.bin)).or_default() += 1;
    }
    if kinds.len() > 1 {
        let listed = kinds.iter().map(|((camera, width, height, bin), count)| {
            format!("{count} of camera {camera}, {width} x {height} px, binning {bin}")
        });
        bail!(
            "the frames are of {} kinds, and a cube has one: {}; choose with --camera or --filter, or take a part of them by \
             `starmesh archive frames`",
            kinds.len(),
            listed.collect::<Vec<_>>().join("; ")
        );
    }
    Ok(())
}

#[cfg(test)]
#[path = "cube_tests.rs"]
mod tests;
