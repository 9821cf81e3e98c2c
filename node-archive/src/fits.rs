//! FITS files through cfitsio; the only place that calls C.
//!
//! `fitsio`'s safe layer appends keywords instead of updating them, has no checksums, and ignores the result of
//! closing, which on a full disk is the only report of the loss. So this wraps the few functions of `fitsio_sys` that
//! are needed.
#![allow(
    unsafe_code,
    reason = "cfitsio is a C library; every call is in this file, under one lock, with checked arguments"
)]

use std::ffi::{CString, c_char, c_int, c_long, c_void};
use std::fs::OpenOptions;
use std::io::{self, Write as _};
use std::num::FpCategory;
use std::path::{Path, PathBuf};
use std::ptr::{self, NonNull};

use contract::device::camera::{Frame, Pixel};
use fits::cfitsio::Turn;

use crate::card::Card;
use crate::stored_header::Header;

/// cfitsio's `FLEN_FILENAME`, with its closing zero.
const LONGEST_PATH: usize = 1024;

/// cfitsio did not do what was asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("cannot {what} {}: {detail}", file.display())]
pub struct FitsError {
    /// The operation that failed.
    pub what: &'static str,
    /// With which file.
    pub file: PathBuf,
    /// The message of cfitsio.
    pub detail: String,
}

/// Size and type of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// Type of a pixel.
    pub pixel: Pixel,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Colour planes; 1 makes a flat image.
    pub planes: u32,
}

impl Shape {
    /// The shape of an announced frame.
    pub fn of(frame: &Frame) -> Self {
        Self { pixel: frame.pixel, width_px: frame.width_px, height_px: frame.height_px, planes: frame.planes.max(1) }
    }

    /// Number of pixels; `None` when it does not fit.
    pub fn pixels(&self) -> Option<usize> {
        let rows = (self.width_px as usize).checked_mul(self.height_px as usize)?;
        rows.checked_mul(self.planes as usize)
    }

    /// Bytes in the spool; `None` when they do not fit.
    pub fn bytes(&self) -> Option<usize> {
        self.pixels()?.checked_mul(self.pixel.bytes())
    }
}

/// An open FITS file; cfitsio works on one at a time.
pub struct FitsFile {
    /// Absent once closed.
    raw: Option<NonNull<fitsio_sys::fitsfile>>,
    path: PathBuf,
    turn: Turn,
}

impl FitsFile {
    /// Creates a file that must not exist, with the mandatory keywords of an image (BZERO for 16 bits without sign).
    pub fn create(path: &Path, shape: &Shape) -> Result<Self, FitsError> {
        let file = Self::open_with("create", path, |raw, name, status| {
            // SAFETY: `raw` and `status` point to locals that outlive the call, `name` is a closed C string.
            unsafe { fitsio_sys::ffdkinit(raw, name, status) }
        })?;
        file.with_image(shape)
    }

    /// As [`Self::create`], in memory; [`Self::compress_to`] writes it to `path`.
    pub fn in_memory(path: &Path, shape: &Shape) -> Result<Self, FitsError> {
        let file = Self::open_with("create", path, |raw, _, status| {
            // SAFETY: `raw` and `status` point to locals that outlive the call, the name is a closed C string.
            unsafe { fitsio_sys::ffinit(raw, c"mem://frame".as_ptr(), status) }
        })?;
        file.with_image(shape)
    }

    fn with_image(mut self, shape: &Shape) -> Result<Self, FitsError> {
        let path = self.path.as_path();
        let bitpix = match shape.pixel {
            Pixel::U16 => 20,  // USHORT_IMG: BITPIX 16 with BZERO 32768
            Pixel::I32 => 32,  // LONG_IMG
            Pixel::F64 => -64, // DOUBLE_IMG
        };
        let mut axes: Vec<c_long> = Vec::new();
        for length in [shape.width_px, shape.height_px, shape.planes] {
            let length = i32::try_from(length).ok().filter(|length| *length > 0).map(c_long::from);
            axes.push(length.ok_or_else(|| error("create", path, format!("{shape:?} is no image")))?);
        }
        if shape.planes == 1 {
            axes.pop();
        }
        let count = axes.len() as c_int;
        // SAFETY: `raw` is open; `axes` holds `count` numbers and is only read.
        self.call("create the image in", |raw, status| unsafe {
            fitsio_sys::ffcrim(raw, bitpix, count, axes.as_mut_ptr(), status)
        })?;
        Ok(self)
    }

