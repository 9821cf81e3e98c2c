//! An image from a file: its header and its pixels.

use std::io::{Cursor, Read};
use std::path::Path;

use crate::decode::{Scaling, decode};
use crate::error::{Fault, FitsError};
use crate::hdu::{self, Content, Hdu, Shape};
use crate::header::Header;
use crate::pixels::Pixels;
use crate::unpack::Source;
use crate::{planes, tiles, tiling};

/// More pixels are not taken: some eight times the largest frame of our cameras.
const MOST_PIXELS: u64 = 1 << 29;
/// Parts of a file that are looked at.
const MOST_HDUS: usize = 10_000;

/// A flat image, of at least one pixel; of a colour image (three planes) the mean of its planes.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// Its keywords; those of the file's first part too, where the image stands in another one.
    pub header: Header,
    /// Part of the file that it stands in, from 1.
    pub hdu: usize,
    /// The other parts that hold images, as far as they were looked at.
    pub other_hdus: Vec<usize>,
    /// Colour planes whose mean it is: 3, or 1.
    pub planes: usize,
    /// Columns, px.
    pub width_px: usize,
    /// Rows, px.
    pub height_px: usize,
    /// Bits of a pixel in the file, negative for floats.
    pub bitpix: i64,
    /// `width_px * height_px` values.
    pub pixels: Pixels,
}

/// Which image of a file is meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Part {
    /// The first one with pixels.
    #[default]
    First,
    /// That of the HDU of this number, from 1.
    Hdu(usize),
}

/// Reads the first image with pixels of a file.
///
/// # Errors
/// [`FitsError`] when the file cannot be read, is no FITS, is damaged, or holds no image of two axes.
pub fn read(file: &Path) -> Result<Image, FitsError> {
    read_part(file, Part::First)
}

/// Reads an image of a file.
///
/// # Errors
/// As [`read`], and [`Fault::NoSuchImage`] when that part holds none.
pub fn read_part(file: &Path, part: Part) -> Result<Image, FitsError> {
    let read = || {
        let opened = std::fs::File::open(file)?;
        let length = opened.metadata()?.len();
        // A file that is not a plain file has no known length.
        let known = opened.metadata()?.is_file().then_some(length);
        of_source(file, opened, known, part)
    };
    read().map_err(|fault| FitsError { file: file.to_owned(), fault })
}

/// Reads the first image with pixels of a file's bytes; `file` is its name in messages.
///
/// # Errors
/// As [`read`].
pub fn parse(file: &Path, bytes: Vec<u8>) -> Result<Image, FitsError> {
    let length = Some(bytes.len() as u64);
    of_source(file, Cursor::new(bytes), length, Part::First).map_err(|fault| FitsError { file: file.to_owned(), fault })
}

fn has_pixels(hdu: &Hdu) -> Option<Shape> {
    let shape = match &hdu.content {
        Content::Image(shape) | Content::Tiles(shape) => shape,
        Content::Other(_) => return None,
    };
    (!shape.axes.is_empty() && shape.axes.iter().all(|length| *length > 0)).then(|| shape.clone())
}

fn of_source(file: &Path, from: impl Read + 'static, length: Option<u64>, part: Part) -> Result<Image, Fault> {
    let mut source = Source::new(from, length)?;
    let (mut start, mut passed) = (0, Vec::<Hdu>::new());
    let mut images = Vec::new();
    for number in 1..=MOST_HDUS {
        let Some(hdu) = hdu::read(file, &mut source, start, number)? else { break };
        let shape = has_pixels(&hdu);
        images.extend(shape.is_some().then_some(number));
        let wanted = match part {
            Part::First => shape.is_some(),
            Part::Hdu(wanted) => wanted == number,
        };
        if let Some(shape) = shape.filter(|_| wanted) {
            let size = size(&hdu, &shape)?;
            hdu.fill(&mut source)?;
            let (behind, other_hdus) = (hdu.next(), images);
            let mut others = others(file, &mut source, behind, number)?;
            others.splice(0..0, other_hdus.into_iter().filter(|other| *other != number));
            source.finish(behind as u64)?;
            // Only then: scaling and sums of the first part do not apply to this one.
            let mut image = image(source.into_bytes(), hdu, &shape, size)?;
            if let Some(primary) = passed.first() {
                image.header.adopt_primary(&primary.header);
            }
            image.other_hdus = others;
            return Ok(image);
        }
        hdu.fill(&mut source)?;
        start = hdu.next();
        passed.push(hdu);
    }
    match part {
        Part::First => {
            let found: Vec<String> = passed.iter().map(Hdu::words).collect();
            Err(Fault::NoImage { found: found.join(", ") })
        }
        Part::Hdu(hdu) => Err(Fault::NoSuchImage { hdu, images }),
    }
}

