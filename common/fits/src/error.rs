//! The faults of a FITS file, and what to do then.

use std::path::PathBuf;

/// A file that gives no image.
#[derive(Debug, thiserror::Error)]
#[error("{} {fault}", file.display())]
pub struct FitsError {
    /// Which file.
    pub file: PathBuf,
    /// The fault.
    pub fault: Fault,
}

/// The fault of a file; the text continues after the file's name.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// The operating system does not give it.
    #[error("cannot be read: {0}")]
    Unreadable(#[from] std::io::Error),
    /// It must not be written to.
    #[error("is read-only and is left as it is: give yourself the right to write it, or another file for the result")]
    ReadOnly,
    /// No bytes at all.
    #[error("is empty (0 bytes): copy or fetch it again")]
    Empty,
    /// Other bytes than those of FITS.
    #[error("is not FITS: it {looks}")]
    NotFits {
        /// The probable kind of the file, and what to do then.
        looks: String,
    },
    /// gzip or bzip2 does not unpack.
    #[error("is damaged or cut short ({how} says: {detail}): copy or fetch it again")]
    Packed {
        /// The program that packed it.
        how: &'static str,
        /// The error of the unpacking.
        detail: String,
    },
    /// More than is taken.
    #[error("is too large: {what}, at most {most} are taken")]
    TooLarge {
        /// The quantity that is too large, with its number.
        what: String,
        /// The most that is taken.
        most: u64,
    },
    /// The file ends too early.
    #[error("is cut short: HDU {hdu} should end at byte {expected}, the file has {found}; copy or fetch it again")]
    CutShort {
        /// Part of the file, from 1.
        hdu: usize,
        /// Bytes up to the end of this part.
        expected: u64,
        /// Bytes that are there.
        found: u64,
    },
    /// A header that cannot be followed.
    #[error("has a broken header in HDU {hdu}: {problem}; write it again with the program that made it")]
    Header {
        /// Part of the file, from 1.
        hdu: usize,
        /// Which keyword, what was expected.
        problem: String,
    },
    /// FITS, but without an image.
    #[error("holds no image, only {found}; give a file with an image of two axes")]
    NoImage {
        /// The parts of the file.
        found: String,
    },
    /// The part that was asked for is not there, or is no image.
    #[error("has no image in HDU {hdu}; {}", images_text(images))]
    NoSuchImage {
        /// Part of the file, from 1.
        hdu: usize,
        /// The parts that hold images.
        images: Vec<usize>,
    },
    /// The part whose header was asked for is not there.
    #[error("has no HDU {hdu}, only {hdus}; the first header is HDU 1")]
    NoSuchHdu {
        /// Part of the file, from 1.
        hdu: usize,
        /// How many it has.
        hdus: usize,
    },
    /// FITS, but no binary table.
    #[error("holds no binary table, only {found}; give a file with one")]
    NoTable {
        /// The parts of the file.
        found: String,
    },
    /// A cube or a spectrum.
    #[error(
        "holds no flat image: HDU {hdu} has the axes {axes}, expected two, or three with three colour planes; give a plane \
         of it, such as `imcopy 'FILE[*,*,1]' plane.fits` of cfitsio makes"
    )]
    Axes {
        /// Part of the file, from 1.
        hdu: usize,
        /// Their lengths.
        axes: String,
    },
    /// The bytes are not those that were written.
    #[error("is damaged: DATASUM of HDU {hdu} is {expected}, its bytes give {found}; copy or fetch it again")]
    Checksum {
        /// Part of the file, from 1.
        hdu: usize,
        /// The sum in the header.
        expected: u32,
        /// The sum of the bytes.
        found: u32,
    },
    /// Tiles that cfitsio does not decode.
    #[error("does not decompress: HDU {hdu}: {detail}; copy or fetch it again, or unpack it with `funpack`")]
    Tiles {
        /// Part of the file, from 1.
        hdu: usize,
        /// The error of cfitsio.
        detail: String,
    },
}

/// The HDUs that can be asked for.
fn images_text(images: &[usize]) -> String {
    if images.is_empty() {
        return "the file holds none".to_owned();
    }
    let numbers: Vec<String> = images.iter().map(usize::to_string).collect();
    format!("images are in HDU {}; the first header is HDU 1", numbers.join(", "))
}