    /// Writes the image of this file as compressed tiles, each a row, into a new file: whole numbers by Rice's method,
    /// floats by GZIP_2 without quantization, so that nothing is lost. The header and its spare room stay, and so do the
    /// sums, under the names ZHECKSUM and ZDATASUM (FITS Standard 4.0, section 10). This file is given up.
    pub fn compress_to(mut self, path: &Path, pixel: Pixel) -> Result<(), FitsError> {
        let method = match pixel {
            Pixel::U16 | Pixel::I32 => 11, // RICE_1
            Pixel::F64 => 22,              // GZIP_2
        };
        let name = c_path("create", path)?;
        self.call("compress", |raw, status| {
            let (mut tiled, mut kind) = (ptr::null_mut(), 0);
            // SAFETY: `raw` is open; `tiled`, `kind` and `status` are locals or outlive the calls, `name` is a closed C
            // string. Each of the calls does nothing where `status` is set.
            unsafe {
                fitsio_sys::ffdkinit(&mut tiled, name.as_ptr(), status);
                if tiled.is_null() {
                    return *status;
                }
                fitsio_sys::fits_set_compression_type(tiled, method, status);
                // Zero is "do not quantize".
                fitsio_sys::fits_set_quantize_level(tiled, 0.0, status);
                fitsio_sys::fits_img_compress(raw, tiled, status);
                fitsio_sys::ffpcks(tiled, status);
                fitsio_sys::ffmahd(tiled, 1, &mut kind, status);
                fitsio_sys::ffpcks(tiled, status);
                let mut closed = 0;
                fitsio_sys::ffclos(tiled, &mut closed);
                if *status == 0 {
                    *status = closed;
                }
            }
            // SAFETY: `status` points to a number.
            unsafe { *status }
        })?;
        self.close()?;
        sum_up(path).map_err(|source| error("write the checksums of", path, source.to_string()))
    }

    fn open_with(
        what: &'static str,
        path: &Path,
        open: impl FnOnce(*mut *mut fitsio_sys::fitsfile, *const c_char, *mut c_int) -> c_int,
    ) -> Result<Self, FitsError> {
        let name = c_path(what, path)?;
        let turn = Turn::wait();
        let (mut raw, mut status) = (ptr::null_mut(), 0);
        open(&mut raw, name.as_ptr(), &mut status);
        match NonNull::new(raw) {
            Some(raw) if status == 0 => Ok(Self { raw: Some(raw), path: path.to_owned(), turn }),
            _ => Err(error(what, path, turn.explain(status))),
        }
    }

    /// Sets a keyword in place, or adds it at the end. A number that is not finite is left out; then the result is
    /// `false`.
    pub fn set(&mut self, card: &Card) -> Result<bool, FitsError> {
        let Some(record) = card.record() else { return Ok(false) };
        let (keyword, record) = (c_text(&card.keyword), c_text(&record));
        // SAFETY: the file is open; both texts are closed C strings, the record of 80 characters.
        self.call("set a keyword in", |raw, status| unsafe {
            fitsio_sys::ffucrd(raw, keyword.as_ptr(), record.as_ptr(), status)
        })?;
        Ok(true)
    }

    /// Keeps room for so many more cards, so that setting them later does not move the pixels. Before the pixels.
    pub fn reserve(&mut self, cards: usize) -> Result<(), FitsError> {
        let cards = c_int::try_from(cards).unwrap_or(c_int::MAX);
        // SAFETY: the file is open.
        self.call("reserve room in", |raw, status| unsafe { fitsio_sys::ffhdef(raw, cards, status) })
    }

    /// Writes all pixels, given as they stand in the spool: little endian, first row first.
    pub fn write_pixels(&mut self, shape: &Shape, spooled: &[u8]) -> Result<(), FitsError> {
        if shape.bytes() != Some(spooled.len()) {
            let detail = format!("{} bytes are no image of {shape:?}", spooled.len());
            return Err(error("write the pixels of", &self.path, detail));
        }
        match shape.pixel {
            Pixel::U16 => self.write_values(20, spooled.as_chunks().0.iter().map(|bytes| u16::from_le_bytes(*bytes))),
            Pixel::I32 => self.write_values(31, spooled.as_chunks().0.iter().map(|bytes| i32::from_le_bytes(*bytes))),
            Pixel::F64 => {
                self.write_values(82, spooled.as_chunks().0.iter().map(|bytes| one_nan(f64::from_le_bytes(*bytes))))
            }
        }
    }

