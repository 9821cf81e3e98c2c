//! Pictures of frames for eyes: pixels made fewer ([`shrink`]), counts made grey ([`stretch`], [`zscale`]), grey made JPEG
//! ([`jpeg`]); and tiles of 16 bits ([`tile`]), with which a program makes pictures of its own.
//!
//! Pure: values in, values out. The first row of a frame is the upper row of its picture.

pub mod jpeg;
pub mod shrink;
pub mod stretch;
pub mod tile;
mod zscale;

/// A frame's pixels, in rows from the first row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pixels<'a> {
    /// Counts of 0 to 65535.
    Counts(&'a [u16]),
    /// All else; what is not finite is no value.
    Values(&'a [f32]),
}

/// A frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame<'a> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Its pixels; where there are too few, the others have no value.
    pub pixels: Pixels<'a>,
}

/// A small picture: rows one after another from the first row; a pixel without any finite value is `NaN`.
#[derive(Debug, Clone, PartialEq)]
pub struct Small {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Mean of each block.
    pub pixels: Vec<f32>,
}
