//! Images in compressed tiles (`.fz`), decoded by cfitsio from memory.
#![allow(
    unsafe_code,
    reason = "cfitsio is a C library; every call is in this file, under one lock, with checked arguments"
)]

use std::ffi::{c_int, c_void};
use std::ptr;

use crate::cfitsio::Turn;
use crate::hdu::BLOCK;
use crate::pixels::Pixels;

/// cfitsio's numbers of types.
const TUSHORT: c_int = 20;
const TFLOAT: c_int = 42;

/// The pixels of HDU `number` of the file `bytes`, `count` of them: as counts if `whole` is set, else as floats with
/// NaN where there is no value. Scaled by BSCALE and BZERO. On failure: the message of cfitsio.
pub(crate) fn decode(mut bytes: Vec<u8>, number: usize, count: usize, whole: bool) -> Result<Pixels, String> {
    // cfitsio reads whole blocks; some writers leave the last one short.
    bytes.resize(bytes.len().div_ceil(BLOCK) * BLOCK, 0);
    if whole {
        read(bytes, number, TUSHORT, &0_u16, vec![0; count]).map(Pixels::U16)
    } else {
        read(bytes, number, TFLOAT, &f32::NAN, vec![0.0; count]).map(Pixels::F32)
    }
}

/// `datatype` must be cfitsio's number for `T`; `blank` stands for pixels without a value, 0 for "do not look".
fn read<T>(bytes: Vec<u8>, number: usize, datatype: c_int, blank: &T, mut pixels: Vec<T>) -> Result<Vec<T>, String> {
    let count = i64::try_from(pixels.len()).map_err(|_| "too many pixels".to_owned())?;
    with_hdu(bytes, number, |raw, status| {
        let mut any = 0;
        // SAFETY: `raw` is open; `pixels` holds `count` values of the type that `datatype` names, `blank` is one.
        unsafe {
            let blank = ptr::from_ref(blank).cast_mut().cast::<c_void>();
            let to = pixels.as_mut_ptr().cast::<c_void>();
            fitsio_sys::ffgpv(raw, datatype, 1, count, blank, to, &mut any, status);
        }
    })?;
    Ok(pixels)
}

/// The plain file of the image in HDU `number` of the file `bytes`; it must have `length` bytes. On failure: the message
/// of cfitsio.
pub(crate) fn restore(mut bytes: Vec<u8>, number: usize, length: usize) -> Result<Vec<u8>, String> {
    bytes.resize(bytes.len().div_ceil(BLOCK) * BLOCK, 0);
    let mut plain: Vec<u8> = vec![0; length];
    let (mut start, mut room) = (plain.as_mut_ptr().cast::<c_void>(), plain.len());
    with_hdu(bytes, number, |raw, status| {
        let mut made = ptr::null_mut();
        // SAFETY: cfitsio keeps the addresses of `start` and `room`, and writes at most `room` bytes behind `start` (it
        // has no realloc, and so fails where they are too few) until `ffclos`; all three outlive it.
        unsafe {
            fitsio_sys::ffimem(&mut made, &mut start, &mut room, 0, None, status);
            fitsio_sys::fits_img_decompress(raw, made, status);
            if !made.is_null() {
                let mut closed = 0;
                fitsio_sys::ffclos(made, &mut closed);
                *status = if *status == 0 { closed } else { *status };
            }
        }
    })?;
    Ok(plain)
}

/// Opens the file `bytes` at an HDU and has work done on it, which reports as cfitsio does.
fn with_hdu(
    mut bytes: Vec<u8>,
    number: usize,
    work: impl FnOnce(*mut fitsio_sys::fitsfile, &mut c_int),
) -> Result<(), String> {
    let number = c_int::try_from(number).map_err(|_| "too many HDUs".to_owned())?;
    let turn = Turn::wait();
    let (mut raw, mut status) = (ptr::null_mut(), 0);
    let (mut start, mut length) = (bytes.as_mut_ptr().cast::<c_void>(), bytes.len());
    // SAFETY: cfitsio keeps the addresses of `start` and `length` and reads (mode 0 and no realloc: never writes or
    // moves) the bytes behind them until `ffclos`; all three outlive it. The name is a closed C string.
    unsafe {
        fitsio_sys::ffomem(&mut raw, c"tiles".as_ptr(), 0, &mut start, &mut length, 0, None, &mut status);
    }
    if !raw.is_null() && status == 0 {
        let mut kind = 0;
        // SAFETY: `raw` is open.
        unsafe { fitsio_sys::ffmahd(raw, number, &mut kind, &mut status) };
        work(raw, &mut status);
    }
    let failure = if status == 0 { None } else { Some(turn.explain(status)) };
    if !raw.is_null() {
        let mut status = 0;
        // SAFETY: `raw` is open and is given up here; nothing was written.
        unsafe { fitsio_sys::ffclos(raw, &mut status) };
        turn.explain(status);
    }
    failure.map_or(Ok(()), Err)
}