/// The images behind the one that is taken; nothing where the file has no sound part any more.
fn others(file: &Path, source: &mut Source, mut start: usize, taken: usize) -> Result<Vec<usize>, Fault> {
    let mut found = Vec::new();
    for number in taken + 1..=MOST_HDUS {
        // Damage in the packing damages the part that is taken, too.
        let hdu = match hdu::read(file, source, start, number) {
            Err(fault @ Fault::Packed { .. }) => return Err(fault),
            Err(_) | Ok(None) => break,
            Ok(Some(hdu)) => hdu,
        };
        found.extend(has_pixels(&hdu).is_some().then_some(number));
        match hdu.fill(source) {
            Err(fault @ Fault::Packed { .. }) => return Err(fault),
            Err(_) => break,
            Ok(()) => start = hdu.next(),
        }
    }
    Ok(found)
}

/// Columns, rows and planes of an image, before a byte of it is read.
fn size(hdu: &Hdu, shape: &Shape) -> Result<(u64, u64, u64), Fault> {
    // Axes of one pixel behind the second change nothing.
    let (width, height, planes) = match shape.axes.as_slice() {
        [width, height, rest @ ..] if rest.iter().all(|length| *length == 1) => (*width, *height, 1),
        [width, height, planes::COLOURS, rest @ ..] if rest.iter().all(|length| *length == 1) => {
            (*width, *height, planes::COLOURS)
        }
        axes => {
            let axes: Vec<String> = axes.iter().map(u64::to_string).collect();
            return Err(Fault::Axes { hdu: hdu.number, axes: axes.join(" x ") });
        }
    };
    let count = width.checked_mul(height).and_then(|count| count.checked_mul(planes));
    let behind = if planes > 1 { format!(" x {planes}") } else { String::new() };
    match count.filter(|count| *count <= MOST_PIXELS) {
        Some(_) => Ok((width, height, planes)),
        None => Err(Fault::TooLarge {
            what: format!("HDU {} has {width} x {height}{behind} px", hdu.number),
            most: MOST_PIXELS,
        }),
    }
}

fn image(bytes: Vec<u8>, hdu: Hdu, shape: &Shape, (width, height, planes): (u64, u64, u64)) -> Result<Image, Fault> {
    let count = width * height * planes;
    let broken = |problem: String| Fault::Header { hdu: hdu.number, problem };
    let scaling = Scaling::of(&hdu.header).map_err(|error| broken(error.to_string()))?;
    let pixels = if matches!(hdu.content, Content::Tiles(_)) {
        tiling::check(&hdu.header, shape, hdu.data.len() as u64).map_err(&broken)?;
        check_sum(&hdu, &bytes)?;
        let tiles = tiles::decode(bytes, hdu.number, count as usize, scaling.are_counts(shape.bitpix));
        tiles.map_err(|detail| Fault::Tiles { hdu: hdu.number, detail })?
    } else {
        decode(bytes.get(hdu.data.clone()).unwrap_or_default(), shape.bitpix, &scaling)
    };
    if pixels.len() as u64 != count {
        return Err(broken(format!("{count} px, but {} values; PCOUNT or GCOUNT is wrong", pixels.len())));
    }
    let Hdu { header, number: hdu, .. } = hdu;
    let (width_px, height_px, planes) = (width as usize, height as usize, planes as usize);
    let pixels = if planes > 1 { planes::mean(&pixels, width_px * height_px, shape.bitpix) } else { pixels };
    let other_hdus = Vec::new();
    Ok(Image { header, hdu, other_hdus, planes, width_px, height_px, bitpix: shape.bitpix, pixels })
}

/// Compares the data with DATASUM, where the header has it (FITS Standard 4.0, appendix J): a decoder of damaged
/// streams cannot be trusted.
pub(crate) fn check_sum(hdu: &Hdu, bytes: &[u8]) -> Result<(), Fault> {
    let stands = hdu.header.text("DATASUM").ok().and_then(|text| text.trim().parse::<u32>().ok());
    let Some(expected) = stands else { return Ok(()) };
    let data = bytes.get(hdu.data.start..hdu.next().min(bytes.len())).unwrap_or_default();
    // Ones' complement: the overflow of 32 bits is added at the low end; zeros fill up the last four bytes.
    let sum: u64 = data.chunks(4).fold(0, |sum, word| {
        let sum = sum + word.iter().zip([24, 16, 8, 0]).map(|(byte, shift)| u64::from(*byte) << shift).sum::<u64>();
        (sum & 0xffff_ffff) + (sum >> 32)
    });
    let found = sum as u32;
    if found == expected { Ok(()) } else { Err(Fault::Checksum { hdu: hdu.number, expected, found }) }
}