    /// `datatype` must be cfitsio's number for `T`: TUSHORT 20, TINT 31, TDOUBLE 82.
    fn write_values<T>(&mut self, datatype: c_int, values: impl Iterator<Item = T>) -> Result<(), FitsError> {
        let mut values: Vec<T> = values.collect();
        let count = values.len() as i64;
        // SAFETY: the file is open and its image has `count` pixels; `values` holds as many of the type that
        // `datatype` names, and is not kept.
        self.call("write the pixels of", |raw, status| unsafe {
            fitsio_sys::ffppr(raw, datatype, 1, count, values.as_mut_ptr().cast::<c_void>(), status)
        })
    }

    /// Writes DATASUM and CHECKSUM over all that is in the file.
    pub fn write_checksums(&mut self) -> Result<(), FitsError> {
        // SAFETY: the file is open.
        self.call("write the checksums of", |raw, status| unsafe { fitsio_sys::ffpcks(raw, status) })
    }

    /// Closes the file and reports whether everything arrived.
    pub fn close(mut self) -> Result<(), FitsError> {
        let Some(raw) = self.raw.take() else { return Ok(()) };
        let mut status = 0;
        // SAFETY: `raw` was open and is given up here, whatever cfitsio answers.
        unsafe { fitsio_sys::ffclos(raw.as_ptr(), &mut status) };
        if status == 0 { Ok(()) } else { Err(error("close", &self.path, self.turn.explain(status))) }
    }

    fn call(
        &mut self,
        what: &'static str,
        work: impl FnOnce(*mut fitsio_sys::fitsfile, *mut c_int) -> c_int,
    ) -> Result<(), FitsError> {
        let Some(raw) = self.raw else { return Err(error(what, &self.path, "it is closed".to_owned())) };
        let mut status = 0;
        work(raw.as_ptr(), &mut status);
        if status == 0 { Ok(()) } else { Err(error(what, &self.path, self.turn.explain(status))) }
    }
}

impl Drop for FitsFile {
    fn drop(&mut self) {
        if let Some(raw) = self.raw.take() {
            let mut status = 0;
            // SAFETY: `raw` is open and is given up here; the caller that dropped it unclosed has reported an error.
            unsafe { fitsio_sys::ffclos(raw.as_ptr(), &mut status) };
            self.turn.explain(status);
        }
    }
}

/// Whether pixels in compressed tiles come back as they were. cfitsio, and so `funpack`, makes NaN of infinite numbers, and
/// zero of those below the least normal one and of -0.
pub fn is_restored_whole(shape: &Shape, spooled: &[u8]) -> bool {
    let is_restored = |bytes: &[u8; 8]| {
        let number = f64::from_le_bytes(*bytes);
        match number.classify() {
            FpCategory::Nan | FpCategory::Normal => true,
            FpCategory::Zero => number.is_sign_positive(),
            FpCategory::Infinite | FpCategory::Subnormal => false,
        }
    };
    shape.pixel != Pixel::F64 || spooled.as_chunks().0.iter().all(is_restored)
}

/// cfitsio compresses every NaN as this one, so that sums would not fit those of any other.
fn one_nan(value: f64) -> f64 {
    if value.is_nan() { f64::from_bits(u64::MAX) } else { value }
}

/// Sets the sums of a file with tiles, ZHECKSUM among them: the plain header that is restored from this one may have
/// another block of room than the one that was compressed.
fn sum_up(path: &Path) -> io::Result<()> {
    let mut header = Header::read(path)?.ok_or_else(|| io::Error::other("its header has no end"))?;
    header.update_checksum();
    OpenOptions::new().write(true).open(path)?.write_all(&header.to_bytes())
}

fn c_path(what: &'static str, path: &Path) -> Result<CString, FitsError> {
    let name = path.to_str().filter(|name| name.len() < LONGEST_PATH).and_then(|name| CString::new(name).ok());
    name.ok_or_else(|| error(what, path, "the path is too long or no UTF-8".to_owned()))
}

fn error(what: &'static str, file: &Path, detail: String) -> FitsError {
    FitsError { what, file: file.to_owned(), detail }
}

/// A C string of text that [`printable`](contract::printable()) has cleaned; a zero would end it early.
fn c_text(text: &str) -> CString {
    CString::new(text.replace('\0', "?")).unwrap_or_default()
}
