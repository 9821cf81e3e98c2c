//! Many frames of one target as one file: a cube of pixels (x, y, frame) and a table `METADATA` with one row per frame
//! and one column for each keyword that is not the same in all frames.
//!
//! The headers are read twice and the pixels once, one after the other, so that memory does not grow with the number of
//! frames. Pixels are copied as they are in the frames' files, bit for bit, and held against the DATASUM of each file.
//! The cube appears under its name when it is whole.

mod columns;
mod frame;
mod out;

use std::io;
use std::path::{Path, PathBuf};

use columns::Columns;
use frame::FrameFile;
use out::CubeFile;

/// What was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CubeSummary {
    /// Frames, one after another along the third axis.
    pub frames: usize,
    /// Columns of the table.
    pub columns: usize,
    /// Size of the file.
    pub bytes: u64,
}

/// No cube was written, and nothing is left of it.
#[derive(Debug, thiserror::Error)]
pub enum CubeError {
    /// There is nothing to put into it.
    #[error("a cube needs at least one frame")]
    NoFrames,
    /// The name is taken.
    #[error("{} is there already; a cube replaces nothing: give another name, or remove it", .0.display())]
    Exists(PathBuf),
    /// A frame cannot be part of it.
    #[error("{} cannot be part of the cube: {why}", file.display())]
    Frame {
        /// Which file.
        file: PathBuf,
        /// Why.
        why: String,
    },
    /// There are more keywords than columns.
    #[error(
        "{count} keywords are not the same in all frames, and a table of FITS has at most {most} columns; make cubes of fewer \
         frames, of one target, or leave the frames out whose headers have the odd keywords"
    )]
    Columns {
        /// How many.
        count: usize,
        /// How many there can be.
        most: usize,
    },
    /// The cube cannot be written.
    #[error("cannot write {}: {source}", file.display())]
    Write {
        /// Which file.
        file: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
}

/// Writes the frames of these files, in this order, into a new file.
///
/// # Errors
/// A frame that cannot be read, is no plain image of two axes, has another shape than the first one, or whose pixels do
/// not add up to its DATASUM; a target that exists or cannot be written.
pub fn write_cube(frames: &[PathBuf], target: &Path) -> Result<CubeSummary, CubeError> {
    let (first, others) = frames.split_first().ok_or(CubeError::NoFrames)?;
    if target.exists() {
        return Err(CubeError::Exists(target.to_owned()));
    }
    let first = FrameFile::open(first)?;
    let mut columns = Columns::of(&first);
    for file in others {
        let frame = FrameFile::open(file)?;
        if frame.layout != first.layout {
            let why = format!("it is {}, and the first frame is {}", frame.layout, first.layout);
            return Err(CubeError::Frame { file: file.clone(), why });
        }
        columns.add(&frame);
    }
    let columns = columns.finish().map_err(|count| CubeError::Columns { count, most: columns::MOST_COLUMNS })?;
    let written = |file: &mut CubeFile| -> Result<u64, CubeError> {
        file.begin_pixels(&first, &columns, frames.len())?;
        for file_of_frame in frames {
            let frame = FrameFile::open(file_of_frame)?;
            if frame.layout != first.layout {
                return Err(frame.failed("it changed while the cube was written; try again".to_owned()));
            }
            file.add_pixels(frame)?;
        }
        file.begin_rows(&columns, frames.len())?;
        for file_of_frame in frames {
            let row = columns.row(&FrameFile::open(file_of_frame)?)?;
            file.add_row(&row)?;
        }
        file.finish()
    };
    let mut file = CubeFile::create(target)?;
    let bytes = written(&mut file)?;
    file.put_in_place()?;
    Ok(CubeSummary { frames: frames.len(), columns: columns.count(), bytes })
}

#[cfg(test)]
mod tests;
