//! An image out of a file: its header and its pixels.

use std::io::Read as _;
use std::path::Path;

use crate::decode::{Scaling, decode};
use crate::error::{Fault, FitsError};
use crate::hdu::{self, Content, Hdu, Shape};
use crate::header::Header;
use crate::{tiles, tiling, unpack};

/// More pixels are not taken: some eight times the largest frame of our cameras.
const MOST_PIXELS: u64 = 1 << 29;
/// Parts of a file that are looked at.
const MOST_HDUS: usize = 10_000;

/// Pixels in row order, the first row of the file first, scaled by BSCALE and BZERO.
#[derive(Debug, Clone, PartialEq)]
pub enum Pixels {
    /// Counts of 0 to 65535, without loss: 16 bits with BZERO 32768, and 8 bits.
    U16(Vec<u16>),
    /// All else. NaN where there is no value (BLANK). 32 and 64 bits are rounded to the 24 that a float keeps.
    F32(Vec<f32>),
}

impl Pixels {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Self::U16(counts) => counts.len(),
            Self::F32(floats) => floats.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A flat image, of at least one pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// Its keywords; those of the file's first part too, where the image stands in another one.
    pub header: Header,
    /// Part of the file that it stands in, from 1.
    pub hdu: usize,
    /// Columns, px.
    pub width_px: usize,
    /// Rows, px.
    pub height_px: usize,
    /// Bits of a pixel in the file, negative for floats.
    pub bitpix: i64,
    /// `width_px * height_px` values.
    pub pixels: Pixels,
}

/// Reads the first image with pixels of a file.
///
/// # Errors
/// [`FitsError`] when the file cannot be read, is no FITS, is damaged, or holds no image of two axes.
pub fn read(file: &Path) -> Result<Image, FitsError> {
    let bytes = bytes_of(file);
    let bytes = bytes.map_err(|error| FitsError { file: file.to_owned(), fault: Fault::Unreadable(error) })?;
    parse(file, bytes)
}

fn bytes_of(file: &Path) -> std::io::Result<Vec<u8>> {
    let mut file = std::fs::File::open(file)?;
    // what grows meanwhile is read all the same, and what tells no true length too
    let mut bytes = pages::with_room(usize::try_from(file.metadata()?.len()).unwrap_or(0));
    file.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Reads the first image with pixels of a file's bytes; `file` is its name for what is said of it.
///
/// # Errors
/// As [`read`].
pub fn parse(file: &Path, bytes: Vec<u8>) -> Result<Image, FitsError> {
    first_image(file, bytes).map_err(|fault| FitsError { file: file.to_owned(), fault })
}

fn first_image(file: &Path, bytes: Vec<u8>) -> Result<Image, Fault> {
    let bytes = unpack::unpack(bytes)?;
    let (mut start, mut passed) = (0, Vec::<Hdu>::new());
    for number in 1..=MOST_HDUS {
        let Some(hdu) = hdu::read(file, &bytes, start, number)? else { break };
        let shape = match &hdu.content {
            Content::Image(shape) | Content::Tiles(shape) => Some(shape.clone()),
            Content::Other(_) => None,
        };
        let has_pixels = |shape: &Shape| !shape.axes.is_empty() && shape.axes.iter().all(|length| *length > 0);
        if let Some(shape) = shape.filter(has_pixels) {
            // only then: scaling and sums of the first part are not this one's
            let mut image = image(bytes, hdu, &shape)?;
            if let Some(primary) = passed.first() {
                image.header.inherit(&primary.header);
            }
            return Ok(image);
        }
        start = hdu.next();
        passed.push(hdu);
    }
    let found: Vec<String> = passed.iter().map(Hdu::words).collect();
    Err(Fault::NoImage { found: found.join(", ") })
}

fn image(bytes: Vec<u8>, hdu: Hdu, shape: &Shape) -> Result<Image, Fault> {
    // axes of one pixel behind the second change nothing
    let (width, height) = match shape.axes.as_slice() {
        [width, height, rest @ ..] if rest.iter().all(|length| *length == 1) => (*width, *height),
        axes => {
            let axes: Vec<String> = axes.iter().map(u64::to_string).collect();
            return Err(Fault::Axes { hdu: hdu.number, axes: axes.join(" x ") });
        }
    };
    let count = width.checked_mul(height).filter(|count| *count <= MOST_PIXELS).ok_or_else(|| Fault::TooLarge {
        what: format!("HDU {} has {width} x {height} px", hdu.number),
        most: MOST_PIXELS,
    })?;
    let broken = |problem: String| Fault::Header { hdu: hdu.number, problem };
    let scaling = Scaling::of(&hdu.header).map_err(|error| broken(error.to_string()))?;
    let pixels = if matches!(hdu.content, Content::Tiles(_)) {
        tiling::check(&hdu.header, shape).map_err(&broken)?;
        check_sum(&hdu, &bytes)?;
        let tiles = tiles::decode(bytes, hdu.number, count as usize, scaling.are_counts(shape.bitpix));
        tiles.map_err(|detail| Fault::Tiles { hdu: hdu.number, detail })?
    } else {
        decode(bytes.get(hdu.data.clone()).unwrap_or_default(), shape.bitpix, &scaling)
    };
    if pixels.len() as u64 != count {
        return Err(broken(format!("{width} x {height} px, but {} values; PCOUNT or GCOUNT is wrong", pixels.len())));
    }
    let Hdu { header, number: hdu, .. } = hdu;
    let (width_px, height_px) = (width as usize, height as usize);
    Ok(Image { header, hdu, width_px, height_px, bitpix: shape.bitpix, pixels })
}

/// Compares the data with DATASUM, where the header has it (FITS Standard 4.0, appendix J): a decoder of damaged
/// streams is not to be trusted.
fn check_sum(hdu: &Hdu, bytes: &[u8]) -> Result<(), Fault> {
    let stands = hdu.header.text("DATASUM").ok().and_then(|text| text.trim().parse::<u32>().ok());
    let Some(expected) = stands else { return Ok(()) };
    let data = bytes.get(hdu.data.start..hdu.next().min(bytes.len())).unwrap_or_default();
    // ones' complement: what overflows 32 bits comes in again at the low end; zeros fill a short last word
    let sum: u64 = data.chunks(4).fold(0, |sum, word| {
        let sum = sum + word.iter().zip([24, 16, 8, 0]).map(|(byte, shift)| u64::from(*byte) << shift).sum::<u64>();
        (sum & 0xffff_ffff) + (sum >> 32)
    });
    let found = sum as u32;
    if found == expected { Ok(()) } else { Err(Fault::Checksum { hdu: hdu.number, expected, found }) }
}
