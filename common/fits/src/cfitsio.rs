//! The parts that all users of cfitsio share: one turn at a time, and its error messages.
#![allow(unsafe_code, reason = "cfitsio is a C library; only its two functions of error messages are called here")]

use std::ffi::{CStr, c_char, c_int};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The error stack of cfitsio is one for all threads, so its users take turns.
static TURN: Mutex<()> = Mutex::new(());

/// The right to call cfitsio, held for as long as a file of it is open.
#[derive(Debug)]
pub struct Turn {
    _alone: MutexGuard<'static, ()>,
}

impl Turn {
    /// Waits until no other file is open.
    pub fn wait() -> Self {
        Self { _alone: TURN.lock().unwrap_or_else(PoisonError::into_inner) }
    }

    /// The text of cfitsio for a status, with its stack of messages, which is emptied.
    pub fn explain(&self, status: c_int) -> String {
        let mut text = [0 as c_char; 81]; // FLEN_ERRMSG
        // SAFETY: cfitsio writes at most 30 characters of its own and the closing zero.
        unsafe { fitsio_sys::ffgerr(status, text.as_mut_ptr()) };
        let mut words = vec![format!("{} (cfitsio {status})", from_c(&text))];
        // SAFETY: cfitsio writes at most 80 characters and the closing zero.
        while unsafe { fitsio_sys::ffgmsg(text.as_mut_ptr()) } != 0 {
            words.push(from_c(&text));
        }
        words.join("; ")
    }
}

fn from_c(text: &[c_char; 81]) -> String {
    // SAFETY: the array is zero-filled at its end and cfitsio closes what it writes.
    unsafe { CStr::from_ptr(text.as_ptr()) }.to_string_lossy().into_owned()
}
